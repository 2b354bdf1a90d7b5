"""Keys of ``nerf-rl view``; importing this module loads nothing heavy."""

from dataclasses import dataclass
from pathlib import Path

from nerf_rl.errors import UserError
from nerf_rl.machine.devices import check_device_name

_SUFFIXES = {"save": ".html", "png": ".png", "mp4": ".mp4"}


@dataclass
class ViewConfig:
    """Keys of ``nerf-rl view``."""

    path: str
    """dataset folder, run folder of pretrain or train-rl, or hf://USER/NAME of either; may be given without its key"""
    data: str = ""
    """dataset to look at through an encoder; by default the one it was trained on"""
    encoder: str = ""
    """where an agent's encoder is now, if it has moved since training"""
    host: str = "127.0.0.1"
    """address to serve on; 0.0.0.0 lets other machines in"""
    port: int = 0
    """port to serve on; 0 takes a free one"""
    save: str = ""
    """write a page that holds everything itself (.html) and end, without a server"""
    png: str = ""
    """write a contact sheet (.png) and end, without a server"""
    mp4: str = ""
    """write a video (.mp4) and end, without a server"""
    frames: int = 24
    """frames in the page and in the video of a dataset or an encoder"""
    episodes: int = 5
    """evaluation episodes of an agent to choose from"""
    seed: int = 1
    """seed of an agent's episodes; training's own evaluations use 0"""
    threads: int = 2
    """threads that render the radiance field"""
    device: str = "auto"
    """where to encode and to render the radiance field: cpu, cuda, cuda:1 or auto (a GPU if there is one)"""
    overwrite: bool = False
    """replace existing files"""

    def __post_init__(self) -> None:
        for name, suffix in _SUFFIXES.items():
            value = getattr(self, name)
            if value and not value.endswith(suffix):
                raise UserError(f"--{name} must be an {suffix} file, got {value}")
        if not 0 <= self.port < 65536:
            raise UserError(f"--port must be in 0 to 65535, got {self.port}")
        for name in ("frames", "episodes", "threads"):
            if getattr(self, name) < 1:
                raise UserError(f"--{name} must be at least 1, got {getattr(self, name)}")
        check_device_name(self.device)
        if self.seed < 0:
            raise UserError(f"--seed must not be negative, got {self.seed}")

    @property
    def files(self) -> dict[str, Path]:
        """The files to write instead of serving, by key."""
        return {name: Path(getattr(self, name)) for name in _SUFFIXES if getattr(self, name)}
