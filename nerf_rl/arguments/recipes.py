"""Recipe files as somebody hands them in: looked at before they are turned into values.

YAML can repeat a part by a name, and parts that repeat parts grow without end; it can nest without end, too. Both are
found from the file's tokens, which take no more room than the file.
"""

from pathlib import Path

import yaml

from nerf_rl.errors import MissingFileError

_MOST_BYTES = 1 << 20
_MOST_VALUES = 100_000
_DEEPEST = 50
_REMEDY = "give a YAML file such as datasets/drawer-open.yaml; --print_config shows all keys"


def check_recipe(path: Path) -> None:
    """Check that a file is YAML of a size that a recipe can have.

    What is no regular file, such as a pipe, can be read only once and is left to the parser.

    Raises:
        MissingFileError: it is not.
    """
    if not path.is_file():
        return
    try:
        if path.stat().st_size > _MOST_BYTES:
            raise ValueError(f"it is larger than {_MOST_BYTES} bytes")
        text = path.read_text(encoding="utf-8")
        _count(text)
        top = yaml.compose(text, yaml.SafeLoader)
        if isinstance(top, yaml.MappingNode) and any(key.value == "config" for key, _ in top.value):
            raise ValueError("it has a key 'config', which is for arguments: give each recipe by a --config of its own")
    except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
        raise MissingFileError("a recipe", path, str(error) or "it cannot be read", _REMEDY) from error


def _count(text: str) -> None:
    """Raise ValueError if a YAML text, with its repetitions written out, nests too deeply or has too many values."""
    sizes: dict[str, int] = {}
    open_parts: list[tuple[str | None, int]] = []  # of each its name, and how many values there were before it
    values = 0
    for event in yaml.parse(text, yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            if any(name == event.anchor for name, _ in open_parts):
                raise ValueError(f"'{event.anchor}' repeats itself")
            values += sizes.get(str(event.anchor), 1)
        elif isinstance(event, yaml.NodeEvent):
            values += 1
            if isinstance(event, yaml.CollectionStartEvent):
                open_parts.append((event.anchor, values - 1))
            elif event.anchor:
                sizes[event.anchor] = 1
        elif isinstance(event, yaml.CollectionEndEvent):
            name, before = open_parts.pop()
            if name:
                sizes[name] = values - before
        if len(open_parts) > _DEEPEST:
            raise ValueError(f"it is nested more than {_DEEPEST} deep")
        if values > _MOST_VALUES:
            raise ValueError(f"it has more than {_MOST_VALUES} values")
