"""A headless Chromium for the tests of this folder."""

import re
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from looking import Look

_FLAGS = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run"
_FLAGS += " --disable-background-networking --disable-component-update --disable-sync"


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark all tests of this folder."""
    for item in items:
        if Path(__file__).parent in Path(item.path).parents:
            item.add_marker("browser")


@pytest.fixture(scope="session")
def chromium(tiny_agent: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A headless browser with software rendering and a profile of its own.

    What it is to look at is made before it starts: PyTorch must not be imported first inside Playwright's own loop.
    """
    sync_api = pytest.importorskip("playwright.sync_api")
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    assert executable, "no Chromium found; make test-browser installs it where it may"
    with sync_api.sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=executable,
            headless=True,
            viewport={"width": 1400, "height": 900},
            args=_FLAGS.split(),
        )
        yield context
        context.close()


@pytest.fixture
def look(chromium: Any, request: pytest.FixtureRequest) -> Iterator[Look]:
    """A fresh page; at the end it must have logged no error and asked nothing of other machines."""
    page = Look(chromium, re.sub(r"\W+", "-", request.node.name))
    yield page
    page.keep("end")
    page.page.close()
    assert page.errors == [] and page.foreign == []
