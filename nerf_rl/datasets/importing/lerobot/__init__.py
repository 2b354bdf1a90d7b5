"""LeRobotDatasets with camera matrices, as frames of a dataset."""
