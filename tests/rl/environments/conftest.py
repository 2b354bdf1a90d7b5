"""What tests of environments share."""

import sys
from pathlib import Path

import own_environments
import pytest


@pytest.fixture
def findable(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let worker processes import the example and the tests' own environments, as a user's PYTHONPATH does."""
    monkeypatch.syspath_prepend(str(own_environments.ROOT / "examples"))
    assert str(Path(own_environments.__file__).parent) in sys.path
