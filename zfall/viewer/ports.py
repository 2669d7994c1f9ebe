"""Where the page is served."""

import socket


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
