"""The server behind the page: where it listens, what it prints, how it ends."""

import contextlib
import getpass
import io
import os
import socket
import time
from collections.abc import Iterator

import viser

from nerf_rl.errors import UserError


@contextlib.contextmanager
def serve(host: str, port: int, title: str) -> Iterator[viser.ViserServer]:
    """Give a server and stop it at the end.

    Args:
        host: address to listen on.
        port: to listen on; 0 takes a free one.
        title: of the panel.

    Raises:
        UserError: the address cannot be listened on.
    """
    with contextlib.redirect_stdout(io.StringIO()):  # its own banner; where_to_look says more in fewer lines
        server = viser.ViserServer(host, free_port(host, port), verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    server.gui.set_panel_label(title)
    server.scene.set_up_direction("+z")
    # a shadow would be worth little here, and costs much in browsers without a GPU
    server.scene.configure_default_lights(cast_shadow=False)
    try:
        yield server
    finally:
        with contextlib.redirect_stdout(io.StringIO()):
            server.stop()


def free_port(host: str, port: int) -> int:
    """Return the port, or a free one for 0.

    Raises:
        UserError: it is taken, or the address is none of this machine's.
    """
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            reason = error.strerror or error
            raise UserError(f"cannot serve on {host}:{port} ({reason}); --port 0 takes a free port") from error
        return int(probe.getsockname()[1])


def where_to_look(host: str, port: int) -> str:
    """Return what to open in a browser, also from another machine."""
    local = host in ("127.0.0.1", "localhost", "::1")
    name = "localhost" if local or host in ("", "0.0.0.0", "::") else host  # on one address alone, localhost is deaf
    lines = [f"open http://{f'[{name}]' if ':' in name else name}:{port}"]
    if local:
        if "SSH_CONNECTION" in os.environ:
            there = f"{getpass.getuser()}@{socket.gethostname()}"
            lines.append(f"from your own machine, forward it first: ssh -L {port}:localhost:{port} {there}")
    else:
        lines.append(f"serving on {host or 'every address'}: whoever reaches this machine can look at it")
    lines.append("Ctrl-C ends it")
    return "\n".join(lines)


def wait_for_interrupt() -> None:
    """Serve until Ctrl-C or a termination signal; closing the page in the browser does not end it."""
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            time.sleep(3600.0)
