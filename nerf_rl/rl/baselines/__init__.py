"""Stable-Baselines3 agents for comparison, on the same environments, evaluations and artefacts as our own."""
