"""``nerf-rl gen-dataset``: episodes acted, rendered and written by many processes."""
