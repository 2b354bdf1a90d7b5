"""Keys of ``nerf-rl export``; importing this module loads nothing heavy."""

from dataclasses import dataclass, field

from nerf_rl.errors import UnknownNameError, UserError

FORMATS = ("nerfstudio", "pointcloud", "mesh", "lerobot")


@dataclass
class ExportConfig:
    """Keys of ``nerf-rl export``."""

    dataset: str
    """dataset folder; may be given without its key"""
    out: str
    """output folder"""
    format: str = "nerfstudio"
    """nerfstudio: a scene folder for each frame; pointcloud: coloured points; mesh: a coloured surface (PLY both);
    lerobot: a LeRobotDataset of whole episodes"""
    frames: list[int] = field(default_factory=list)
    """frames to export, by index"""
    episodes: list[int] = field(default_factory=list)
    """episodes to export all frames of; with neither frames nor episodes, everything is exported"""
    exclude: list[str] = field(default_factory=list)
    """classes to leave out: masked in nerfstudio's scenes, absent from points and surfaces"""
    reach: float = 0.0
    """depth beyond which there are no points and surfaces [m]; 0: whatever was hit"""
    voxel: float = 0.01
    """edge of a mesh's voxels [m]"""
    cameras: list[str] = field(default_factory=list)
    """lerobot: cameras to export, the main one first; with none, all, the encoder's first"""
    depth: bool = True
    """lerobot: whether depth is among the features; LeRobot gives a policy all pictures unless it is told which"""
    task: str = ""
    """lerobot: the instruction in words; without, those of the scene's name"""
    fps: int = 0
    """lerobot: frames a second; 0: the steps that the scene takes in a second"""
    overwrite: bool = False
    """replace an existing export"""

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise UnknownNameError("format", self.format, FORMATS)
        if self.reach < 0 or self.voxel <= 0:
            raise UserError(
                f"--reach must not be negative and --voxel must be positive, got {self.reach}, {self.voxel}"
            )
        if self.fps < 0:
            raise UserError(f"--fps must not be negative, got {self.fps}")
