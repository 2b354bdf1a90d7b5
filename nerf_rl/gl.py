"""Choice of MuJoCo's off-screen OpenGL backend.

MuJoCo reads ``MUJOCO_GL`` once, when it is first imported, and falls back to a windowed backend that fails on a
machine without a display. Importing :mod:`nerf_rl` therefore fills the variable in, unless the user has set it.
"""

import ctypes
import os
import sys


def set_default_backend() -> None:
    """Set ``MUJOCO_GL`` to ``egl`` or ``osmesa``, whichever library loads; a value set by the user is kept."""
    if "MUJOCO_GL" in os.environ or not sys.platform.startswith("linux"):
        return
    for backend, library in (("egl", "libEGL.so.1"), ("osmesa", "libOSMesa.so.8")):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue
        os.environ["MUJOCO_GL"] = backend
        return


def use_one_software_thread() -> None:
    """Let software OpenGL (llvmpipe) draw in the calling thread: a process per core renders more than threads do."""
    os.environ.setdefault("LP_NUM_THREADS", "0")
