"""From a dataset to the batches that a training step takes."""
