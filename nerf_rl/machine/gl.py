"""Choice of MuJoCo's off-screen OpenGL backend.

MuJoCo reads ``MUJOCO_GL`` once, when it is first imported, and falls back to a windowed backend that fails on a
machine without a display. Importing :mod:`nerf_rl` therefore fills the variable in, unless the user has set it.
"""

import ctypes
import os
import sys
from pathlib import Path

_SOFTWARE_RENDERERS = ("llvmpipe", "softpipe", "swrast", "software")
_HARDWARE_DRIVERS = {"nvidia", "amdgpu"}


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


def renderer_name() -> str:
    """Return the name that the implementation behind the current OpenGL context has for itself.

    By the functions themselves: the whole of ``OpenGL.GL`` would take each process a twentieth of a second to import.
    """
    from OpenGL.raw.GL.VERSION.GL_1_0 import GL_RENDERER, glGetString  # after mujoco, which tells it the backend

    return ctypes.string_at(glGetString(GL_RENDERER)).decode()


def largest_image() -> tuple[int, int]:
    """Return height and width of the largest off-screen image that the current OpenGL context can draw to [pixels]."""
    from OpenGL.raw.GL.VERSION.GL_1_0 import GL_MAX_VIEWPORT_DIMS, glGetIntegerv
    from OpenGL.raw.GL.VERSION.GL_3_0 import GL_MAX_RENDERBUFFER_SIZE

    side, sides = ctypes.c_int(), (ctypes.c_int * 2)()
    glGetIntegerv(GL_MAX_RENDERBUFFER_SIZE, ctypes.byref(side))
    glGetIntegerv(GL_MAX_VIEWPORT_DIMS, sides)
    width, height = sides
    return min(side.value, height), min(side.value, width)


def is_software(renderer: str) -> bool:
    """Tell whether an OpenGL implementation, by its name for itself, renders on the processor."""
    return any(name in renderer.lower() for name in _SOFTWARE_RENDERERS)


def graphics_card() -> str | None:
    """Return the device file or driver of a graphics card that could render, or None."""
    devices = sorted(Path("/dev").glob("nvidia[0-9]*"))
    drivers = {path.resolve().name for path in Path("/sys/class/drm").glob("renderD*/device/driver")}
    cards = [str(device) for device in devices] + sorted(drivers & _HARDWARE_DRIVERS)
    return cards[0] if cards else None


def warn_of_software_rendering(renderer: str) -> None:
    """Print a warning if a graphics card is at hand and rendering does not use it."""
    card = graphics_card()
    if card is not None and is_software(renderer):
        print(
            f"warning: {renderer} renders on the processor although there is a graphics card ({card}); "
            "check that its OpenGL driver is installed and that MUJOCO_GL is egl",
            file=sys.stderr,
        )
