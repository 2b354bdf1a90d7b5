"""Keys of ``nerf-rl view``; importing this module loads nothing heavy."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from nerf_rl.arguments.limits import Count, Limits, Processes, Seed, check_values
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
    port: Annotated[int, Limits(least=0, most=65535)] = 0
    """port to serve on; 0 takes a free one"""
    save: str = ""
    """write a page that holds everything itself (.html) and end, without a server"""
    png: str = ""
    """write a contact sheet (.png) and end, without a server"""
    mp4: str = ""
    """write a video (.mp4) and end, without a server"""
    frames: Count = 24
    """frames in the page and in the video of a dataset or an encoder"""
    episodes: Count = 5
    """evaluation episodes of an agent to choose from"""
    seed: Seed = 1
    """seed of an agent's episodes; training's own evaluations use 0"""
    threads: Processes = 2
    """threads that render the radiance field"""
    device: str = "auto"
    """where to encode and to render the radiance field: cpu, cuda, cuda:1 or auto (a GPU if there is one)"""
    overwrite: bool = False
    """replace existing files"""

    def __post_init__(self) -> None:
        check_values(self)
        for name, suffix in _SUFFIXES.items():
            value = getattr(self, name)
            if value and not value.endswith(suffix):
                raise UserError(f"--{name} must end in {suffix}, got {value}")
        check_device_name(self.device)

    @property
    def files(self) -> dict[str, Path]:
        """The files to write instead of serving, by key."""
        return {name: Path(getattr(self, name)) for name in _SUFFIXES if getattr(self, name)}
