"""Measure the viewer in the system's Chromium on this machine: first picture, scrubbing, and the live field.

Run from a checkout's root after make test-browser, with nothing else running:

    .venv/bin/python -m tools.bench.view DATASET ENCODER [--json FILE]

The browser renders in software on the same cores as the viewer. It is running already when a measurement begins, as a
user's would be. The window is square where the field is drawn, so that its pictures are too.
"""

import argparse
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import Any

from playwright.sync_api import BrowserContext, Page, sync_playwright

from nerf_rl.files.json_files import write_json
from nerf_rl.files.versions import git_revision, package_versions

FLAGS = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run"
FLAGS += " --disable-background-networking --disable-component-update --disable-sync"
WINDOW = {"width": 1300, "height": 860}  # of which the panel on the left leaves a square
REPEATS = 3
COUNT_CHANGES = """() => {
    window.changes = new Map();
    const seen = new MutationObserver(found => {
        for (const {target} of found) window.changes.set(target, (window.changes.get(target) || 0) + 1);
    });
    seen.observe(document.body, {attributes: true, attributeFilter: ['src'], subtree: true});
}"""
MOST_CHANGES = "Math.max(0, ...window.changes.values())"  # of a single picture


def main() -> None:
    """Measure, print, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("encoder", type=Path)
    parser.add_argument("--json", type=Path, default=Path("datasets/results/view.json"))
    arguments = parser.parse_args()
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as profile:
        browser = playwright.chromium.launch_persistent_context(
            profile,
            executable_path=executable,
            viewport=WINDOW,
            args=FLAGS.split(),
        )
        browser.new_page().goto("about:blank")
        data = ["--data", str(arguments.dataset)]
        result = {
            "dataset": opening(browser, [str(arguments.dataset)]),
            "encoder": opening(browser, [str(arguments.encoder), *data]),
            "scrubbing": with_page(browser, [str(arguments.dataset)], scrub),
            "field_while_dragging": with_page(browser, [str(arguments.encoder), *data], drag),
        }
        browser.close()
    head = {
        "command": " ".join(["python -m tools.bench.view", *sys.argv[1:]]),
        "git_revision": git_revision(),
        "packages": package_versions(),
    }
    print(result)
    write_json(arguments.json, head | result)


def start(arguments: list[str]) -> tuple[subprocess.Popen[str], str]:
    """Start the viewer; return it and its address once it is told."""
    command = [str(Path(sys.executable).parent / "nerf-rl"), "view", *arguments]
    viewer = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert viewer.stdout is not None
    for line in viewer.stdout:
        if url := re.search(r"http://localhost:\d+", line):
            return viewer, url.group()
    raise RuntimeError(f"{command} ended without an address")


def opening(browser: BrowserContext, arguments: list[str]) -> dict[str, Any]:
    """Return the times from the command to the address and to the first picture on the page [s]."""
    addresses, pictures = [], []
    for _ in range(REPEATS):
        began = time.monotonic()
        viewer, url = start(arguments)
        addresses.append(time.monotonic() - began)
        page = browser.new_page()
        page.goto(url)
        page.wait_for_function("[...document.images].some(image => image.complete && image.naturalWidth > 1)")
        pictures.append(time.monotonic() - began)
        page.close()
        stop(viewer)
    return {
        "address_s": [round(seconds, 2) for seconds in addresses],
        "first_picture_s": [round(seconds, 2) for seconds in pictures],
        "first_picture_median_s": round(median(pictures), 2),
    }


def with_page(browser: BrowserContext, arguments: list[str], measure: Any) -> dict[str, Any]:
    """Open a page, let it settle, measure it."""
    viewer, url = start(arguments)
    page = browser.new_page()
    page.goto(url)
    page.wait_for_selector("canvas")
    page.wait_for_timeout(8000)
    try:
        return measure(page)
    finally:
        page.close()
        stop(viewer)


def scrub(page: Page) -> dict[str, Any]:
    """Play a dataset at the fastest rate; return how many frames a second reach the page."""
    page.evaluate(COUNT_CHANGES)
    label = "xpath=//label[normalize-space(text())='Frames per second']/following::input[@type!='hidden'][1]"
    page.locator(label).first.fill("30")
    page.locator(label).first.press("Enter")
    page.get_by_role("button", name="Play", exact=False).first.click()
    page.wait_for_timeout(1000)
    before, began = page.evaluate(MOST_CHANGES), time.monotonic()
    page.wait_for_timeout(8000)
    changes, seconds = page.evaluate(MOST_CHANGES) - before, time.monotonic() - began
    return {"frames_per_second": round(changes / seconds, 2)}


def drag(page: Page) -> dict[str, Any]:
    """Turn the camera by the mouse; return how long the field's pictures took [ms]."""
    taken: list[int] = []
    samples: list[int] = []
    began, last = time.monotonic(), ""
    box = page.locator("canvas[data-engine]").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 3, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for step in range(120):
        page.mouse.move(x + step, y - step / 2)
        page.wait_for_timeout(60)
        found = re.search(r"pixels, (\d+) samples a ray, in (\d+) ms", page.inner_text("body"))
        if found and found.group() != last:
            last = found.group()
            samples.append(int(found.group(1)))
            taken.append(int(found.group(2)))
    seconds = time.monotonic() - began
    page.mouse.up()
    return {
        "window": [round(box["width"]), round(box["height"])],
        "ms": taken,
        "samples_a_ray": samples,
        "median_ms": median(taken),
        "pictures_per_second_seen": round(len(taken) / seconds, 2),
    }


def stop(viewer: subprocess.Popen[str]) -> None:
    """End a viewer as Ctrl-C does."""
    viewer.send_signal(signal.SIGINT)
    viewer.wait()


if __name__ == "__main__":
    main()
