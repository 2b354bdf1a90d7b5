"""Folders of posed pictures, of real cameras or of other programs, as datasets."""
