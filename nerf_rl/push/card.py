"""What the cards of encoders and agents share: front matter as the Hub reads it, tables, licence."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import yaml

from nerf_rl import __version__
from nerf_rl.push.picture import PICTURE

CARD = "README.md"
LIBRARY = "nerf-rl"
UNKNOWN = "unknown"
NO_SUMMARY = "It came without a summary of its run."
_TOLD = ("mujoco", "metaworld", "gymnasium", "torch")  # of the packages whose versions are known


@dataclass(frozen=True)
class Naming:
    """What a card calls its artefact."""

    name: str
    """on the Hub, or of the folder"""
    address: str
    """to load it from"""
    licence: str
    """as the Hub names it"""
    pictured: bool
    """whether there is a picture beside the card"""


def front_matter(naming: Naming, task: str, tags: Iterable[str], metrics: Mapping[str, Any], scene: str) -> str:
    """Return the lines that the Hub reads.

    Args:
        naming: of the artefact.
        task: the Hub's name of what it is for.
        tags: beside the library's.
        metrics: figures by name, on the scene; what is None is left out.
        scene: its name.
    """
    known = [{"type": name, "value": round(value, 4)} for name, value in metrics.items() if value is not None]
    content: dict[str, Any] = {
        "license": naming.licence,
        "library_name": LIBRARY,
        "pipeline_tag": task,
        "tags": [LIBRARY, "robotics", "mujoco", *tags, scene.partition("/")[0]],
    }
    if known:
        result = {"task": {"type": task}, "dataset": {"type": scene, "name": scene}, "metrics": known}
        content["model-index"] = [{"name": naming.name.rpartition("/")[2], "results": [result]}]
    return f"---\n{yaml.safe_dump(content, sort_keys=False, allow_unicode=True)}---"


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines)


def picture(naming: Naming, caption: str) -> list[str]:
    """Return the picture with its caption, if there is one."""
    return [f"![{caption}]({PICTURE})"] if naming.pictured else []


def code(language: str, *lines: str) -> str:
    """Return a block of code in Markdown."""
    return "\n".join([f"```{language}", *lines, "```"])


def installing(naming: Naming) -> str:
    """Return how to get what the loading lines need."""
    extra = "[hub]" if naming.address.startswith("hf://") else ""
    return f"With nerf-rl, which is installed by `pip install '.{extra}'` in a checkout of it:"


def last_sections(naming: Naming, made: Sequence[tuple[str, Any]], packages: Mapping[str, str]) -> list[str]:
    """Return how the artefact was made, what its files can do, and the licence.

    Args:
        naming: of the artefact.
        made: names and values of how it was made; what is None is left out.
        packages: versions of what it was made with.
    """
    versions = ", ".join(f"{name} {packages[name]}" for name in _TOLD if name in packages)
    rows = [(name, f"{value:,}" if isinstance(value, int) else str(value)) for name, value in made if value is not None]
    return [
        "## How it was made",
        table(["", ""], [*rows, ("card written by", f"nerf-rl {__version__}"), ("versions", versions or UNKNOWN)]),
        "## Files",
        "Weights are safetensors and descriptions JSON: loading them executes no code. nerf-rl fetches these files by "
        "name and leaves all others where they are.",
        "## Licence",
        f"{naming.licence}",
    ]


def joined(parts: Iterable[str]) -> str:
    """Return a page of its parts."""
    return "\n\n".join(parts) + "\n"
