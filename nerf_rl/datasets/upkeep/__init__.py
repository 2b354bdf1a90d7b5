"""Datasets checked, repaired and merged after they were made."""
