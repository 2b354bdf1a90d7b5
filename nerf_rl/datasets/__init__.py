"""From a MuJoCo scene to a multi-view dataset with camera matrices."""
