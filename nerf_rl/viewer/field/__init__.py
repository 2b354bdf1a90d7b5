"""The radiance field as the viewer shows it: refined while one waits, as a mesh, beside the cameras."""
