"""Scripts that are run from a checkout, as ``python -m tools.ROOM.NAME`` from its root; nothing of it is installed."""
