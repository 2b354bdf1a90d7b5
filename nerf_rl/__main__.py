"""``python -m nerf_rl``, where the command ``nerf-rl`` is not on the path."""

import sys

from nerf_rl.cli import main

if __name__ == "__main__":
    sys.exit(main())
