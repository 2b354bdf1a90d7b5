"""From a frozen encoder to a policy."""
