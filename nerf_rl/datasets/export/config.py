"""Keys of ``nerf-rl export``; importing this module loads nothing heavy."""

from dataclasses import dataclass, field
from typing import Literal

from nerf_rl.arguments.limits import Natural, NotNegative, Positive, check_values
from nerf_rl.errors import UserError

_VOXEL = 0.01


@dataclass
class ExportConfig:
    """Keys of ``nerf-rl export``."""

    dataset: str
    """dataset folder; may be given without its key"""
    out: str
    """output folder"""
    format: Literal["nerfstudio", "pointcloud", "mesh", "lerobot"] = "nerfstudio"
    """nerfstudio: a scene folder for each frame; pointcloud: coloured points; mesh: a coloured surface (PLY both);
    lerobot: a LeRobotDataset of whole episodes"""
    frames: list[int] = field(default_factory=list)
    """frames to export, by index"""
    episodes: list[int] = field(default_factory=list)
    """episodes to export all frames of; with neither frames nor episodes, everything is exported"""
    exclude: list[str] = field(default_factory=list)
    """classes to leave out: masked in nerfstudio's scenes, absent from points and surfaces"""
    reach: NotNegative = 0.0
    """depth beyond which there are no points and surfaces [m]; 0: whatever was hit"""
    voxel: Positive = _VOXEL
    """edge of a mesh's voxels [m]"""
    cameras: list[str] = field(default_factory=list)
    """lerobot: cameras to export, the main one first; with none, all, the encoder's first"""
    depth: bool = True
    """lerobot: whether depth is among the features; LeRobot gives a policy all pictures unless it is told which"""
    task: str = ""
    """lerobot: the instruction in words; without, those of the scene's name"""
    fps: Natural = 0
    """lerobot: frames a second; 0: the steps that the scene takes in a second"""
    overwrite: bool = False
    """replace an existing export"""

    def __post_init__(self) -> None:
        check_values(self)
        given = {"cameras": bool(self.cameras), "depth": not self.depth, "task": bool(self.task), "fps": self.fps > 0}
        for key, is_given in {"voxel": self.voxel != _VOXEL, **given}.items():
            of_format = "mesh" if key == "voxel" else "lerobot"
            if is_given and self.format != of_format:
                raise UserError(f"--{key} is for --format {of_format}, and means nothing to {self.format}")
