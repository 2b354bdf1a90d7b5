"""What annotations say is checked in tests, whether there are arrays in them or not."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, Literal

import beartype
import jaxtyping
import numpy as np
import pytest
from annotations import CHECKED_CALLS, check_anew, has_arrays
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.files.json_files import write_json
from nerf_rl.pretrain.measures.probe_targets import length_error
from nerf_rl.rl.sweeps.seed_list import parse_seeds


def of_arrays(rows: Float[ndarray, "N"]) -> None: ...
def of_arrays_perhaps(rows: int, other: dict[str, list[Float[ndarray, "N"]]] | None = None) -> None: ...
def makes_arrays() -> Iterator[Float[ndarray, "N"]]: ...
def takes_what_takes_arrays(function: Callable[[Float[ndarray, "N"]], int]) -> None: ...
def named_later(rows: "Rows") -> None: ...
def of_numbers(
    rows: int, kind: Literal["rows", "columns"], call: Callable[..., Any], untold=None
) -> tuple[str, ...]: ...


Rows = Float[ndarray, "N"]


@pytest.mark.parametrize("function", [of_arrays, of_arrays_perhaps, makes_arrays, takes_what_takes_arrays, named_later])
def test_arrays_are_found_wherever_an_annotation_names_them(function):
    assert has_arrays(function)


def test_where_there_are_none_none_are_found():
    assert not has_arrays(of_numbers)


def test_an_axis_of_one_name_has_one_length():
    assert length_error(np.ones((3, 1)), np.zeros((3, 1))).shape == (3,)
    with pytest.raises(jaxtyping.TypeCheckError, match="length_error"):
        length_error(np.ones((3, 1)), np.zeros((2, 1)))


def test_a_function_without_arrays_takes_what_it_says():
    with pytest.raises(beartype.roar.BeartypeCallHintViolation, match="write_json"):
        write_json("a path that is a string", {})  # type: ignore[arg-type]
    with pytest.raises(beartype.roar.BeartypeCallHintViolation, match="parse_seeds"):
        parse_seeds(7)  # type: ignore[arg-type]


def test_a_function_without_arrays_returns_what_it_says():
    @jaxtyping.jaxtyped(typechecker=beartype.beartype)
    def count(said: Any) -> int:
        return said

    assert count(3) == 3
    with pytest.raises(beartype.roar.BeartypeCallHintViolation, match="count"):
        count("three")


def test_a_function_that_is_called_often_is_checked_at_first_and_now_and_then():
    @jaxtyping.jaxtyped(typechecker=beartype.beartype)
    def count(said: Any) -> int:
        return said

    def is_checked() -> bool:
        with contextlib.suppress(beartype.roar.BeartypeCallHintViolation):
            count("three")
            return False
        return True

    found = [is_checked() for _ in range(2 * CHECKED_CALLS)]
    assert all(found[:CHECKED_CALLS]) and found[-1] and not any(found[CHECKED_CALLS:-1])
    check_anew()
    assert is_checked()
