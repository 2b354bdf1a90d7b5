"""Rows of replay memory in checkpoints: files that are written once and shared by all checkpoints that need them.

A row is known by how many were stored before it. A checkpoint holds the rows that memory held then, in files of
consecutive rows, ``rows-FIRST-END.safetensors``. The next one takes over (as hard links) those that memory still needs
and adds a file with the rows stored since. No file is ever changed, so whatever happens to memory or to the checkpoint
that is being written, the one before stays whole; and a file goes when the last checkpoint that needs it does.
"""

import os
import re
import shutil
from pathlib import Path
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from nerf_rl.errors import UserError
from nerf_rl.files.tensor_files import read_tensors, write_tensors
from nerf_rl.rl.experience.replay import Replay

_REMEDY = "train again with --overwrite true"
_NAME = re.compile(r"rows-(\d+)-(\d+)\.safetensors")


class _Chunk(NamedTuple):
    """A file with the rows from ``first`` to before ``end``."""

    first: int
    end: int
    path: Path


def save_rows(replay: Replay, folder: Path, before: Path | None = None) -> None:
    """Put files into a folder that together hold the rows of memory.

    Args:
        replay: to be saved.
        folder: of the checkpoint that is being written.
        before: the checkpoint of the same memory that was written or loaded last, if there is one.
    """
    begun = replay.oldest
    for chunk in _chunks(before) if before is not None else ():
        if chunk.end > replay.oldest:
            _share(chunk.path, folder / chunk.path.name)
            begun = chunk.end
    if begun < replay.stored:
        name = f"rows-{begun:012d}-{replay.stored:012d}.safetensors"
        write_tensors(folder / name, {"rows": replay.rows(begun, replay.stored)})


def load_rows(folder: Path, oldest: int, stored: int) -> Float[Tensor, "N W"]:
    """Return the rows of a checkpoint from ``oldest`` to before ``stored``, in that order.

    Raises:
        UserError: some are not there, or a file is damaged.
    """
    parts: list[Tensor] = []
    begun = oldest
    for chunk in _chunks(folder):
        if chunk.first <= begun < chunk.end:
            rows = read_tensors(chunk.path).get("rows", torch.empty(0))
            like = parts[0].shape[1:] if parts else rows.shape[1:]
            if rows.dim() != 2 or len(rows) != chunk.end - chunk.first or rows.shape[1:] != like:
                raise UserError(f"{chunk.path} does not hold the rows that it is named after; {_REMEDY}")
            parts.append(rows[begun - chunk.first : stored - chunk.first])
            begun = min(chunk.end, stored)
    if begun < stored:
        raise UserError(f"{folder} lacks rows {begun} to {stored - 1} of replay memory; {_REMEDY}")
    return torch.cat(parts)


def count_rows(folder: Path) -> int:
    """Return how many rows the files of a checkpoint hold, needed or not."""
    return sum(chunk.end - chunk.first for chunk in _chunks(folder))


def most_rows(capacity: int, between: int, total: int) -> int:
    """Return how many rows checkpoints hold at most, also while one is being written beside the one before.

    The file with the oldest row may hold others that memory has replaced, as many as come between two checkpoints; and
    as many again are written before any file goes.

    Args:
        capacity: of memory.
        between: rows that are stored between two checkpoints, at most.
        total: rows that are ever stored, at most.
    """
    return min(total, capacity + 2 * min(between, capacity))


def _chunks(folder: Path) -> list[_Chunk]:
    """Return the files of a checkpoint, in the order of their rows."""
    named = [(match, path) for path in folder.glob("rows-*") if (match := _NAME.fullmatch(path.name))]
    return sorted(_Chunk(int(match[1]), int(match[2]), path) for match, path in named)


def _share(source: Path, place: Path) -> None:
    """Give a file that is never changed a second name; copy it where the file system knows no such thing."""
    try:
        os.link(source, place)
    except OSError:
        shutil.copyfile(source, place)
