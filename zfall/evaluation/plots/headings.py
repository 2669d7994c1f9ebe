"""Lines of text over a figure."""

import textwrap

from matplotlib.figure import Figure

CHARACTERS = 15.0  # of the smaller lines in an inch


def draw_heading(figure: Figure, title: str) -> None:
    """Writes a title over a figure, large, and what follows its first line smaller.

    Lines that are too long for the figure are broken.

    Args:
        figure: with a constrained layout, which makes room.
        title: as ``zfall.evaluation.headings.heading`` gives it, or plain.
    """
    first, _, rest = title.partition("\n")
    width = figure.get_figwidth()
    broken = textwrap.wrap(rest, round(CHARACTERS * width), break_on_hyphens=False)
    big = textwrap.wrap(first, round(11.0 * width), break_on_hyphens=False) or [""]
    room = figure.suptitle("\n".join([*big, *broken]), fontsize=11, color="none")
    height = 11 * 1.25 / 72 / figure.get_figheight()  # of a line
    for number, text in enumerate([*big, *broken]):
        size = 11 if number < len(big) else 9
        top = room.get_position()[1] - number * height
        figure.text(0.5, top, text, ha="center", va="top", fontsize=size)
