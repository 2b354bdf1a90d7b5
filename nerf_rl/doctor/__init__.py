"""``nerf-rl doctor``: whether this machine has what is needed."""
