"""Ctrl-c: the first ends a training where it can go on, the second at once."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event
from types import FrameType


class Stopped(Exception):
    """Ctrl-c ended a training early; it can go on from its folder."""


@contextmanager
def first_ctrl_c() -> Iterator[Event]:
    """Set by the first ctrl-c, which lets the update end, to be resumed exactly; not the second."""
    pressed = Event()

    def press(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.signal(number, previous)

    previous = signal.signal(signal.SIGINT, press)
    try:
        yield pressed
    finally:
        signal.signal(signal.SIGINT, previous)
