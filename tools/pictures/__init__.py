"""Draw the documentation's pictures."""
