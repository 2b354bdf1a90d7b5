"""The files of an encoder or an agent that others get: weights as they are, descriptions without paths of this machine.

Of a run folder only these files are taken. Checkpoints, logs, recipes and provenance stay, since they are large or tell
of folders, and nobody needs them to use the artefact.
"""

import shutil
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from nerf_rl.errors import MissingFileError, UserError
from nerf_rl.files.json_files import read_json, write_json
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.files.structure import mapping, number, optional, table
from nerf_rl.hub.fetch import ENCODER_IN_AGENT
from nerf_rl.pretrain.measures.figures import RMSE, UNITS
from nerf_rl.pretrain.model import field_description
from nerf_rl.pretrain.model.encoder import Encoder
from nerf_rl.pretrain.model.encoder_file import DESCRIPTION, WEIGHTS, is_checkpoint, read_description
from nerf_rl.pretrain.model.field import RadianceField
from nerf_rl.rl.agents.policy import Policy
from nerf_rl.rl.agents.policy_file import POLICY_DESCRIPTION, POLICY_WEIGHTS, check_policy

_NAMES = ("rig", "classes", "hardly_shown", "observe", "proprio_names")
"""keys below which the scene's own names of cameras, bodies, classes and columns stand, which may begin with a slash"""

_FIGURE = optional(number())
_ERRORS = dict.fromkeys((f"{RMSE}_{unit}" for unit in UNITS), _FIGURE)
_PROBED, _UNTRAINED = table(mapping({"r2": number()}, _ERRORS, others=True)), table(mapping({}, _ERRORS, others=True))
_SUMMARY = mapping(
    {},
    {
        "validation": optional(table(_FIGURE)),
        "class_iou": optional(table(_FIGURE)),
        "class_share": table(number()),
        **dict.fromkeys(("probe", "joint_probe"), _PROBED),
        **dict.fromkeys(("probe_random_encoder", "joint_probe_random_encoder"), _UNTRAINED),
    },
    others=True,
)
"""what a card tells of a summary; an agent's evaluations are checked where they are read"""


def write_encoder(source: Path | str, folder: Path) -> dict[str, Any]:
    """Write an encoder's files, and those of its radiance field if it has one; return its description.

    Raises:
        UserError: there is no encoder, it or its field is damaged, or it is a checkpoint, which is not exported.
    """
    if is_checkpoint(source):
        raise UserError(f"{source} is a checkpoint; push its run folder, once pretrain has exported an encoder")
    run, description = read_description(source)
    Encoder.load(run)  # so that nobody gets weights that nothing can be loaded from
    dataset = {"sha256": description["dataset"]["sha256"]} if "sha256" in description.get("dataset", {}) else None
    description = without_paths({**description, "dataset": dataset or {}})
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(run / WEIGHTS, folder / WEIGHTS)
    write_json(folder / DESCRIPTION, description)
    if (run / field_description.DESCRIPTION).is_file():
        RadianceField.load(run)
        field = field_description.read_field_description(run)
        shutil.copyfile(run / field_description.WEIGHTS, folder / field_description.WEIGHTS)
        write_json(folder / field_description.DESCRIPTION, field)
    return description


def write_agent(run: Path, folder: Path, encoder: str = "") -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Write an agent's files, with its encoder in a folder inside; return its description and that of the encoder.

    Args:
        run: of train-rl.
        folder: to write to.
        encoder: where its encoder is now, if it has moved.

    Raises:
        UserError: there is no policy, it is damaged, or that is not its encoder.
    """
    description = check_policy(run, encoder)
    Policy.load(run, encoder)
    where, eyes = description["env"]["encoder"], None
    if where is not None:
        eyes = write_encoder(where, folder / ENCODER_IN_AGENT)
        description["env"]["encoder"] = ENCODER_IN_AGENT
    description = without_paths(description)
    shutil.copyfile(run / POLICY_WEIGHTS, folder / POLICY_WEIGHTS)
    write_json(folder / POLICY_DESCRIPTION, description)
    return description, eyes


def write_summary(run: Path, folder: Path) -> dict[str, Any]:
    """Write and return a run's own figures; none if it has no summary, as an encoder that was copied without it.

    Raises:
        MissingFileError: the summary is damaged.
    """
    path = run / SUMMARY
    if not path.is_file():
        return {}
    try:
        summary = read_json(path)
        _SUMMARY(summary, "")
    except (OSError, ValueError) as error:
        raise MissingFileError("a summary", path, f"it is damaged ({error})", "let the run write it again") from error
    summary = without_paths(summary)
    write_json(folder / SUMMARY, summary)
    return summary


def without_paths(content: Any) -> Any:
    """Return JSON with each absolute path, wherever it stands, cut down to its last name.

    A scene may be the path of an MJCF file, and tells of a user's folders then. What a scene calls its parts is no
    path, however it looks, and an encoder fits its scene by these names.
    """
    if isinstance(content, dict):
        return {key: value if key in _NAMES else without_paths(value) for key, value in content.items()}
    if isinstance(content, list):
        return [without_paths(value) for value in content]
    if isinstance(content, str):
        for kind in (PurePosixPath, PureWindowsPath):
            if kind(content).is_absolute() or content.startswith("~"):
                return kind(content).name
    return content
