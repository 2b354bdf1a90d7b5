"""The timeline in the browser: episode and frame sliders, play, step and jump."""

import threading
import time
from collections.abc import Callable

import viser

from nerf_rl.viewer.timeline import Timeline


class TimelinePanel:
    """Chooses the frame that is shown.

    Args:
        gui: where to put the controls.
        timeline: episodes and frames.
        order: asks for a frame to be shown, and returns at once.
        settle: waits until the last ordered frame is shown.
    """

    def __init__(
        self, gui: viser.GuiApi, timeline: Timeline, order: Callable[[int], None], settle: Callable[[float], bool]
    ):
        self._timeline, self._order, self._settle = timeline, order, settle
        self._lock = threading.RLock()
        self._frames = timeline.frames(timeline.first)
        self._playing = threading.Event()
        self._closed = False
        last = max(timeline.last, timeline.first + 1)
        self.episode = gui.add_slider("Episode", timeline.first, last, 1, timeline.first)
        self.frame = gui.add_slider("Frame", 0, max(1, len(self._frames) - 1), 1, 0)
        self.play = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        step = gui.add_button_group("Step", ("|<", "<", ">", ">|"))
        self.speed = gui.add_slider("Frames per second", 1, 30, 1, 10)
        self.episode.on_update(lambda _: self._choose_episode())
        self.frame.on_update(lambda _: self._choose_frame())
        self.play.on_click(lambda _: self._toggle())
        step.on_click(lambda event: self._step(event.target.value))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def index(self) -> int:
        """The chosen frame."""
        with self._lock:
            return self._frames[min(int(self.frame.value), len(self._frames) - 1)]

    def go(self, index: int) -> None:
        """Choose a frame of the dataset."""
        with self._lock:
            if index not in self._frames:
                self._frames = self._timeline.frames(self._timeline.episode(index))
                self.frame.max = max(1, len(self._frames) - 1)
                self.episode.value = self._timeline.episode(index)
            self.frame.value = index - self._frames.start
        self._order(index)

    def close(self) -> None:
        """Stop playing for good."""
        self._closed = True
        self._playing.set()

    def _choose_episode(self) -> None:
        with self._lock:
            wanted = min(int(self.episode.value), self._timeline.last)
            frames = self._timeline.frames(wanted)
            if frames == self._frames:
                return
        self.go(frames.start)

    def _choose_frame(self) -> None:
        self._order(self.index)

    def _toggle(self) -> None:
        playing = not self._playing.is_set()
        self.play.label = "Pause" if playing else "Play"
        self.play.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
        (self._playing.set if playing else self._playing.clear)()

    def _step(self, what: str) -> None:
        with self._lock:
            here, frames = self.index, self._frames
        self.go(self._other(here, {"|<": frames.start - here, "<": -1, ">": 1, ">|": frames.stop - 1 - here}[what]))

    def _other(self, index: int, by: int) -> int:
        """Return another frame, around the ends of the dataset."""
        return (index + by) % self._timeline.frame_count

    def _run(self) -> None:
        while not self._closed:
            self._playing.wait()
            if self._closed:
                return
            start = time.monotonic()
            self.go(self._other(self.index, 1))
            self._settle(5.0)
            time.sleep(max(0.0, 1.0 / self.speed.value - (time.monotonic() - start)))
