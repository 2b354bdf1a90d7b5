"""A dataset's frames in the formats of other libraries."""
