"""The functions F1 to F10 on which the Whale Optimisation Algorithm was published (its tables 1 and 2).

Each takes a population [P, D] and returns its values [P].
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray


@dataclass(frozen=True)
class Classical:
    """A function to be minimised."""

    name: str
    """as in the paper, with its common name"""
    half_width: float
    """the box is [-half_width, half_width] in every dimension"""
    values: Callable[[Float[ndarray, "P D"]], Float[ndarray, "P"]]
    """of a population"""

    def shifted(self, share: float) -> "Classical":
        """Return the function moved by a share of the half width in every dimension; the box stays where it is."""
        shift = share * self.half_width
        return Classical(f"{self.name}, moved", self.half_width, lambda x: self.values(x - shift))


def _schwefel_2_22(x: ndarray) -> ndarray:
    return np.abs(x).sum(-1) + np.abs(x).prod(-1)


def _rosenbrock(x: ndarray) -> ndarray:
    return (100.0 * (x[:, 1:] - x[:, :-1] ** 2) ** 2 + (x[:, :-1] - 1.0) ** 2).sum(-1)


def _quartic(x: ndarray) -> ndarray:
    """Return the quartic function without the noise that the paper adds."""
    return (np.arange(1, x.shape[1] + 1) * x**4).sum(-1)


def _rastrigin(x: ndarray) -> ndarray:
    return (x**2 - 10.0 * np.cos(2.0 * np.pi * x) + 10.0).sum(-1)


def _ackley(x: ndarray) -> ndarray:
    slope = -20.0 * np.exp(-0.2 * np.sqrt((x**2).mean(-1)))
    return slope - np.exp(np.cos(2.0 * np.pi * x).mean(-1)) + 20.0 + np.e


CLASSICAL = {
    "F1": Classical("F1, sphere", 100.0, lambda x: (x**2).sum(-1)),
    "F2": Classical("F2, Schwefel 2.22", 10.0, _schwefel_2_22),
    "F3": Classical("F3, Schwefel 1.2", 100.0, lambda x: (x.cumsum(-1) ** 2).sum(-1)),
    "F4": Classical("F4, Schwefel 2.21", 100.0, lambda x: np.abs(x).max(-1)),
    "F5": Classical("F5, Rosenbrock", 30.0, _rosenbrock),
    "F6": Classical("F6, step", 100.0, lambda x: (np.floor(x + 0.5) ** 2).sum(-1)),
    "F7": Classical("F7, quartic", 1.28, _quartic),
    "F8": Classical("F8, Schwefel 2.26", 500.0, lambda x: (-x * np.sin(np.sqrt(np.abs(x)))).sum(-1)),
    "F9": Classical("F9, Rastrigin", 5.12, _rastrigin),
    "F10": Classical("F10, Ackley", 32.0, _ackley),
}
