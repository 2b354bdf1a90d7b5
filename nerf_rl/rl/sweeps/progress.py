"""How far a sweep is: the environment steps of all its seeds together."""

import threading
from collections.abc import Iterable
from pathlib import Path

from nerf_rl.progress import Progress
from nerf_rl.rl.config import TrainRLConfig
from nerf_rl.rl.sweeps.runs import run_folder, steps_so_far

_PAUSE = 2.0  # [s] between two looks at what the seeds have written
_SECONDS_BETWEEN_LINES = 30.0


class SweepProgress:
    """Shows the steps of all seeds, which their processes write to files; use as a context manager.

    Args:
        config: of the sweep.
        seeds: all of them.
        finished: those that were finished before.
    """

    def __init__(self, config: TrainRLConfig, seeds: Iterable[int], finished: Iterable[int]):
        self._config = config
        self._steps = dict.fromkeys(seeds, 0)
        self._ended = 0
        self._lock, self._stop = threading.Lock(), threading.Event()
        for seed in finished:
            self._steps[seed] = config.env_steps
            self._ended += 1
        self._look()
        total = config.env_steps * len(self._steps)
        self._shown = sum(self._steps.values())
        self._progress = Progress(total, "env steps", self._shown, _SECONDS_BETWEEN_LINES)
        self._thread = threading.Thread(target=self._go_on, daemon=True)

    def end(self, seed: int, finished: bool) -> None:
        """Count a seed whose process has ended; one that failed keeps the steps that it has."""
        with self._lock:
            self._ended += finished
            self._steps[seed] = self._config.env_steps if finished else self._steps[seed]

    def say(self, line: str) -> None:
        """Print a line."""
        with self._lock:
            self._progress.say(line)

    def _go_on(self) -> None:
        while not self._stop.wait(_PAUSE):
            self._show()

    def _show(self) -> None:
        with self._lock:
            self._look()
            steps = sum(self._steps.values())
            if steps > self._shown:
                self._progress.advance(steps - self._shown, self._note)
                self._shown = steps

    def _look(self) -> None:
        """Read how far the seeds are; one that goes on from a checkpoint before its last line is not counted back."""
        most = self._config.env_steps
        for seed, steps in self._steps.items():
            if steps < most:
                self._steps[seed] = max(steps, min(most, steps_so_far(run_folder(Path(self._config.out), seed))))

    def _note(self) -> str:
        return f"{self._ended} of {len(self._steps)} seeds finished"

    def __enter__(self) -> "SweepProgress":
        self._progress.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *exception: object) -> None:
        self._stop.set()
        self._thread.join()
        if exception[0] is None:
            self._show()
        self._progress.__exit__(*exception)
