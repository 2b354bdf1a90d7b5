"""Whole episodes of a dataset as a LeRobotDataset, format v3.0."""
