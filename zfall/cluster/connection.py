"""A Ray cluster: one that runs already, or one on this machine for as long as it is needed."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from zfall.cores import usable_cores
from zfall.errors import in_one_line

LOCAL, AUTO = "local", "auto"
STORE = 2**28  # bytes of a cluster of our own for what is sent: configs, and files of runs

# What a gRPC server understands: the beginning of HTTP/2, and an empty frame of settings.
_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(3) + b"\x04" + bytes(5)
_SETTINGS = 4  # kind of the frame with which it answers


def ray_of(key: str) -> Any:
    """The package ray, quiet.

    Args:
        key: that needs it, for the error.

    Raises:
        ValueError: if it is not installed.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    os.environ.setdefault("RAY_worker_niceness", "0")  # as nice as we are; else by 15 more
    try:
        import ray
    except ImportError as error:
        raise ValueError(
            f"{key} must have Ray, which is not installed ({in_one_line(error)}): "
            "pip install 'zfall[ray]'."
        ) from error
    return ray


@contextmanager
def connected(address: str | None, key: str = "hydra.launcher.address") -> Iterator[Any]:
    """Connects to a cluster, or starts one on this machine that ends with the block.

    A process that is connected already stays so.

    Args:
        address: ``HOST:PORT`` of its head; ``auto``: the one of this machine; ``None``: starts one
            with the cores that this process may use.
        key: of the config, for errors.

    Yields:
        The package ray.

    Raises:
        ValueError: if Ray is not installed, or there is no cluster.
    """
    ray = ray_of(key)
    if ray.is_initialized():
        yield ray
        return
    own = address is None
    if address is not None and address != AUTO:
        check_answers(address, key)
    given: dict[str, Any] = {"address": LOCAL if own else address}
    if own:
        given |= {"num_cpus": usable_cores(), "object_store_memory": STORE}
        given |= {"include_dashboard": False}
    try:
        # Its own words about what it starts and waits for would be many lines.
        ray.init(log_to_driver=False, logging_level="CRITICAL", **given)
    except (Exception, SystemExit) as error:
        with suppress(Exception):
            ray.shutdown()
        what = "start on this machine" if own else f"be a running Ray cluster, got {address}"
        reason = "no answer" if isinstance(error, SystemExit) else in_one_line(error)
        raise ValueError(f"{key} must {what}: {reason}") from None
    try:
        yield ray
    finally:
        ray.shutdown()


def check_answers(address: str, key: str, seconds: float = 5.0) -> None:
    """Refuses an address at which nothing like the head of a cluster listens.

    Ray itself waits for two minutes, and ends the process.

    Args:
        address: ``HOST:PORT``.
        key: of the config, for the error.
        seconds: to wait for an answer.

    Raises:
        ValueError: naming the key and the reason.
    """
    rule = f"{key} must be HOST:PORT of a running Ray cluster's head, or {AUTO}, got {address}"
    repair = "ray start --head starts one, and says its address"
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise ValueError(f"{rule}; {repair}.")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=seconds) as connection:
            connection.sendall(_HELLO)
            answer = b""
            while len(answer) < 4 and (more := connection.recv(4 - len(answer))):
                answer += more
    except (OSError, OverflowError, UnicodeError) as error:
        raise ValueError(f"{rule}: {in_one_line(error)}; {repair}.") from None
    if len(answer) < 4 or answer[3] != _SETTINGS:
        raise ValueError(f"{rule}: something else answers there; {repair}.")
