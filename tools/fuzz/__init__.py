"""Mutate files that are handed in, and see what becomes of them."""
