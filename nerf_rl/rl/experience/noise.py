"""Exploration for several environments at once: additive noise, and random actions that are held for a while."""

import math

import numpy as np
from jaxtyping import Float
from numpy import ndarray

from nerf_rl.rl.config import NoiseConfig

_REST_SHARE = 1 / 3  # of held actions anywhere


def linear_schedule(start: float, end: float, duration: int, step: int) -> float:
    """Return the value at ``step`` of a line from ``start`` at 0 to ``end`` at ``duration``, constant afterwards."""
    return start + (end - start) * min(max(step / duration, 0.0), 1.0)


class Noise:
    """Additive noise [E, A] for E environments and A action components.

    All kinds have the scheduled standard deviation s and differ only in correlation. ``gaussian`` is independent.
    ``ou`` is x <- (1 - theta) x + s sqrt(1 - (1 - theta)^2) n with standard normal n, whose stationary standard
    deviation is s (Uhlenbeck and Ornstein 1930, in discrete time), started from its stationary distribution. ``pink``
    has a power spectrum of 1 / frequency over ``length`` steps (Eberhard et al. 2023), from trembling to leaning one
    way, of which an episode that the environment itself ends sooner has the first.

    Args:
        length: most agent steps of an episode, or fewer; pink noise repeats after that.
    """

    def __init__(self, config: NoiseConfig, envs: int, action_size: int, length: int, rng: np.random.Generator):
        self._config, self._rng, self._length = config, rng, length
        self._keep = 1.0 - config.theta if config.kind == "ou" else 0.0
        self._unit = rng.standard_normal((envs, action_size))
        self._pink = np.zeros((envs, length, action_size))
        self._step = np.zeros(envs, np.int64)
        for env in range(envs):
            self.reset(env)

    def scale(self, env_step: int) -> float:
        """Return the standard deviation after ``env_step`` environment steps."""
        return linear_schedule(self._config.start, self._config.end, self._config.decay_steps, env_step)

    def sample(self, env_step: int, least: Float[ndarray, "E"] | float = 0.0) -> Float[ndarray, "E A"]:
        """Return the next noise, of the scheduled standard deviation, or of ``least`` where that is more."""
        if self._config.kind == "pink":
            self._unit = self._pink[np.arange(len(self._pink)), self._step % self._length]
            self._step += 1
        else:
            fresh = self._rng.standard_normal(self._unit.shape)
            self._unit = self._keep * self._unit + math.sqrt(1.0 - self._keep**2) * fresh
        return np.maximum(least, self.scale(env_step)).reshape(-1, 1) * self._unit

    def reset(self, env: int) -> None:
        """Forget the past of one environment: its episode is over."""
        self._unit[env] = self._rng.standard_normal(self._unit.shape[1])
        if self._config.kind == "pink":
            self._pink[env] = pink_noise(self._length, self._unit.shape[1], self._rng)
            self._step[env] = 0


def pink_noise(length: int, channels: int, rng: np.random.Generator) -> Float[ndarray, "T A"]:
    """Return noise of unit variance whose power falls as 1 / frequency, made in the frequency domain.

    Timmer and Koenig, "On generating power law noise" (1995). The lowest frequency's power stands in for that at 0.
    """
    frequency = np.fft.rfftfreq(length)
    frequency[0] = frequency[1] if length > 1 else 1.0
    amplitude = frequency**-0.5
    shape = (len(frequency), channels)
    spectrum = amplitude[:, None] * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    spectrum[0] = spectrum[0].real * math.sqrt(2.0)
    if length % 2 == 0 and length > 1:
        spectrum[-1] = spectrum[-1].real * math.sqrt(2.0)
    edges = np.ones(len(frequency))
    edges[1 : (length + 1) // 2] = 2.0  # frequencies that stand for their negative as well
    variance = 2.0 * (edges * amplitude**2).sum() / length**2
    return np.fft.irfft(spectrum, length, axis=0) / math.sqrt(variance)


class EpsilonZGreedy:
    """Random actions, each held for a while: ez-greedy, temporally extended epsilon-greedy (Dabney et al. 2021).

    Independent noise trembles around one place; a policy that rests against a handle is only carried behind it by a
    motion that goes on in one direction, and that the policy does not counteract. Corners of the box move furthest. But
    where the agent is hardly ever at rest, it does not learn to set off again: a third of the actions *anywhere* are
    zero.
    """

    def __init__(self, envs: int, action_size: int, mean_steps: int, rng: np.random.Generator, kind: str = "corner"):
        self._rng, self._mean, self._kind = rng, mean_steps, kind
        self._left = np.zeros(envs, np.int64)
        self._action = np.zeros((envs, action_size), np.float32)

    def override(self, action: Float[ndarray, "E A"], share: float | Float[ndarray, "E"]) -> Float[ndarray, "E A"]:
        """Return the actions, some of them replaced.

        Args:
            action: what the environments would do otherwise.
            share: of steps to replace in the long run, one for all environments or for each: a hold starts with the
                probability p for which p mean / (p mean + 1 - p) is the share.
        """
        start_probability = share / (share + self._mean * (1.0 - share))
        start = (self._left == 0) & (self._rng.random(len(self._left)) < start_probability)
        for env in np.flatnonzero(start).tolist():
            self._begin(env)
        held = self._left > 0
        self._left[held] -= 1
        return np.where(held[:, None], self._action, action)

    def reset(self, env: int, start_probability: float = 0.0) -> None:
        """End the hold of one environment, as its episode is over; start the next with one, with some probability."""
        self._left[env] = 0
        if self._rng.random() < start_probability:
            self._begin(env)

    def _begin(self, env: int) -> None:
        self._left[env] = self._rng.geometric(1.0 / self._mean)
        size = self._action.shape[1]
        if self._kind == "corner":
            self._action[env] = self._rng.choice((-1.0, 1.0), size)
        else:
            rests = self._rng.random() < _REST_SHARE
            self._action[env] = 0.0 if rests else self._rng.uniform(-1.0, 1.0, size)
