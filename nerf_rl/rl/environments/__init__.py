"""The environments that agents act in, and what they observe there."""
