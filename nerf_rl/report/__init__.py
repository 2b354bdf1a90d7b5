"""``nerf-rl report``: a dataset, an encoder and an agent on one page."""
