"""Keys of ``nerf-rl push``; importing this module loads nothing heavy."""

import re
from dataclasses import dataclass, field

from nerf_rl.errors import UserError
from nerf_rl.hub.address import Address, parse_address


@dataclass
class PushConfig:
    """Keys of ``nerf-rl push``."""

    run: str
    """run folder of pretrain or of train-rl; may be given without its key"""
    to: str = ""
    """USER/NAME on the Hugging Face Hub (extra hub), or USER/NAME@BRANCH; it is made if there is none"""
    out: str = ""
    """folder to write what is pushed to, to look at first; without --to nothing leaves this machine"""
    private: bool = False
    """let nobody else see a repository that is made"""
    licence: str = "mit"
    """of the weights, as the Hub names them: mit, apache-2.0, cc-by-4.0, ..."""
    controls: list[str] = field(default_factory=list)
    """with an agent: run folders of train-rl --control blind or random, to stand beside its success rate"""
    encoder: str = ""
    """with an agent: where its encoder is now, if it has moved since training"""

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z0-9][a-z0-9.-]*", self.licence):
            raise UserError(f"--licence is a name such as mit, apache-2.0 or cc-by-4.0, got '{self.licence}'")
        if self.to:
            parse_address(self.to)

    @property
    def address(self) -> Address | None:
        """Where to push to; None to push nowhere."""
        return parse_address(self.to) if self.to else None
