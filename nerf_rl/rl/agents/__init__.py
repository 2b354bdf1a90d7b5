"""DDPG: networks, updates, and the policy as files; no environment is stepped here."""
