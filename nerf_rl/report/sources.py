"""What a report is made of: an agent, and the encoder and the dataset that are named or that it came from."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nerf_rl.datasets.storage.reader import MultiViewDataset
from nerf_rl.errors import UserError
from nerf_rl.files.outputs import SUMMARY
from nerf_rl.pretrain.model.encoder_file import read_description
from nerf_rl.report.config import ReportConfig
from nerf_rl.rl.agents.policy_file import check_policy
from nerf_rl.rl.config import NO_CONTROL

FIELD = "field.json"


@dataclass(frozen=True)
class Sources:
    """The parts of a report, all of one scene."""

    scene: str
    """its name"""
    folders: dict[str, Path]
    """of ``data``, ``encoder`` and ``agent``, in this order; the first two may be absent"""
    dataset: MultiViewDataset | None
    agents_encoder: str | None
    """what the agent observes through; None if it observes the true state"""
    control: str
    """blind or random if the agent is a control, which sees nothing or nothing of use; else none"""


def find_sources(config: ReportConfig) -> Sources:
    """Return the parts that there are; what is not named is taken from where the agent, or the encoder, came from.

    Raises:
        UserError: the agent, or a part that was named, is missing; parts are of different scenes, or the encoder is
            not the agent's.
    """
    dataset = MultiViewDataset(config.data) if config.data else None
    named = read_description(config.encoder) if config.encoder else None
    env = check_policy(Path(config.agent), config.encoder)["env"]
    found = named or (read_description(env["encoder"]) if env["encoder"] is not None else None)
    folders: dict[str, Path] = {}
    if found is not None:
        folder, description = found
        _require_scene("encoder", folder, description["scene"]["name"], env["scene"])
        dataset = dataset or _dataset_of(description)
        if named is not None or (folder / SUMMARY).is_file():
            folders["encoder"] = folder
    if dataset is not None:
        _require_scene("dataset", dataset.folder, dataset.manifest["scene"]["name"], env["scene"])
        folders = {"data": Path(dataset.folder), **folders}
    folders["agent"] = Path(config.agent)
    return Sources(env["scene"], folders, dataset, env["encoder"], env.get("control", NO_CONTROL))


def _dataset_of(description: dict[str, Any]) -> MultiViewDataset | None:
    """Return the dataset that an encoder was trained on, if it is where it was and as it was."""
    made_of = description.get("dataset", {})
    try:
        dataset = MultiViewDataset(made_of["folder"])
    except (KeyError, UserError):
        return None
    whole = (Path(dataset.folder) / SUMMARY).is_file()
    return dataset if whole and dataset.digest() == made_of.get("sha256") else None


def _require_scene(kind: str, folder: Path | str, scene: str, wanted: str) -> None:
    if scene != wanted:
        raise UserError(f"the {kind} {folder} is of scene {scene}, and the agent acts in {wanted}; leave it out")
