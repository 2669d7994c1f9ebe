"""Where the page is served."""

import logging
import socket
import threading
from contextlib import redirect_stdout
from io import StringIO

import viser

CLOSING = 2.0  # longest time that a closing server is waited for [s]
CHATTY = ("asyncio", "websockets")  # log each request, and tasks that a closed server leaves


class Page:
    """A server of viser that says nothing on the terminal.

    Args:
        host: address to listen at.
        port: of the page; 0 for a free one.

    Attributes:
        server: viser's.
        port: of the page.

    Raises:
        ValueError: if the port cannot be had.
    """

    def __init__(self, host: str, port: int):
        for name in CHATTY:
            logging.getLogger(name).setLevel(logging.CRITICAL)
        before = set(threading.enumerate())
        with redirect_stdout(StringIO()):  # it announces itself, verbose or not
            self.server = viser.ViserServer(host, free_port(host, port), verbose=False)
        self._threads = set(threading.enumerate()) - before
        self.port = self.server.get_port()

    def close(self) -> None:
        """Ends the page; then its port is free."""
        with redirect_stdout(StringIO()):
            self.server.stop()
            for thread in self._threads:
                thread.join(CLOSING)


def free_port(host: str, port: int) -> int:
    """The port, or a free one for 0.

    Raises:
        ValueError: if it cannot be had.
    """
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError as error:
            raise ValueError(
                f"port must be free at {host}, got {port} ({error.strerror}): port={port + 1}."
            ) from error
        return int(probe.getsockname()[1])
