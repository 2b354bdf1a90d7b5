"""Pictures, charts and slides of a dataset."""
