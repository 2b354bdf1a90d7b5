"""Checkpoints of a training run: one folder per checkpoint, complete or absent, without pickle.

``checkpoints/00010000/`` holds ``state.safetensors`` (networks, targets, optimisers, priorities, random states),
``state.json`` (counters and results so far) and the rows of replay memory
(:mod:`nerf_rl.rl.experience.replay_chunks`). It is written aside and renamed; older ones are removed after that.
"""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nerf_rl.errors import MissingFileError
from nerf_rl.files.atomic import rename_durably
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.structure import listing, mapping, number, one_of, whole
from nerf_rl.files.tensor_files import read_tensors, require_tensors, write_tensors
from nerf_rl.rl.agents.ddpg import DDPG
from nerf_rl.rl.training.evaluation_results import EVALUATIONS

_MODULES = ("norm", "actor", "critic", "target_actor", "target_critic")
_TENSORS, _FACTS = "state.safetensors", "state.json"
_REMEDY = "begin the run anew with --overwrite true, or use another --out"
_UNNAMED = Path("the checkpoint")
_WORD = whole(0, 2**128 - 1)
_STRUCTURE = mapping(
    {
        **dict.fromkeys(("env_steps", "updates", "episodes"), whole()),
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
        "evaluations": EVALUATIONS,
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
    write_json(aside / _FACTS, facts)
    add(aside)
    shutil.rmtree(final, ignore_errors=True)
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
        raise MissingFileError("a checkpoint", folder, f"its {_FACTS} is damaged ({error})", _REMEDY) from error
    return read_tensors(folder / _TENSORS), facts


def agent_tensors(agent: DDPG) -> dict[str, Tensor]:
    """Return an agent's networks, targets and optimiser moments by flat names."""
    tensors: dict[str, Tensor] = {}
    for part in _MODULES:
        tensors |= {f"{part}.{name}": tensor for name, tensor in getattr(agent, part).state_dict().items()}
    for part in ("actor_optimiser", "critic_optimiser"):
        for index, moments in getattr(agent, part).state_dict()["state"].items():
            tensors |= {f"{part}.{index}.{name}": torch.as_tensor(value) for name, value in moments.items()}
    return tensors


def load_agent_tensors(agent: DDPG, tensors: Mapping[str, Tensor], source: Path = _UNNAMED) -> None:
    """Put back what :func:`agent_tensors` returned.

    Args:
        agent: as it is at the beginning of a run.
        tensors: of a checkpoint.
        source: the checkpoint, to be named if it does not fit.

    Raises:
        MissingFileError: they are those of another agent.
    """
    require_tensors(tensors, _expected_tensors(agent, tensors), source)
    for part in _MODULES:
        getattr(agent, part).load_state_dict(strip_prefix(tensors, part))
    for part in ("actor_optimiser", "critic_optimiser"):
        optimiser = getattr(agent, part)
        state: dict[int, dict[str, Tensor]] = {}
        for key, value in strip_prefix(tensors, part).items():
            index, name = key.split(".", 1)
            state.setdefault(int(index), {})[name] = value
        optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})


def _expected_tensors(agent: DDPG, tensors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Return tensors like those of an agent; moments of a parameter that was never updated may be absent."""
    expected = agent_tensors(agent)
    for part in ("actor_optimiser", "critic_optimiser"):
        parameters = [p for group in getattr(agent, part).param_groups for p in group["params"]]
        for index, parameter in enumerate(parameters):
            if any(name.startswith(f"{part}.{index}.") for name in tensors):
                moments = {"step": torch.zeros(()), "exp_avg": parameter, "exp_avg_sq": parameter}
                expected |= {f"{part}.{index}.{name}": like.detach() for name, like in moments.items()}
    return expected


def strip_prefix(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Return the tensors whose names start with ``prefix.``, without it."""
    return {name.removeprefix(f"{prefix}."): t for name, t in tensors.items() if name.startswith(f"{prefix}.")}
