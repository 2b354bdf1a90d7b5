"""Lightning's checkpoints as files that somebody hands in: read without executing anything, and looked at before use.

Such a file is a ZIP archive of stored, not compressed, records. Their checksums are compared first, since PyTorch does
not, and their sizes with that of the file.
"""

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nerf_rl.errors import MissingFileError

_REMEDY = "take it from where it was made, or train again"
ENCODER = "encoder"
"""where a checkpoint keeps the description of its encoder, as in ``encoder.json``"""
DATASET = "dataset"
"""where it keeps the digest of the dataset that it was trained on"""


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Read a checkpoint: tensors and plain values, nothing that could be executed.

    Raises:
        MissingFileError: there is none, it is damaged, or it holds something else.
    """
    try:
        _require_whole(path)
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # an unpickler that reads what anyone may have written raises anything
        reason = "it is damaged, or holds more than tensors and plain values"
        raise MissingFileError("a checkpoint", path, reason, _REMEDY) from error
    if not isinstance(content, dict) or not isinstance(content.get("state_dict"), Mapping):
        raise MissingFileError("a checkpoint", path, "it holds no state_dict", _REMEDY)
    return content


def described_encoder(path: Path) -> dict[str, Any]:
    """Return the description that a checkpoint carries of its encoder.

    Raises:
        MissingFileError: it carries none; then nobody measured the statistics of its latents either.
    """
    description = read_checkpoint(path).get(ENCODER)
    if not isinstance(description, dict):
        reason = "it does not say what its encoder's latents are standardised by, as checkpoints of old do not"
        remedy = "use the run folder with the exported encoder, or let nerf-rl pretrain --resume true write it again"
        raise MissingFileError("an encoder", path, reason, remedy)
    return description


def encoder_weights(path: Path) -> dict[str, Tensor]:
    """Return the encoder's weights in a checkpoint."""
    state, prefix = read_checkpoint(path)["state_dict"], "encoder."
    return {str(name).removeprefix(prefix): value for name, value in state.items() if str(name).startswith(prefix)}


def _require_whole(path: Path) -> None:
    """Raise an error unless a file is an archive of records that are stored as they are and match their checksums."""
    with zipfile.ZipFile(path) as archive:
        records = archive.infolist()
        if any(record.compress_type != zipfile.ZIP_STORED for record in records):
            raise ValueError("a record is compressed")
        if sum(record.file_size for record in records) > path.stat().st_size:
            raise ValueError("its records are larger than the file")
        for record in records:
            with archive.open(record) as stream:
                while stream.read(1 << 20):
                    pass
