"""The picture of a card: small enough to be looked at on any connection."""

from pathlib import Path

import cv2

from nerf_rl.files.atomic import atomic_write
from nerf_rl.pretrain.reconstructions import newest_reconstruction

PICTURE = "picture.png"
LARGEST = 300_000
"""of the file [bytes]"""
_STEP = 0.85  # by which a picture that is too large is made smaller


def write_picture(run: Path, folder: Path) -> bool:
    """Write the newest picture of a run's results; tell whether there was one.

    Args:
        run: a run folder: held-out frames of an encoder, or an agent's learning curve.
        folder: to write to.
    """
    curve = next(run.glob("learning_curve.png"), None)
    found = curve or newest_reconstruction(run)
    picture = None if found is None else cv2.imread(str(found))
    if picture is None:
        return False
    encoded = cv2.imencode(".png", picture)[1]
    while encoded.size > LARGEST:
        picture = cv2.resize(picture, None, fx=_STEP, fy=_STEP, interpolation=cv2.INTER_AREA)
        encoded = cv2.imencode(".png", picture)[1]
    with atomic_write(folder / PICTURE) as aside:
        aside.write_bytes(encoded.tobytes())
    return True
