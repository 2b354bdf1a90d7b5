"""Encoders and policies as files: found, identified and checked without loading torch."""

import hashlib
from pathlib import Path
from typing import Any, get_args

from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.files.json_files import read_json
from nerf_rl.files.structure import flag, listing, mapping, number, one_of, optional, text, whole
from nerf_rl.hub.address import is_address
from nerf_rl.hub.fetch import ENCODER_IN_AGENT, lasting, resolve
from nerf_rl.pretrain.model.encoder_file import WEIGHTS, is_checkpoint, read_description
from nerf_rl.rl.config import Control

POLICY_VERSION = 3
POLICY_WEIGHTS, POLICY_DESCRIPTION = "policy.safetensors", "policy.json"
_KNOWN_MODULES = ("gymnasium_robotics", "shimmy")
"""which register environments and do nothing else, and may be imported because an agent of somebody else asks for it"""
_SIZE = whole(1, 2**20)
_WIDTHS = listing(_SIZE, 0, 64)
_STRUCTURE = mapping(
    {
        "version": whole(),
        "env": mapping(
            {"scene": text(), "encoder": optional(text()), "action_repeat": whole(1), "episode_steps": whole(1)},
            {
                "panda": mapping({}, dict.fromkeys(("control", "reward", "observation"), text())),
                "observe": listing(text()),
                "control": one_of(*get_args(Control)),
            },
        ),
        "network": mapping({}, others=True),
        "observation_size": _SIZE,
        "action_size": _SIZE,
        "proprio_names": listing(text()),
        "encoder_digest": optional(text()),
        "env_steps": whole(),
    },
    {"demonstrations": whole(1), "to_end": flag},
    others=True,
)
_DDPG = mapping(
    {"kind": one_of("ddpg"), "hidden": listing(_SIZE, 2, 2)},
    {"normalisation": one_of("layer", "batch", "none"), "standardise": flag},
)
_LAYERED = mapping(
    {
        "kind": one_of("layered"),
        "hidden": _WIDTHS,
        "activation": one_of("tanh", "relu"),
        "bound": one_of("tanh", "clip"),
        "observation_limit": optional(number(0.0)),
    }
)


def encoder_digest(encoder: str | Path) -> str:
    """Return the sha256 of the file that holds an encoder's weights."""
    folder, _ = read_description(encoder)
    weights = Path(encoder) if is_checkpoint(encoder) else folder / WEIGHTS
    with open(weights, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def find_run(run: str) -> Path:
    """Return the folder of a run of train-rl, which is fetched if its address on the Hub is given.

    What somebody else has written decides neither which modules are imported here nor which files are opened.

    Raises:
        MissingFileError: there is no policy at the address.
        UserError: nothing can be fetched from the address, or its agent asks for more.
    """
    folder = resolve(run)
    if not is_address(run):
        return folder
    from nerf_rl.scenes.base import GYM  # it takes MuJoCo's time to import

    env = _read_policy(folder)["env"]
    module, _, _ = env["scene"].removeprefix(GYM).rpartition(":")
    if module and module not in _KNOWN_MODULES:
        raise UserError(
            f"the agent {run} acts in {env['scene']}, for which the module {module} would be imported because somebody "
            f"else's file says so; if you trust it, give its folder instead: {folder}"
        )
    if env["encoder"] not in (None, ENCODER_IN_AGENT):
        raise UserError(f"the agent {run} wants an encoder from elsewhere: {env['encoder']}; it is not opened")
    return folder


def check_policy(run: Path, encoder: str = "") -> dict[str, Any]:
    """Return the description of a run's policy.

    Args:
        run: a run folder of train-rl.
        encoder: where its encoder is now, if it has moved.

    Raises:
        MissingFileError: no policy there, or no encoder where it is said to be.
        UserError: the encoder there is not the one that the policy was trained with.
    """
    description = _read_policy(run)
    env = description["env"]
    if env["encoder"] is not None:
        env["encoder"] = lasting(encoder) if is_address(encoder) else encoder or _encoder_of(run, env["encoder"])
        try:
            digest = encoder_digest(env["encoder"])
        except MissingFileError as error:
            if encoder or is_address(env["encoder"]) or Path(env["encoder"]).exists():
                raise
            reason = f"its encoder is not at {env['encoder']} any more"
            raise MissingFileError("an agent to act with", run, reason, "say where it is by --encoder") from error
        if digest != description["encoder_digest"]:
            raise UserError(f"{env['encoder']} is not the encoder that the policy in {run} was trained with")
    return description


def told_of_seeds(folder: Path) -> tuple[str, str] | None:
    """Return why a sweep's folder is no run, and what to give in its place; None if it is no such folder."""
    policies = sorted(folder.glob(f"seed-*/{POLICY_DESCRIPTION}"))
    if not policies:
        return None
    return "it holds runs of several seeds", f"give the folder of one, such as {policies[0].parent}"


def _encoder_of(run: Path, named: str) -> str:
    """Return where a policy's encoder is: what it says, which is relative to its own folder where it brings its own."""
    return named if is_address(named) else str(run / named)


def _read_policy(run: Path) -> dict[str, Any]:
    for name in (POLICY_DESCRIPTION, POLICY_WEIGHTS):
        if not (run / name).is_file():
            missing = f"it holds no {name}", "train one with nerf-rl train-rl"
            reason, remedy = told_of_seeds(run) or missing
            raise MissingFileError("a train-rl run with a policy", run, reason, remedy)
    remedy = "train it again"
    try:
        description = read_json(run / POLICY_DESCRIPTION)
        version = description.get("version") if isinstance(description, dict) else POLICY_VERSION
        if version != POLICY_VERSION or isinstance(version, bool):
            raise UserError(
                f"the policy in {run} has format {version}, this version reads {POLICY_VERSION}; train it again"
            )
        _STRUCTURE(description, "")
        (_LAYERED if description["network"].get("kind") == "layered" else _DDPG)(description["network"], "network")
    except (OSError, ValueError) as error:
        reason = f"its {POLICY_DESCRIPTION} is damaged ({error})"
        raise MissingFileError("a train-rl run with a policy", run, reason, remedy) from error
    return description
