"""The viewer as a process, and a page of the browser that looks at it; screenshots are kept in .browser-tests/."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

SCREENSHOTS = Path(__file__).parents[2] / ".browser-tests"
SECONDS = float(os.environ.get("BROWSER_TEST_SECONDS", "60"))  # to wait for a condition; a slow machine may need them


class Viewer:
    """A running ``nerf-rl view``."""

    def __init__(self, *arguments: str):
        command = [sys.executable, "-m", "nerf_rl.cli", "view", *arguments]
        environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
        )
        assert self.process.stdout is not None
        self.url = ""
        for line in self.process.stdout:
            if found := re.search(r"http://localhost:\d+", line):
                self.url = found.group()
                break
        assert self.url, "the viewer ended before it said where to look"

    def interrupt(self) -> int:
        """Press Ctrl-C and return the exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(SECONDS)

    def close(self) -> None:
        """End it whatever it does."""
        self.process.kill()
        self.process.communicate()


class Look:
    """A page in the browser, with what it has logged."""

    def __init__(self, context: Any, name: str):
        self.page, self.name = context.new_page(), name
        self.errors: list[str] = []
        self.foreign: list[str] = []
        self.page.on("console", lambda m: self.errors.append(m.text) if m.type == "error" else None)
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("request", self._note)

    def open(self, url: str) -> None:
        """Open the viewer and wait until its controls and a drawn canvas are there."""
        self.page.goto(url)
        self.page.wait_for_selector("canvas", timeout=1000 * SECONDS)
        self.until(lambda: self.canvas().std() > 12, "the canvas stays blank")

    def picture(self, selector: str) -> np.ndarray:
        """Return the pixels of the first element that a selector finds."""
        content = self.page.locator(selector).first.screenshot(timeout=1000 * SECONDS)
        return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)

    def canvas(self) -> np.ndarray:
        """Return the pixels of the middle of the 3-D scene, where no panel lies."""
        content = self.page.screenshot(clip={"x": 460, "y": 200, "width": 620, "height": 500})
        return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR).astype(float)

    def status(self) -> str:
        """Return the line that says which frame is shown."""
        texts = self.page.eval_on_selector_all("p", "lines => lines.map(line => line.innerText)")
        return next((text for text in texts if "episode" in text or "step" in text), "")

    def frusta(self) -> list[tuple[float, float]]:
        """Return places on the page where the blue frames of the encoder's cameras are drawn, a few of them."""
        picture = cv2.imdecode(np.frombuffer(self.page.screenshot(), np.uint8), cv2.IMREAD_COLOR).astype(int)
        blue = (picture[..., 0] > 190) & (picture[..., 2] < 100) & (picture[..., 1] > 90) & (picture[..., 1] < 190)
        blue[:, :450] = blue[:, 1040:] = False  # the panels
        rows, columns = np.nonzero(blue)
        chosen = np.linspace(0, len(rows) - 1, min(12, len(rows))).astype(int)
        return [(float(columns[i]), float(rows[i])) for i in chosen]

    def images(self) -> list[str]:
        """Return the addresses of the panels' pictures; they change with their content."""
        return self.page.eval_on_selector_all("img", "images => images.map(i => i.src)")

    def set_number(self, label: str, value: int) -> None:
        """Type a value beside a slider."""
        below = f"xpath=//label[normalize-space(text())='{label}']/following::input[@type!='hidden'][1]"
        target = self.page.locator(below).first
        target.fill(str(value))
        target.press("Enter")

    def until(self, condition: Callable[[], bool], complaint: str) -> None:
        """Wait for a condition; keep a screenshot if it never comes."""
        left = SECONDS
        while not condition():
            if left <= 0:
                self.keep("failed")
                raise AssertionError(complaint)
            self.page.wait_for_timeout(250)
            left -= 0.25

    def keep(self, what: str) -> None:
        """Keep a screenshot."""
        SCREENSHOTS.mkdir(exist_ok=True)
        self.page.screenshot(path=SCREENSHOTS / f"{self.name}-{what}.png")

    def _note(self, request: Any) -> None:
        if not request.url.startswith(("http://localhost:", "data:", "blob:", "file:", "about:")):
            self.foreign.append(request.url)
