"""Hyper-parameter search: the Whale Optimisation Algorithm as an Optuna sampler, and ``nerf-rl tune``."""
