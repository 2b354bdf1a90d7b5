"""Names in a page's scene tree that differ whatever things are called."""

from typing import Literal

Kind = Literal["cameras", "camera names", "points", "point names"]
"""What a node stands for; nodes of one kind lie in a branch of their own."""

_STAND_INS = str.maketrans({"%": "%25", "/": "%2F"})  # a slash would begin another branch


def node_name(kind: Kind, name: str) -> str:
    """Return the node for a thing; no two kinds and no two names share one.

    Viser removes a node whose name is given again, together with all nodes below it, and their handles fail from then
    on. Datasets may call a camera and a point alike, and may use slashes.

    Args:
        kind: of the thing.
        name: of the thing, unique within its kind.
    """
    return f"/{kind}/{name.translate(_STAND_INS) or '%'}"
