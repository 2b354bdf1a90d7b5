"""What is wrong with a key or a value, in one sentence that lists what is available, from the parser's message."""

import dataclasses
import re
import typing
from collections.abc import Iterator
from typing import Any

from nerf_rl.errors import UnknownNameError, UserError

RENAMED = {
    "radiance_field.moving_frames": "radiance_field.free_frames",
    "sampling.training_approach": "sampling.training_free_space",
    "sampling.approach_reach": "sampling.free_space_reach",
    "sharp_at": "coarse_to_fine",
    "noise.hold_share": "noise.epsilon_z",
    "noise.hold_start": "noise.epsilon_z_start",
    "noise.hold_steps": "noise.epsilon_z_steps",
    "noise.hold_kind": "noise.epsilon_z_kind",
}
"""What keys of earlier versions are called now."""
_PLAIN = (  # what the parser says, and what of it is told
    (r"\s+", " "),
    (r"[Gg]roup '([^']+)' does not accept option '([^']+)'", r"Option '\1.\2' is not accepted"),
    (r'Parser key "([\w.]+)": .*NestedArg\(key=\'(\w+)\'.*', r"Option '\1.\2' is not accepted"),
    (r"Problem with given class_path '[^']+': ", ""),
    (r'Parser key "([\w.]+)": Unable to load config \'[^\']*\' - Parser key "\1": (?=Unable)', r'Parser key "\1": '),
    (r"Unable to load config '.*' - (?=Parser key)", ""),  # of keys in one word, one of which is told
    (r'Unable to load config "(.*)"$', r"expected keys, or a file of them, got \1"),
    (r"Unable to load config '(.*?)' - (?!Parser key)", r"\1 cannot be read: "),
    (
        r"Subclasses are disabled for \w+, thus '(.*)' is not accepted as .*",
        r"expected keys, or a file of them, got \1",
    ),
    (r"Not a valid subclass of \w+\. Got value: (.*) Subclass types expect one of: .*", r"expected keys, got \1"),
    (r"Expected a <class '(\w+)'>\. Got value: ", r"expected \1, got "),
)
_UNION = re.compile(r"Does not validate against any of the Union subtypes Subtypes: \[(.*)\] Errors: .* Given value: ")


def explain(message: str, config: type) -> UserError:
    """Turn the parser's message on the keys of a dataclass into one sentence that lists what is available."""
    message = message.strip()
    for said, told in _PLAIN:
        message = re.sub(said, told, message)
    unknown = re.search(r"Option '([^']+)' is not accepted|[Uu]nrecognized arguments?: (?:--)?([^\s=]+)", message)
    if unknown:
        name, known = unknown[1] or unknown[2], set(keys_of(config))
        if RENAMED.get(name) in known:
            return UserError(f"key '{name}' is now '{RENAMED[name]}'")
        return UnknownNameError("key", name, known)
    words = re.search(r'Parser key "([\w.]+)": Expected a typing\.Literal\[([^\]]*)\]\. Got value: (.*)', message)
    if words:
        return UnknownNameError(words[1], words[3], re.findall(r"'([^']*)'", words[2]))
    missing = re.search(r"the following arguments are required: (.+)", message)
    if missing:
        return UserError(f"missing --{missing.group(1).replace(', ', ', --')}")
    message = _UNION.sub(lambda union: f"expected {_kinds(union[1])}, got ", message)
    message = re.sub(r'(?:Parser key "[^"]+": ?)+', lambda keys: f"--{_innermost(keys[0])}: ", message)
    return UserError(message[0].lower() + message[1:])


def keys_of(config: type, prefix: str = "") -> Iterator[str]:
    """Yield the dotted keys of a dataclass, those of dataclasses inside lists as ``list.key``."""
    hints = typing.get_type_hints(config)
    for field in dataclasses.fields(config):
        if part := part_of(hints[field.name]):
            yield from keys_of(part, f"{prefix}{field.name}.")
        else:
            yield f"{prefix}{field.name}"


def part_of(hint: Any) -> type | None:
    """Return the dataclass that a key's type is, or is a list or dictionary of; None if there is none."""
    kinds = (kind for kind in (hint, *typing.get_args(hint)) if dataclasses.is_dataclass(kind))
    return typing.cast(type | None, next(kinds, None))


def _innermost(keys: str) -> str:
    """Return the last of the keys around a value, each within the one before, as the parser tells them."""
    told = ""
    for key in re.findall(r'"([^"]+)"', keys):
        told = key if not told or key.startswith(f"{told}.") else f"{told}: {key}"
    return told


def _kinds(types: str) -> str:
    """Return what a union takes, from the names of its types as the parser tells them."""
    names = re.findall(r"<class '(\w+)'>|Annotated\[(\w+)|(list)\[", types)
    return " or ".join("null" if name == "NoneType" else name for name in map("".join, names))
