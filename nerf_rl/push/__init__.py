"""Encoders and agents as folders for others: their files without traces of this machine, a card, a picture."""
