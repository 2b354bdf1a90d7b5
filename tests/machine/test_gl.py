"""Which OpenGL backend is chosen, on whichever machine: libraries, system and the user's own choice are forced."""

import pytest

from nerf_rl.machine import gl

EGL, OSMESA = "libEGL.so.1", "libOSMesa.so.8"


@pytest.mark.parametrize(
    ("system", "installed", "chosen_by_user", "backend"),
    [
        ("linux", {EGL, OSMESA}, None, "egl"),
        ("linux", {EGL}, None, "egl"),
        ("linux", {OSMESA}, None, "osmesa"),
        ("linux", set(), None, None),
        ("linux", {EGL, OSMESA}, "osmesa", "osmesa"),
        ("linux", {EGL}, "", ""),
        ("darwin", {EGL, OSMESA}, None, None),
        ("win32", {EGL, OSMESA}, None, None),
    ],
)
def test_the_backend_is_one_that_loads_unless_the_user_has_chosen(
    system: str,
    installed: set[str],
    chosen_by_user: str | None,
    backend: str | None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def load(library: str) -> None:
        if library not in installed:
            raise OSError(f"{library}: cannot open shared object file")

    environment = {} if chosen_by_user is None else {"MUJOCO_GL": chosen_by_user}
    monkeypatch.setattr(gl.sys, "platform", system)
    monkeypatch.setattr(gl.os, "environ", environment)
    monkeypatch.setattr(gl.ctypes, "CDLL", load)
    gl.set_default_backend()
    assert environment.get("MUJOCO_GL") == backend
