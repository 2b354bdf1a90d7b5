"""The Whale Optimisation Algorithm against the authors' program, its published figures, and its own symmetry."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from numpy import ndarray

from nerf_rl.tuning.whale import MODES, minimise, next_positions
from tools.bench.classical_functions import CLASSICAL, Classical


def published_program(
    function: Callable[[ndarray], ndarray], half_width: float, whales: int, dimensions: int, iterations: int, seed: int
) -> tuple[list[list[list[float]]], float]:
    """WOA.m, number by number, as its authors released it; return the evaluated populations and the best score."""
    rand = np.random.default_rng(seed).random
    positions = [[-half_width + rand() * 2 * half_width for _ in range(dimensions)] for _ in range(whales)]
    leader_position, leader_score = [0.0] * dimensions, math.inf
    evaluated = []
    for t in range(iterations):
        for i in range(whales):
            for j in range(dimensions):
                positions[i][j] = min(max(positions[i][j], -half_width), half_width)
            fitness = float(function(np.array([positions[i]]))[0])
            if fitness < leader_score:
                leader_score, leader_position = fitness, list(positions[i])
        evaluated.append([list(position) for position in positions])
        a = 2 - t * (2 / iterations)
        a2 = -1 + t * (-1 / iterations)
        for i in range(whales):
            r1, r2 = rand(), rand()
            A, C = 2 * a * r1 - a, 2 * r2
            b, l = 1, (a2 - 1) * rand() + 1  # noqa: E741
            p = rand()
            for j in range(dimensions):
                if p < 0.5:
                    if abs(A) >= 1:
                        x_rand = positions[math.floor(whales * rand())]
                        positions[i][j] = x_rand[j] - A * abs(C * x_rand[j] - positions[i][j])
                    else:
                        positions[i][j] = leader_position[j] - A * abs(C * leader_position[j] - positions[i][j])
                else:
                    distance = abs(leader_position[j] - positions[i][j])
                    positions[i][j] = distance * math.exp(b * l) * math.cos(l * 2 * math.pi) + leader_position[j]
    return evaluated, leader_score


@pytest.mark.parametrize("name", ["F1", "F5", "F9"])
def test_every_generation_is_that_of_the_published_program_on_one_random_stream(name: str) -> None:
    function, generations = CLASSICAL[name], []

    def recorded(positions: ndarray) -> ndarray:
        generations.append(positions.copy())
        return function.values(positions)

    low, high = np.full(6, -function.half_width), np.full(6, function.half_width)
    found = minimise(recorded, low, high, 8, 60, np.random.default_rng(3))
    expected, least = published_program(function.values, function.half_width, 8, 6, 60, 3)
    assert np.allclose(generations, expected, rtol=1e-9, atol=1e-12)
    assert found.value == pytest.approx(least, rel=1e-9)


def median(function: Classical, mode: str, seeds: int = 3) -> float:
    corner = np.full(30, function.half_width)
    found = [minimise(function.values, -corner, corner, 30, 500, np.random.default_rng(s), mode) for s in range(seeds)]
    return float(np.median([search.value for search in found]))


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("F1", 0, 1e-65), ("F5", 26, 29), ("F9", 0, 1e-12), ("F10", 0, 1e-14), ("F4", 10, 100)],
)
def test_thirty_whales_find_the_published_values_in_500_iterations(name: str, low: float, high: float) -> None:
    assert low <= median(CLASSICAL[name], "faithful") <= high


@pytest.mark.benchmark
@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("F2", 0, 1e-45), ("F3", 5e3, 1e5), ("F6", 0, 2), ("F7", 0, 1e-60), ("F8", -12570, -7000)],
)
def test_thirty_whales_find_the_other_published_values_too(name: str, low: float, high: float) -> None:
    assert low <= median(CLASSICAL[name], "faithful", seeds=5) <= high


def test_the_published_sphere_is_found_only_because_its_minimum_is_at_zero() -> None:
    assert 5 < median(CLASSICAL["F1"].shifted(0.4), "faithful") < 500


@pytest.mark.parametrize("mode", MODES)
def test_moving_box_and_leader_moves_the_whales_along_in_shift_invariant_mode_only(mode: str) -> None:
    rng = np.random.default_rng(0)
    positions, leader, shift = rng.normal(size=(20, 5)), rng.normal(size=5), rng.normal(size=5)
    for progress in (0.0, 0.4, 0.9):
        moved = next_positions(positions, leader, progress, np.random.default_rng(1), mode)
        moved_there = next_positions(positions + shift, leader + shift, progress, np.random.default_rng(1), mode)
        assert np.allclose(moved + shift, moved_there) == (mode == "shift_invariant")


def test_a_whole_search_is_moved_along_in_shift_invariant_mode() -> None:
    low, high, shift = np.full(4, -1.0), np.full(4, 3.0), np.array([8.0, -4.0, 16.0, 0.5])  # exact in binary
    here = minimise(lambda x: (x**2).sum(-1), low, high, 10, 30, np.random.default_rng(2), "shift_invariant")
    there = minimise(
        lambda x: ((x - shift) ** 2).sum(-1),
        low + shift,
        high + shift,
        10,
        30,
        np.random.default_rng(2),
        "shift_invariant",
    )
    assert np.allclose(here.position + shift, there.position)
    assert np.allclose(here.history, there.history)


def test_positions_given_are_left_as_they_are() -> None:
    positions = np.random.default_rng(0).normal(size=(5, 3))
    before = positions.copy()
    for mode in MODES:
        next_positions(positions, positions[0], 0.5, np.random.default_rng(0), mode)
        assert np.array_equal(positions, before)
