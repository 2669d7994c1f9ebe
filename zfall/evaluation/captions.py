"""Text on the pictures of a film, and how a push is called there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from tensordict import TensorDictBase

MARKED = 1.0  # so long a push is marked, from its begin [s]
OPEN = 0.5  # so long nobody says that all is well [s]
FALL, GOOD, DARK = (213, 94, 0), (0, 128, 92), (40, 46, 54)  # colours of Okabe and Ito, and ink
_SIDES = (
    "from behind",
    "from behind right",
    "from the right",
    "from the front right",
    "from the front",
    "from the front left",
    "from the left",
    "from behind left",
)


@dataclass(frozen=True)
class Pushed:
    """What pushes W worlds, over T times.

    Attributes:
        force: mean over each time ``(T, W, 3)`` [N; world].
        peak: the planned force of the push that acts, at its peak ``(T, W)`` [N]; 0 without one.
        impulse: of that push from its begin to its end ``(T, W)`` [N s].
        size: the same, dimensionless ``(T, W)``.
    """

    force: NDArray[np.float32]
    peak: NDArray[np.float32]
    impulse: NDArray[np.float32]
    size: NDArray[np.float32]

    def of(self, worlds: Sequence[int]) -> "Pushed":
        """That of some of the worlds."""
        index = list(worlds)
        planned = (each[:, index] for each in (self.peak, self.impulse, self.size))
        return Pushed(self.force[:, index], *planned)


class PushLog:
    """Writes down what pushes the first worlds, step by step.

    Args:
        worlds: how many.
    """

    def __init__(self, worlds: int):
        self.worlds = worlds
        self._steps: list[list[NDArray[np.float32]]] = []

    def add(self, td: TensorDictBase) -> None:
        """Takes in what followed a control step; an env without pushes has none."""
        row = [np.zeros((self.worlds, size), np.float32) for size in (3, 1, 1, 1)]
        if ("push", "force") in td.keys(True):
            names = ("force", "peak_force", "impulse", "size")
            row = [td["push", name][: self.worlds].numpy().copy() for name in names]
        self._steps.append(row)

    def frames(self, ends: Sequence[int]) -> Pushed:
        """The pushes by frame: means of the force, and the largest push of each frame.

        Args:
            ends: number of steps after which each of T frames ends.
        """
        begins = [0, *ends[:-1]]
        force, *planned = (
            [np.stack(steps[begin:end]) for begin, end in zip(begins, ends, strict=True)]
            for steps in zip(*self._steps, strict=True)
        )
        largest = (np.stack([each.max(0)[:, 0] for each in frames]) for frames in planned)
        return Pushed(np.stack([each.mean(0) for each in force]), *largest)


@dataclass(frozen=True)
class Mark:
    """A push on its picture.

    Attributes:
        force: along it, of its peak [N; world].
        label: its size, length and side.
        age: time since it began [s].
    """

    force: NDArray[np.floating]
    label: str
    age: float


def push_marks(
    pushed: Pushed, world: int, headings: NDArray[np.floating], dt: float
) -> list[Mark | None]:
    """What marks the pushes of one world in each frame.

    Its label names the push as it was planned, whatever part of it fell into a frame.

    Args:
        pushed: by frame.
        world: which.
        headings: where the robot faces ``(T,)`` [rad].
        dt: between two frames [s].
    """
    forces = pushed.force[:, world]
    marks: list[Mark | None] = [None] * len(forces)
    acts = pushed.peak[:, world] > 0.1
    for begin in np.flatnonzero(acts & ~np.concatenate([[False], acts[:-1]])):
        rest = np.flatnonzero(~acts[begin:])
        end = begin + (rest[0] if len(rest) else len(forces) - begin)
        most = begin + int(pushed.size[begin:end, world].argmax())
        largest = begin + int(np.linalg.norm(forces[begin:end], axis=1).argmax())
        peak, impulse = (float(each[most, world]) for each in (pushed.peak, pushed.impulse))
        way = forces[largest] / max(1e-6, float(np.linalg.norm(forces[largest])))
        toward = math.atan2(way[1], way[0]) - headings[begin]
        side = _SIDES[round(toward / (math.pi / 4)) % 8]
        size = f"I = {pushed.size[most, world]:.2f}"
        label = f"{size}: {peak:.{0 if peak >= 9.5 else 1}f} N for {impulse / peak:.2g} s {side}"
        last = max(end, begin + math.ceil(MARKED / dt))
        for t in range(begin, min(last, len(forces))):
            marks[t] = Mark(peak * way, label, (t - begin) * dt)
    return marks


def write_on(
    picture: NDArray[np.uint8],
    *,
    title: str,
    clock: str = "",
    push: str = "",
    outcome: tuple[str, bool | None] | None = None,
) -> NDArray[np.uint8]:
    """A picture with its title, the time, what pushes and what came of it.

    Args:
        picture: ``(height, width, 3)``.
        title: at the upper left; a second line is smaller.
        clock: at the upper right.
        push: in a box below.
        outcome: below, and whether it is good; ``None``: neither, as a decision.
    """
    image = Image.fromarray(picture)
    draw, (width, height) = ImageDraw.Draw(image), image.size
    size = max(9, height // 22)
    gap = size // 2
    first, _, second = title.partition("\n")
    draw.text((gap, gap), first, DARK, _font(size, bold=True))
    draw.text((gap, gap + 1.3 * size), second, DARK, _font(round(0.8 * size)))
    draw.text((width - gap, gap), clock, DARK, _font(size), anchor="ra")
    if push:
        _box(draw, (width / 2, height - 2.6 * size), push, FALL, size, width)
    if outcome:
        text, good = outcome
        color = DARK if good is None else GOOD if good else FALL
        _box(draw, (width / 2, height - 1.1 * size), text, color, size, width)
    return np.asarray(image)


def write_push(picture: NDArray[np.uint8], push: str) -> NDArray[np.uint8]:
    """A picture of several robots with what pushes all of them, where ``write_on`` has it."""
    image = Image.fromarray(picture)
    draw, (width, height) = ImageDraw.Draw(image), image.size
    size = max(9, height // 22)
    _box(draw, (width / 2, height - 2.6 * size), push, FALL, size, width)
    return np.asarray(image)


def _box(
    draw: ImageDraw.ImageDraw,
    middle: tuple[float, float],
    text: str,
    color: tuple[int, int, int],
    size: int,
    width: int,
) -> None:
    """White text in a box, as small as it must be to fit."""
    font = _font(size, bold=True)
    while size > 7 and font.getlength(text) > width - 1.5 * size:
        size -= 1
        font = _font(size, bold=True)
    half = font.getlength(text) / 2 + size / 2, 0.68 * size
    (x, y), corner = middle, size // 3
    draw.rounded_rectangle((x - half[0], y - half[1], x + half[0], y + half[1]), corner, color)
    draw.text(middle, text, (255, 255, 255), font, anchor="mm")


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    weight = "bold" if bold else "normal"
    found = font_manager.findfont(font_manager.FontProperties(family="DejaVu Sans", weight=weight))
    return ImageFont.truetype(found, size)


def outcome_at(
    outcomes: Sequence[tuple[float, str, bool | None]],
    time: float,
    mark: Mark | None = None,
    begins: Sequence[float] = (),
) -> tuple[str, bool | None] | None:
    """The last of ``(time [s], words, whether it is good)`` that has come by a time.

    ``{when}`` in its words becomes the time since the last push before it began, see ``when``. None
    that is good in the first half second of a push, which is not over then.

    Args:
        outcomes: of a world, in the order of their times.
        time: of the picture [s].
        mark: of the push that is marked on it, if one is.
        begins: when pushes begin [s].
    """
    come = [each for each in outcomes if each[0] <= time + 1e-6]
    if not come:
        return None
    moment, words, good = come[-1]
    if good and mark is not None and mark.age < OPEN:
        return None
    return words.format(when=when(moment, begins)), good


def when(moment: float, begins: Sequence[float]) -> str:
    """A moment in words, from the begin of the last push before it; without one from the start."""
    before = [begin for begin in begins if begin <= moment + 1e-6]
    if not before:
        return f"after {moment:.1f} s"
    since = moment - before[-1]
    return f"{since:.{1 if since >= 0.095 else 2}f} s after the push"
