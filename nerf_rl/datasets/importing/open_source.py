"""From a folder to the source that it is."""

from pathlib import Path

from nerf_rl.datasets.export.lerobot.files import INFO
from nerf_rl.datasets.importing.config import LEROBOT, NERFSTUDIO, ImportConfig
from nerf_rl.datasets.importing.lerobot.folder import LeRobotSource
from nerf_rl.datasets.importing.nerfstudio.scenes import ScenesSource, scene_folders
from nerf_rl.datasets.importing.nerfstudio.transforms import TRANSFORMS
from nerf_rl.datasets.importing.source import Source
from nerf_rl.errors import MissingFileError


def open_source(config: ImportConfig) -> Source:
    """Return what a folder holds, of the format asked for or found.

    Raises:
        MissingFileError: the folder holds nothing of the kind.
        SourceError: what it holds is damaged, or is not what an import takes.
    """
    folder = Path(config.source)
    remedy = f"give a folder of nerfstudio scenes (each with {TRANSFORMS}) or a LeRobotDataset (with {INFO})"
    if not folder.is_dir():
        raise MissingFileError("a source of pictures", folder, "there is no such folder", remedy)
    wanted = config.format
    if wanted in ("auto", LEROBOT) and (folder / INFO).is_file():
        return LeRobotSource(folder, config)
    if wanted in ("auto", NERFSTUDIO) and scene_folders(folder):
        return ScenesSource(folder, config)
    found = {"auto": f"it holds neither scenes nor {INFO}", LEROBOT: f"it has no {INFO}"}
    reason = found.get(wanted, f"neither it nor a folder in it has {TRANSFORMS}")
    raise MissingFileError("a source of pictures", folder, reason, remedy)
