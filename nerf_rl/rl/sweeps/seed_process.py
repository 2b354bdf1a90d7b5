"""The process that trains one seed of a sweep: ``python -m nerf_rl.rl.sweeps.seed_process``, then train-rl's arguments.

It has a folder and a log of its own, and whatever becomes of it concerns no other seed. It ends when its standard input
does, which the process that started it holds open and never writes to.
"""

import os
import signal
import sys
import threading

from nerf_rl.errors import FailureError, UserError


def main() -> int:
    """Train; return what ``nerf-rl train-rl`` exits with."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the sweep's to handle
    threading.Thread(target=_end_with_input, daemon=True).start()
    from nerf_rl.arguments.parsing import parse_config
    from nerf_rl.rl.config import TrainRLConfig
    from nerf_rl.rl.train import train_rl

    try:
        train_rl(parse_config(TrainRLConfig, "nerf-rl train-rl", "", sys.argv[1:]))
    except (UserError, FailureError) as error:
        print(f"nerf-rl train-rl: {error}", file=sys.stderr)
        return 2 if isinstance(error, UserError) else 1
    return 0


def _end_with_input() -> None:
    os.read(0, 1)
    os._exit(1)


if __name__ == "__main__":
    sys.exit(main())
