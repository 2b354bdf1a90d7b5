"""The timeline in the browser: episode and frame sliders, play, step and jump."""

import threading
from collections.abc import Callable

import viser

from nerf_rl.viewer.playback import Playback
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
        self._timeline, self._order = timeline, order
        self._lock = threading.RLock()
        self._frames = timeline.frames(timeline.first)
        last = max(timeline.last, timeline.first + 1)
        self.episode = gui.add_slider("Episode", timeline.first, last, 1, timeline.first)
        self.frame = gui.add_slider("Frame", 0, max(1, len(self._frames) - 1), 1, 0)
        self._playback = Playback(gui, lambda: self.go(self._other(self.index, 1)), settle)
        step = gui.add_button_group("Step", ("|<", "<", ">", ">|"))
        self.episode.on_update(lambda _: self._choose_episode())
        self.frame.on_update(lambda _: self._choose_frame())
        step.on_click(lambda event: self._step(event.target.value))

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
        self._playback.close()

    def _choose_episode(self) -> None:
        with self._lock:
            wanted = min(int(self.episode.value), self._timeline.last)
            frames = self._timeline.frames(wanted)
            if frames == self._frames:
                return
        self.go(frames.start)

    def _choose_frame(self) -> None:
        self._order(self.index)

    def _step(self, what: str) -> None:
        with self._lock:
            here, frames = self.index, self._frames
        self.go(self._other(here, {"|<": frames.start - here, "<": -1, ">": 1, ">|": frames.stop - 1 - here}[what]))

    def _other(self, index: int, by: int) -> int:
        """Return another frame, around the ends of the dataset."""
        return (index + by) % self._timeline.frame_count
