"""A Hub in miniature for the tests of this folder, and the library's settings that lead to it."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from local_hub import TOKEN, LocalHub, running_hub


@pytest.fixture
def hub(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalHub]:
    """A running server that this process and those it starts take for the Hub, with an empty cache beside it."""
    constants = pytest.importorskip("huggingface_hub.constants", reason="the extra hub is not installed")
    with running_hub() as hub:
        settings = {"ENDPOINT": hub.address, "HF_HUB_CACHE": str(tmp_path / "hub"), "HF_HUB_DISABLE_XET": True}
        settings["HUGGINGFACE_CO_URL_TEMPLATE"] = f"{hub.address}/{{repo_id}}/resolve/{{revision}}/{{filename}}"
        settings |= {"HF_TOKEN_PATH": str(tmp_path / "no token"), "HF_STORED_TOKENS_PATH": str(tmp_path / "no tokens")}
        for name, value in settings.items():  # read when the library was imported
            monkeypatch.setattr(constants, name, value)
        variables = {"HF_ENDPOINT": hub.address, "HF_HOME": str(tmp_path), "HF_HUB_DISABLE_XET": "1"}
        for name, text in {**variables, "HF_TOKEN": TOKEN, "HF_HUB_DISABLE_TELEMETRY": "1"}.items():
            monkeypatch.setenv(name, text)
        for name in ("HF_HUB_OFFLINE", "HF_HUB_CACHE", "HTTP_PROXY", "http_proxy", "ALL_PROXY", "all_proxy"):
            monkeypatch.delenv(name, raising=False)
        yield hub
