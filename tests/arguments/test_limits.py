"""What keys take: refused in a sentence, whoever makes the configuration, and told by help."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, is_dataclass
from importlib import import_module
from types import UnionType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import pytest

from nerf_rl import cli
from nerf_rl.arguments.limits import Count, Limits, Positive, PositiveShare, ShareBelowOne, check_values
from nerf_rl.errors import UserError


@dataclass
class Keys:
    workers: Annotated[int, Limits(least=1, most=8)] = 2
    episodes: Count = 1
    size: Annotated[float, Limits(least=0, most=4)] = 1.0
    rate: Positive | None = None
    share: ShareBelowOne = 0.5
    part: PositiveShare = 0.5
    below: Annotated[int, Limits(below=3)] = 0
    above: Annotated[int, Limits(above=3)] = 4
    kind: Literal["red", "green"] = "red"
    widths: list[Count] = field(default_factory=lambda: [3])
    free: int = 0

    def __post_init__(self) -> None:
        check_values(self, "keys.")


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("workers", 0, "--keys.workers must be at least 1, got 0"),
        ("workers", 9, "--keys.workers must be at most 8, got 9"),
        ("workers", 10**400, "--keys.workers must be at most 8, got 1000"),
        ("episodes", 0, "--keys.episodes must be at least 1, got 0"),
        ("size", 5.0, "--keys.size must be in [0, 4], got 5.0"),
        ("size", -0.1, "--keys.size must be in [0, 4], got -0.1"),
        ("size", float("nan"), "--keys.size must be a finite number, got nan"),
        ("rate", 0.0, "--keys.rate must be positive, got 0.0"),
        ("share", 1.0, "--keys.share must be in [0, 1), got 1.0"),
        ("part", 0.0, "--keys.part must be in (0, 1], got 0.0"),
        ("below", 3, "--keys.below must be below 3, got 3"),
        ("above", 3, "--keys.above must be above 3, got 3"),
        ("kind", "gren", "unknown keys.kind 'gren' (did you mean green"),
        ("widths", [4, 0], "--keys.widths must be at least 1, got 0"),
    ],
)
def test_a_value_that_a_key_does_not_take_is_refused_in_a_sentence(key: str, value: Any, words: str):
    with pytest.raises(UserError, match=re.escape(words)):
        Keys(**{key: value})


@pytest.mark.parametrize(
    "keys",
    [
        {"workers": 1, "size": 0.0, "share": 0.0, "part": 1.0, "below": 2, "above": 4},
        {"workers": 8, "size": 4.0, "share": 0.999, "rate": 1e-9, "kind": "green", "widths": [], "free": -1},
    ],
)
def test_values_at_the_limits_are_taken(keys: dict[str, Any]):
    made = Keys(**keys)
    assert {name: getattr(made, name) for name in keys} == keys


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ("train-rl", ["--learner.gamma GAMMA", "in [0, 1]", "--noise.kind {gaussian,ou,pink}", "at least 1"]),
        ("pretrain", ["--precision {auto,32,bf16}", "in [1, 1024]", "positive"]),
    ],
)
def test_help_says_what_keys_take(command: str, words: list[str], capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit):
        cli.main([command, "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert all(word in told for word in words)


def numbers_of(config: type) -> Iterator[tuple[str, Any]]:
    """Yield each key of a configuration that takes a number, and all that its type says; with those of its parts."""
    for name, hint in get_type_hints(config, include_extras=True).items():
        parts = [hint, *get_args(hint)]
        parts += [
            argument for part in parts if get_origin(part) in (Annotated, UnionType) for argument in get_args(part)
        ]
        yield from (
            found for part in parts if isinstance(part, type) and is_dataclass(part) for found in numbers_of(part)
        )
        if {int, float} & {part for part in parts if isinstance(part, type)}:
            yield f"{config.__name__}.{name}", parts


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_number_has_limits(command: str):
    module, _, name = cli.COMMANDS[command].config.partition(":")
    without = {
        key
        for key, parts in numbers_of(getattr(import_module(module), name))
        if not any(isinstance(part, Limits) for part in parts)
    }
    looked_at_elsewhere = (
        "CameraConfig.",
        "RingConfig.",
        "DomeConfig.",
        "RandomCameraConfig.",
        "Range.",
        "ExportConfig.",
    )
    assert {key for key in without if not key.startswith(looked_at_elsewhere)} == set()
