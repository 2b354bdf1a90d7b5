"""The training loop with its checkpoints, episodes and records."""
