"""From an address on the Hub to a folder on this machine."""

import multiprocessing
import sys
from pathlib import Path
from typing import Any

from nerf_rl import __version__
from nerf_rl.hub.address import Address, is_address, parse_address
from nerf_rl.hub.failures import told_plainly

ENCODER_IN_AGENT = "encoder"
"""folder of an agent's repository that holds its encoder"""
_ENCODER = ("encoder.json", "encoder.safetensors", "field.json", "field.safetensors")
FILES = (
    *_ENCODER,
    *("policy.json", "policy.safetensors", "summary.json"),
    *(f"{ENCODER_IN_AGENT}/{name}" for name in _ENCODER),
)
"""All that is ever fetched: JSON and safetensors, which cannot execute code. Whatever else a repository holds stays."""


def resolve(path: Path | str) -> Path:
    """Return where an artefact is on this machine; one on the Hub is fetched first.

    What was fetched once is kept in the cache of huggingface_hub. An address that names a commit is looked for there
    alone if it is there; others are asked for again, as long as there is a network.

    Args:
        path: a path, which is returned as it is, or an address.

    Raises:
        UserError: no such address or repository, no permission, no network, or the extra ``hub`` is not installed.
    """
    return _fetch(parse_address(path)) if is_address(path) else Path(path)


def lasting(path: Path | str) -> str:
    """Return what means the same artefact later, and from everywhere: an absolute path, or an address with its commit.

    Raises:
        UserError: as :func:`resolve`.
    """
    folder = resolve(path)
    if not is_address(path):
        return str(folder.resolve())
    return str(Address(parse_address(path).repository, folder.name))  # the cache names folders by commits


def _fetch(address: Address) -> Path:
    with told_plainly(address, "fetched"):
        import huggingface_hub

        return Path(
            huggingface_hub.snapshot_download(
                address.repository,
                revision=address.revision or None,
                allow_patterns=list(FILES),
                library_name="nerf-rl",
                library_version=__version__,
                tqdm_class=_bar(),
            )
        )


def _bar() -> Any:
    """Return the kind of progress bar to show: none where nobody looks, and in processes that only act in a scene."""
    from huggingface_hub.utils import tqdm

    class Silent(tqdm):
        def __init__(self, *arguments: Any, **keys: Any):
            super().__init__(*arguments, **{**keys, "disable": True})

    return tqdm if sys.stderr.isatty() and multiprocessing.parent_process() is None else Silent
