"""Command lines, recipes and stored configurations; what the keys mean, each stage says."""
