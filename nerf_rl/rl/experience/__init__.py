"""Transitions: noise that finds them, returns and goals read into them, the memory that keeps them."""
