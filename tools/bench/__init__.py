"""Measure one thing each: its speed, its memory, or whether it survives what can happen to it."""
