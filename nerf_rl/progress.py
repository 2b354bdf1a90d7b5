"""Progress of long work: a bar on a terminal, plain lines otherwise."""

import math
import sys
import time
from collections.abc import Callable

from tqdm import tqdm


class Progress:
    """Counts units of work; use as a context manager.

    Args:
        total: units in all.
        unit: their name in the plural.
        done: units that were finished before this run.
        seconds_between_lines: pause between two plain lines when the output is no terminal [s].
    """

    def __init__(self, total: int, unit: str, done: int = 0, seconds_between_lines: float = 10.0):
        self._total, self._unit, self._done, self._initial = total, unit, done, done
        self._pause = seconds_between_lines
        self._start = self._last_line = time.monotonic()
        self._bar = (
            tqdm(total=total, initial=done, unit=f" {unit}", dynamic_ncols=True) if sys.stderr.isatty() else None
        )

    def advance(self, units: int = 1, note: Callable[[], str] = str, most_seconds: float = math.inf) -> None:
        """Count ``units`` more.

        Args:
            units: that are done.
            note: returns what stands beside them where they are shown, and is called only then: what it says may cost
                more to find out than a unit of work.
            most_seconds: after which the work ends, however many units are done then.
        """
        self._done += units
        if self._bar is not None:
            if self._bar.update(units):  # it was drawn, and will be again some tenths of a second later
                self._bar.set_postfix_str(note(), refresh=False)
            return
        now = time.monotonic()
        if now - self._last_line >= self._pause or self._done >= self._total:
            self._last_line = now
            rate = (self._done - self._initial) / max(now - self._start, 1e-9)
            left = max(self._total - self._done, 0)  # several environments at once may do a few steps more
            remaining = min(left / rate if rate > 0 else math.inf, most_seconds)
            line = f"{self._done}/{self._total} {self._unit}, {rate:.1f}/s, {remaining:.0f} s left"
            print(f"{line}  {note()}".rstrip(), flush=True)

    def say(self, line: str) -> None:
        """Print a line without breaking the bar."""
        if self._bar is not None:
            self._bar.write(line, file=sys.stdout)
        else:
            print(line, flush=True)

    def __enter__(self) -> "Progress":
        return self

    def __exit__(self, *exception: object) -> None:
        if self._bar is not None:
            self._bar.close()
