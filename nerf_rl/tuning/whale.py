"""The Whale Optimisation Algorithm (Mirjalili and Lewis, Advances in Engineering Software 95, 2016).

P whales at positions [P, D] follow the best position found so far, the leader [D]. With X a whale's position, X* the
leader's, X_r that of a random whale, and r1, r2, p, q uniform in [0, 1):

    A = 2 a r1 - a,  C = 2 r2,  l = (a2 - 1) q + 1,  a from 2 to 0 and a2 from -1 to -2 over the iterations

    p < 0.5, |A| < 1     encircle the leader        X <- X* - A |C X* - X|
    p < 0.5, |A| >= 1    search                     X <- X_r - A |C X_r - X|
    p >= 0.5             spiral to the leader       X <- |X* - X| exp(l) cos(2 pi l) + X*

The paper and the program that its authors released (``WOA.m``) disagree; *faithful* is the program, since the published
figures are its own:

1. A and C are numbers for each whale; in the paper they are vectors with a number for each dimension.
2. A random whale is drawn anew in each dimension; in the paper once for each whale.
3. l reaches down to a2, which falls to -2; in the paper l is uniform in [-1, 1].
4. Whales move one after another, and a random whale may have moved already; the paper's whales move together.

C multiplies positions, so the search depends on where the origin lies: with the leader at the origin, C has no effect
and whales contract onto it, which is why functions with their minimum at zero are solved to 1e-75. *shift_invariant*
multiplies positions relative to the mean of the population instead, |C (X* - m) - (X - m)|, so that moving the box and
the function moves the search along and changes nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray

MODES = ("faithful", "shift_invariant")


@dataclass(frozen=True)
class Found:
    """What a search ends with."""

    position: Float[ndarray, "D"]
    """of the least value found"""
    value: float
    """the least value found"""
    history: Float[ndarray, "T"]
    """the least value after each iteration"""


def next_positions(
    positions: Float[ndarray, "P D"],
    leader: Float[ndarray, "D"],
    progress: float,
    rng: np.random.Generator,
    mode: str = "faithful",
) -> Float[ndarray, "P D"]:
    """Move every whale once; the result may lie outside the box, and is to be clipped before it is evaluated.

    Args:
        positions: of the whales.
        leader: the best position found so far.
        progress: share of the iterations that are done, in [0, 1].
        rng: of this step; its numbers are taken in the order of the authors' program.
        mode: faithful or shift_invariant.
    """
    a, a2 = 2.0 - 2.0 * progress, -1.0 - progress
    centre = np.zeros_like(leader) if mode == "faithful" else positions.mean(axis=0)
    moved = positions - centre
    leader = leader - centre
    count, dimensions = moved.shape
    every_dimension = np.arange(dimensions)
    for whale in moved:
        r1, r2, q, p = rng.random(4)
        A, C, l = 2.0 * a * r1 - a, 2.0 * r2, (a2 - 1.0) * q + 1.0  # noqa: E741 (the paper's letter)
        if p >= 0.5:
            whale[:] = np.abs(leader - whale) * np.exp(l) * np.cos(2.0 * np.pi * l) + leader
        else:
            target = leader if abs(A) < 1.0 else moved[(count * rng.random(dimensions)).astype(int), every_dimension]
            whale[:] = target - A * np.abs(C * target - whale)
    return moved + centre


def minimise(
    function: Callable[[Float[ndarray, "P D"]], Float[ndarray, "P"]],
    low: Float[ndarray, "D"],
    high: Float[ndarray, "D"],
    population: int,
    iterations: int,
    rng: np.random.Generator,
    mode: str = "faithful",
) -> Found:
    """Search a box for a function's least value.

    Args:
        function: of a whole population.
        low, high: corners of the box.
        population: number of whales.
        iterations: evaluations of each whale.
        rng: of the whole search.
        mode: faithful or shift_invariant.
    """
    positions = low + rng.random((population, len(low))) * (high - low)
    leader, least = positions[0], np.inf
    history = np.empty(iterations)
    for iteration in range(iterations):
        positions = np.clip(positions, low, high)
        values = function(positions)
        if values.min() < least:
            best = int(values.argmin())
            leader, least = positions[best].copy(), float(values[best])
        history[iteration] = least
        positions = next_positions(positions, leader, iteration / iterations, rng, mode)
    return Found(leader, least, history)
