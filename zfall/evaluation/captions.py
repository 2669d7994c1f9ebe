"""Text on the pictures of a film, and how a push is called there."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

MARKED = 1.0  # so long a push is marked, from its begin [s]
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
class Mark:
    """A push on its picture.

    Attributes:
        force: at its peak [N; world].
        label: its size, length and side.
        age: time since it began [s].
    """

    force: NDArray[np.floating]
    label: str
    age: float


def push_marks(
    forces: NDArray[np.floating], headings: NDArray[np.floating], dt: float
) -> list[Mark | None]:
    """What marks the pushes of one world in each frame.

    Args:
        forces: mean over the time of each frame ``(T, 3)`` [N; world].
        headings: where the robot faces ``(T,)`` [rad].
        dt: between two frames [s].
    """
    marks: list[Mark | None] = [None] * len(forces)
    acts = np.linalg.norm(forces, axis=1) > 0.1
    for begin in np.flatnonzero(acts & ~np.concatenate([[False], acts[:-1]])):
        rest = np.flatnonzero(~acts[begin:])
        end = begin + (rest[0] if len(rest) else len(forces) - begin)
        sizes = np.linalg.norm(forces[begin:end], axis=1)
        peak = forces[begin + int(sizes.argmax())]
        length = float(sizes.sum() / sizes.max()) * dt
        toward = math.atan2(peak[1], peak[0]) - headings[begin]
        side = _SIDES[round(toward / (math.pi / 4)) % 8]
        label = f"{sizes.max():.0f} N for {length:.2g} s {side}"
        last = max(end, begin + math.ceil(MARKED / dt))
        for t in range(begin, min(last, len(forces))):
            marks[t] = Mark(peak, label, (t - begin) * dt)
    return marks


def write_on(
    picture: NDArray[np.uint8],
    *,
    title: str,
    clock: str = "",
    push: str = "",
    outcome: tuple[str, bool] | None = None,
) -> NDArray[np.uint8]:
    """A picture with its title, the time, what pushes and what came of it.

    Args:
        picture: ``(height, width, 3)``.
        title: at the upper left; a second line is smaller.
        clock: at the upper right.
        push: in a box below.
        outcome: at the lower left; and whether it is good.
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
        _box(draw, (width / 2, height - 1.1 * size), text, GOOD if good else FALL, size, width)
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


def outcome_at(outcomes: Sequence[tuple[float, str, bool]], time: float) -> tuple[str, bool] | None:
    """The last of ``(time [s], words, whether it is good)`` that has come by a time."""
    come = [(words, good) for begin, words, good in outcomes if begin <= time + 1e-6]
    return come[-1] if come else None
