"""A page for each kind of subject (dataset, encoder, agent), live or saved."""
