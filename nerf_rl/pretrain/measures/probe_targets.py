"""What of the true state probes look for: named columns and the scene's joints, each with an error in its unit."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.datasets.storage.stored_manifest import JOINT_NUMBERS
from nerf_rl.errors import UserError

LEAST_DEVIATION = 1e-4
"""of what varies enough to be probed [m, or of a circle's radius]"""
_SAME = 1e-3  # of the way that a body has come: how far a slide that carries it may be off, by rounding

Error = Callable[[ndarray, ndarray], ndarray]
"""From truth and reading [N, D] to the error of each frame [N]."""


class Target(NamedTuple):
    """Something of the true state, as D numbers that do not jump where it moves smoothly."""

    name: str
    values: Float[ndarray, "N D"]
    """a length [m]; cosine and sine of an angle; the nine numbers of a rotation matrix"""
    unit: str
    """of the error: ``mm`` or ``deg``"""
    error: Error


def column_targets(dataset: MultiViewDataset, frames: ndarray) -> list[Target]:
    """Return the named columns of the privileged state [m]."""
    state = dataset.tracked_positions(frames).astype(np.float64)
    return [_length(name, state[:, i]) for i, name in enumerate(dataset.columns("privileged"))]


def joint_targets(dataset: MultiViewDataset, frames: ndarray) -> list[Target]:
    """Return angles of hinges, places of slides and orientations of bodies that turn freely, after the joints' names.

    Where a free body is stands in the columns. Slides that carry the body which the encoder's cameras follow say how
    far it has come, which no camera sees, and are constant here. A dataset of before joints were named has none.

    Raises:
        UserError: the joints that the manifest names do not make up the state.
    """
    joints = dataset.joints()
    if not joints:
        return []
    qpos, targets, place = dataset.read("state/qpos", frames), [], 0
    if sum(JOINT_NUMBERS[joint["kind"]] for joint in joints) != qpos.shape[1]:
        raise UserError(f"{dataset.folder} is damaged: its joints are not those of its state; make the dataset again")
    travelled = dataset.tracking_origins(frames)
    for joint in joints:
        numbers = JOINT_NUMBERS[joint["kind"]]
        values, place = qpos[:, place : place + numbers], place + numbers
        if joint["kind"] == "slide":
            carries = any(_moves_with(values[:, 0], axis) for axis in travelled.T)
            targets.append(_length(joint["name"], np.zeros(len(values)) if carries else values[:, 0]))
        elif joint["kind"] == "hinge":
            circle = np.concatenate([np.cos(values), np.sin(values)], axis=1)
            targets.append(Target(joint["name"], circle, "deg", angle_error))
        else:
            matrices = rotation_matrices(values[:, -4:]).reshape(len(values), 9)
            targets.append(Target(f"{joint['name']}_orientation", matrices, "deg", orientation_error))
    return targets


def varying(*parts: Sequence[Target]) -> list[int]:
    """Return the positions of the targets that vary in each of some sets of frames."""
    return [i for i, same in enumerate(zip(*parts, strict=True)) if min(map(_deviation, same)) > LEAST_DEVIATION]


def length_error(truth: Float[ndarray, "N 1"], read: Float[ndarray, "N 1"]) -> Float[ndarray, "N"]:
    """Return the differences of lengths in metres [mm]."""
    return 1000.0 * (read - truth)[:, 0]


def angle_error(truth: Float[ndarray, "N 2"], read: Float[ndarray, "N 2"]) -> Float[ndarray, "N"]:
    """Return the differences of angles by their cosines and sines, the shorter way round [deg]."""
    cosine, sine = (
        truth[:, 0] * read[:, 0] + truth[:, 1] * read[:, 1],
        truth[:, 0] * read[:, 1] - truth[:, 1] * read[:, 0],
    )
    return np.degrees(np.arctan2(sine, cosine))


def orientation_error(truth: Float[ndarray, "N 9"], read: Float[ndarray, "N 9"]) -> Float[ndarray, "N"]:
    """Return the angles between orientations [deg].

    What was read is no rotation; the nearest one by the singular value decomposition is taken (Levinson et al., "An
    Analysis of SVD for Deep Rotation Estimation", 2020, equation 1).
    """
    left, _, right = np.linalg.svd(read.reshape(-1, 3, 3))
    left[:, :, 2] *= np.linalg.det(left @ right)[:, None]
    between = np.einsum("nij,nij->n", left @ right, truth.reshape(-1, 3, 3))
    return np.degrees(np.arccos(np.clip((between - 1.0) / 2.0, -1.0, 1.0)))


def rotation_matrices(quaternions: Float[ndarray, "N 4"]) -> Float[ndarray, "N 3 3"]:
    """Return the rotations of unit quaternions (w, x, y, z), of which q and -q are the same."""
    w, x, y, z = (quaternions / np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def _moves_with(values: Float[ndarray, "N"], travelled: Float[ndarray, "N"]) -> bool:
    """Tell whether values differ from places that vary by a constant alone, in one or the other direction."""
    if np.ptp(travelled) < LEAST_DEVIATION:
        return False
    return bool(min(np.ptp(values - travelled), np.ptp(values + travelled)) < _SAME * np.ptp(travelled))


def _length(name: str, values: Float[ndarray, "N"]) -> Target:
    return Target(name, values[:, None], "mm", length_error)


def _deviation(target: Target) -> float:
    return float(np.sqrt(target.values.var(0).sum()))
