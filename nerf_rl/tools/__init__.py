"""Pictures and pages that show what the other stages made."""
