"""Datasets on disk: layout, shards, and reading them; nothing is rendered here."""
