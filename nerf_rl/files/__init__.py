"""How results are kept: folders, whole files, JSON, tensors, and checks of what others wrote."""
