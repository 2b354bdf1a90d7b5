"""Checkpoints of a training run: one folder per checkpoint, complete or absent, without pickle.

``checkpoints/00010000/`` holds ``state.safetensors`` (networks, targets, optimisers, priorities, random states),
``state.json`` (counters and results so far) and the rows of replay memory
(:mod:`nerf_rl.rl.experience.replay_chunks`). It is written aside and renamed; older ones are removed after that.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from torch import Tensor

from nerf_rl.arguments.stored_keys import require_same_keys
from nerf_rl.errors import BEGIN_ANEW, MissingFileError, UserError
from nerf_rl.files.atomic import rename_durably
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.structure import flag, listing, mapping, number, one_of, optional, text, whole
from nerf_rl.files.tensor_files import read_tensors, write_tensors
from nerf_rl.hub.address import is_address
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION, encoder_digest
from nerf_rl.rl.config import NO_ENCODER, TrainRLConfig
from nerf_rl.rl.training.curriculum import STRUCTURE as CURRICULUM
from nerf_rl.rl.training.deadlock import STRUCTURE as MONITOR
from nerf_rl.rl.training.evaluation_results import EVALUATIONS
from nerf_rl.rl.training.exploration import STRUCTURE as EXPLORATION
from nerf_rl.scenes.base import METAWORLD

_FORMAT = 2  # since it, agents in Meta-World observe changes; a replay memory of before holds something else
_TENSORS, _FACTS = "state.safetensors", "state.json"
_WORD = whole(0, 2**128 - 1)
_STRUCTURE = mapping(
    {
        **dict.fromkeys(("env_steps", "updates", "episodes", "explored_from"), whole()),
        "credit": number(0.0),
        "episode_index": listing(whole(), 1),
        "seconds": number(0.0),
        "rng": mapping(
            {
                "bit_generator": one_of("PCG64"),
                "state": mapping({"state": _WORD, "inc": _WORD}),
                "has_uint32": whole(0, 1),
                "uinteger": whole(0, 2**32 - 1),
            }
        ),
        "monitor": MONITOR,
        "evaluations": EVALUATIONS,
    },
    {
        "format": whole(1),
        "tells_success": flag,
        "encoder_digest": optional(text()),
        **CURRICULUM,
        **EXPLORATION,
        "demonstrations": mapping({**dict.fromkeys(("episodes", "tries", "env_steps"), whole(1)), "cloned": flag}),
    },
    others=True,
)


def last_checkpoint(run: Path) -> Path | None:
    """Return the newest complete checkpoint of a run, if it has one."""
    return max(run.glob("checkpoints/[0-9]*"), key=lambda folder: int(folder.name), default=None)


def save_checkpoint(
    run: Path, env_steps: int, tensors: Mapping[str, Tensor], facts: dict[str, Any], add: Callable[[Path], None]
) -> Path:
    """Write a checkpoint and remove the older ones; return its folder.

    Args:
        run: folder of the run.
        env_steps: the checkpoint's name.
        tensors, facts: what :func:`load_checkpoint` returns.
        add: writes what else belongs to it into the folder that it is given.
    """
    parent = run / "checkpoints"
    parent.mkdir(exist_ok=True)
    aside, final = parent / "partial", parent / f"{env_steps:08d}"
    shutil.rmtree(aside, ignore_errors=True)
    aside.mkdir()
    write_tensors(aside / _TENSORS, tensors)
    write_json(aside / _FACTS, {"format": _FORMAT, **facts})
    add(aside)
    if final.exists():  # it stays, by another name of the same number, until the new one is there
        final.rename(parent / f"{env_steps:09d}")
    rename_durably(aside, final)
    for older in parent.glob("[0-9]*"):
        if older != final:
            shutil.rmtree(older)
    return final


def load_checkpoint(folder: Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read a checkpoint: its tensors and its facts.

    Raises:
        MissingFileError: one of its files is missing or damaged.
    """
    try:
        facts = read_json(folder / _FACTS)
        _STRUCTURE(facts, "")
    except (OSError, ValueError) as error:
        raise MissingFileError("a checkpoint", folder, f"its {_FACTS} is damaged ({error})", BEGIN_ANEW) from error
    return read_tensors(folder / _TENSORS), facts


def require_same_observations(facts: Mapping[str, Any], scene: str, folder: Path) -> None:
    """Raise MissingFileError where agents no longer observe what is in the replay memory of a checkpoint.

    Args:
        facts: of the checkpoint.
        scene: that the agent acts in.
        folder: of the checkpoint, to be named.
    """
    if facts.get("format", 1) < _FORMAT and scene.startswith(METAWORLD):
        reason = "it is of an earlier version, whose agents observed something else"
        raise MissingFileError("a checkpoint to go on from", folder, reason, BEGIN_ANEW)


def require_begun_so(folder: Path, config: TrainRLConfig, runs: Sequence[Path]) -> None:
    """Check that runs which are to be resumed were begun with the same keys, and with the encoder that is there now.

    An encoder in a folder is known by its digest, wherever that lies by now; an address on the Hub means its commit.
    Runs of an earlier version may not tell.

    Args:
        folder: whose ``config.yaml`` is compared.
        config: to go on with.
        runs: in it, or the folder itself; to be gone on with, or finished.

    Raises:
        UserError: other keys, or what a run remembers was seen with another encoder.
    """
    content, encoder = config.content(), config.encoder
    told = {} if encoder == NO_ENCODER else {run: found for run in runs if (found := _digest_told(run)) is not None}
    digest = encoder_digest(encoder) if told else None
    if digest in told.values() and not is_address(encoder):
        del content["encoder"]
    require_same_keys(folder, content, TrainRLConfig)
    other = next((run for run, found in told.items() if found != digest), None)
    if other is not None:
        raise UserError(
            f"{encoder} is not the encoder that {other} was begun with, although it is at the same place; put that one "
            f"back, or {BEGIN_ANEW}"
        )


def _digest_told(run: Path) -> str | None:
    """Return the digest of its encoder that a run to be gone on with, or finished, tells."""
    checkpoint = last_checkpoint(run)
    if checkpoint is None and not (run / SUMMARY).is_file():
        return None
    told = [] if checkpoint is None else [checkpoint / _FACTS]
    return next(filter(None, map(_digest_in, [*told, run / POLICY_DESCRIPTION])), None)


def _digest_in(path: Path) -> str | None:
    """Return the digest of an encoder that a file tells; damage is for others to tell of."""
    try:
        content = read_json(path)
    except (OSError, ValueError):
        return None
    digest = content.get("encoder_digest") if isinstance(content, dict) else None
    return digest if isinstance(digest, str) else None
