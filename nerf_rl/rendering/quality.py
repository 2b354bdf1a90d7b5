"""How a dataset's pictures may be drawn."""

from typing import Literal

Quality = Literal["fast", "smooth", "full"]
"""``fast``: meshes simplified for the images' size, a pixel's colour that of its centre; ``smooth``: the same, but the
mean of four colours, so that edges and thin things do not flicker, and no holes in labels and depth; ``full``: whole
meshes, shadows, reflections and multisampling"""
