"""Network namespaces between which every packet is late: two machines far apart, on one.

Each namespace has a TUN device. A thread of the process that made them carries packets from one to
the other and holds each back for the delay. Linux and root; no kernel module but ``tun``.
"""

import ctypes
import fcntl
import os
import select
import struct
import subprocess
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

DEVICE = "tun0"  # in each namespace; what ranks give gloo as their interface
NET = "10.213.77"  # of the namespaces, which no other network sees
MTU = 65_000  # bytes; few packets, as the carrier is Python
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
CLONE_NEWNET = 0x40000000


def enter(namespace: str) -> None:
    """Moves the calling thread, and what it starts, into a namespace. Call it before threads are.

    Raises:
        OSError: if the system refuses.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    with open(f"/var/run/netns/{namespace}") as handle:
        if libc.setns(handle.fileno(), CLONE_NEWNET):
            raise OSError(ctypes.get_errno(), f"namespace {namespace} cannot be entered")


@contextmanager
def delayed_network(count: int, delay_ms: float) -> Iterator[list[str]]:
    """Makes namespaces that reach each other ``delay_ms`` later, and removes them at the end.

    Raises:
        SystemExit: with one line if the system refuses.
    """
    names = [f"zfall{os.getpid()}-{number}" for number in range(count)]
    with ExitStack() as undo:
        ends = []
        for number, name in enumerate(names):
            _ip("netns", "add", name)
            undo.callback(_ip, "netns", "del", name)
            ends.append(_end(name, f"zt{os.getpid()}{number}"[:15], f"{NET}.{number + 1}"))
            undo.callback(os.close, ends[-1])
        over = threading.Event()
        carrier = threading.Thread(target=_carry, args=(ends, delay_ms / 1000, over), daemon=True)
        carrier.start()
        undo.callback(carrier.join)
        undo.callback(over.set)
        yield names


def _end(namespace: str, device: str, address: str) -> int:
    """A file whose bytes are the packets of a new device in the namespace."""
    try:
        end = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        flags = struct.pack("16sH", device.encode(), IFF_TUN | IFF_NO_PI)
        fcntl.ioctl(end, TUNSETIFF, flags)
    except OSError as error:
        raise SystemExit(
            f"error: delay_ms must be 0 where /dev/net/tun does not work: {error}"
        ) from error
    _ip("link", "set", device, "netns", namespace, "name", DEVICE)
    inside = ("-n", namespace)
    _ip(*inside, "addr", "add", f"{address}/24", "dev", DEVICE)
    _ip(*inside, "link", "set", DEVICE, "mtu", str(MTU), "txqueuelen", "10000", "up")
    _ip(*inside, "link", "set", "lo", "up")
    return end


def _carry(ends: list[int], delay: float, over: threading.Event) -> None:
    """Hands each packet to the end that it is for, ``delay`` [s] after it came."""
    waiting: deque[tuple[float, int, bytes]] = deque()  # in the order they came: one delay for all
    while not over.is_set():
        now = time.monotonic()
        while waiting and waiting[0][0] <= now:
            _, to, packet = waiting.popleft()
            os.write(to, packet)
        left = waiting[0][0] - now if waiting else 0.1
        for end in select.select(ends, [], [], left)[0]:
            packet = os.read(end, MTU + 100)
            last = packet[19] - 1  # of the IPv4 address it is for
            if packet[0] >> 4 == 4 and 0 <= last < len(ends):
                waiting.append((time.monotonic() + delay, ends[last], packet))


def _ip(*words: str) -> None:
    done = subprocess.run(["ip", *words], capture_output=True, text=True)
    if done.returncode:
        said = " ".join((done.stderr or done.stdout).split())
        raise SystemExit(f"error: delay_ms must be 0 where network namespaces do not work: {said}")
