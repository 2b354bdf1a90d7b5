"""Looking at datasets, encoders and agents in the browser."""
