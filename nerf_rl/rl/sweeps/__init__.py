"""Training over many seeds: a process for each, and a summary of all."""
