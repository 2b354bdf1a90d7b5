"""A reader's folder for the pages of a test file."""

from pathlib import Path

import pytest
from world import World


@pytest.fixture(scope="module")
def world(tiny_dataset: Path, tiny_encoder: Path, tiny_agent: Path, tmp_path_factory: pytest.TempPathFactory) -> World:
    """Where blocks are run in the order of the pages, with a dataset, an encoder and an agent from the start."""
    made = {
        **dict.fromkeys(("data/drawer", "data/demo"), tiny_dataset),
        **dict.fromkeys(("runs/encoder", "runs/demo/encoder"), tiny_encoder),
        **dict.fromkeys(("runs/agent", "runs/demo/agent"), tiny_agent),
    }
    return World(tmp_path_factory.mktemp("checkout"), made)
