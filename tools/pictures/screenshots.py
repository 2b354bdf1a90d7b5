"""Take the README's pictures of the viewer from the demo's data, in the system's Chromium.

python -m tools.pictures.screenshots        # after make demo and make test-browser
"""

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from playwright.sync_api import Page, sync_playwright

SHOTS = {
    "datasets/results/viewer.png": (["data/demo"], 2200, "Cameras"),
    "pretrain/results/viewer.png": (["runs/demo/encoder", "--data", "data/demo"], 1500, "From z"),
    "rl/results/viewer.png": (["runs/demo/agent"], 0, "Episode"),
}
"""Picture: arguments of nerf-rl view, the frame to jump to (0: the first), and the tab to show."""
FLAGS = "--no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --disable-quic --no-first-run"
SETTLING = 15_000  # [ms]; software rendering is slow
MOST_BYTES = 300_000


def main() -> None:
    """Take all pictures."""
    executable = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as profile:
        browser = playwright.chromium.launch_persistent_context(
            profile, executable_path=executable, viewport={"width": 1400, "height": 860}, args=FLAGS.split()
        )
        for path, (arguments, episode, tab) in SHOTS.items():
            viewer = subprocess.Popen(
                [sys.executable, "-m", "nerf_rl.cli", "view", *arguments], stdout=subprocess.PIPE, text=True
            )
            assert viewer.stdout is not None
            url = re.search(r"http://localhost:\d+", viewer.stdout.readline())
            assert url is not None
            page = browser.new_page()
            page.goto(url.group())
            page.wait_for_selector("canvas")
            shoot(page, Path(path), episode, tab)
            page.close()
            viewer.terminate()
            viewer.wait()
        browser.close()


def shoot(page: Page, path: Path, episode: int, tab: str) -> None:
    """Arrange a page and take its picture."""
    page.wait_for_timeout(SETTLING)
    notices = page.locator(".mantine-Notification-closeButton")
    for _ in range(notices.count()):
        notices.first.click()
    if episode:
        below = "xpath=//label[normalize-space(text())='Episode']/following::input[@type!='hidden'][1]"
        box = page.locator(below).first
        box.fill(str(episode))
        box.press("Enter")
    page.get_by_text(tab, exact=True).first.click()
    page.wait_for_timeout(SETTLING)
    write_small(path, page.screenshot())


def write_small(path: Path, png: bytes) -> None:
    """Write a picture with as few colours as keep it small."""
    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    for bits in range(0, 5):
        step = 1 << bits
        coarse = np.clip((picture.astype(int) + step // 2) // step * step, 0, 255).astype(np.uint8)
        content = cv2.imencode(".png", coarse, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1].tobytes()
        if len(content) <= MOST_BYTES:
            break
        picture = cv2.resize(picture, None, fx=0.9, fy=0.9, interpolation=cv2.INTER_AREA) if bits > 1 else picture
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(content)
    print(f"{path}: {len(content) // 1000} kB")


if __name__ == "__main__":
    main()
