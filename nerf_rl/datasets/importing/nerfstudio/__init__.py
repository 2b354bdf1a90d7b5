"""Scenes of nerfstudio, each a moment in time, as frames of a dataset."""
