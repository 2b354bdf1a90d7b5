"""What tests of agents share."""

from collections.abc import Iterator

import pytest
from gymnasium.vector import AsyncVectorEnv
from tiny_environment import point_envs


@pytest.fixture(scope="module")
def envs() -> Iterator[AsyncVectorEnv]:
    """Two tiny environments, in which an episode has twelve steps and an action is held for two of them."""
    envs = point_envs(2, steps=12, repeat=2)
    yield envs
    envs.close(terminate=True)
