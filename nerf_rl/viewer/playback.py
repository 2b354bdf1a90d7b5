"""The play button: advances at a steady pace, but no faster than pictures are shown."""

import threading
import time
from collections.abc import Callable

import viser


class Playback:
    """A button that plays and pauses, and a slider for the pace.

    Args:
        gui: where to put the controls.
        advance: goes on to the next frame; called in a thread of its own.
        settle: waits until it is shown, for so many seconds at most.
    """

    def __init__(self, gui: viser.GuiApi, advance: Callable[[], None], settle: Callable[[float], bool]):
        self._advance, self._settle = advance, settle
        self._playing = threading.Event()
        self._closed = False
        self.button = gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY)
        self.speed = gui.add_slider("Frames per second", 1, 30, 1, 10)
        self.button.on_click(lambda _: self._toggle())
        threading.Thread(target=self._run, daemon=True).start()

    def close(self) -> None:
        """Stop playing for good."""
        self._closed = True
        self._playing.set()

    def _toggle(self) -> None:
        playing = not self._playing.is_set()
        self.button.label = "Pause" if playing else "Play"
        self.button.icon = viser.Icon.PLAYER_PAUSE if playing else viser.Icon.PLAYER_PLAY
        (self._playing.set if playing else self._playing.clear)()

    def _run(self) -> None:
        while True:
            self._playing.wait()
            if self._closed:
                return
            start = time.monotonic()
            self._advance()
            self._settle(5.0)
            time.sleep(max(0.0, 1.0 / self.speed.value - (time.monotonic() - start)))
