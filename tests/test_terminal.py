"""What a terminal shows: tables in its width, progress with the time left."""

import io
import re

import pandas as pd
import pytest
from rich.console import Console
from rich.progress import TextColumn

from zfall.terminal import Sheet, Shortened, print_sheet, progress_bar

ROWS = pd.DataFrame(
    {
        "run": ["runs/quickstart/2026-01-01_12-00-00-123456", "pose_hold"],
        "success": [0.87654, 0.5],
        **{f"figure number {k}": [k / 7, float("nan")] for k in range(12)},
    }
)


def printed(sheet: Sheet, width: int, *, terminal: bool) -> list[str]:
    out = io.StringIO()
    print_sheet(sheet, Console(file=out, width=width, force_terminal=terminal, color_system=None))
    return out.getvalue().rstrip("\n").split("\n")


@pytest.mark.parametrize("width", [40, 80, 120])
def test_a_table_is_no_wider_than_the_terminal_and_names_what_is_left_out(width):
    """The columns that are there and those that are named are all of them, in their order."""
    lines = printed(Sheet(ROWS, file="comparison.csv"), width, terminal=True)
    assert max(map(len, lines)) <= width
    text = " ".join(" ".join(lines).split())
    _, _, gone = text.partition("left out, as this terminal is narrow: ")
    assert gone.endswith("all are in comparison.csv")
    left_out = gone.removesuffix("; all are in comparison.csv").split(", ")
    assert left_out == [f"figure number {k}" for k in range(12 - len(left_out), 12)]
    assert "0.877" in text
    assert all(value in text for value in ("pose_hold", "success", "123456"))


def test_a_wider_terminal_shows_more_columns():
    shown = {width: " ".join(printed(Sheet(ROWS), width, terminal=True)).count("0.") for width in (80, 120)}  # fmt: skip
    assert shown[120] > shown[80]


def test_a_pipe_gets_all_of_a_table_one_row_a_line():
    lines = printed(Sheet(ROWS, title="two runs"), 80, terminal=False)
    assert lines[0] == "two runs"
    assert set(lines[2].strip()) <= {"─", " "}
    assert len(lines) == 5
    assert all(str(name) in lines[1] for name in ROWS.columns)
    assert lines[3].startswith("runs/quickstart/2026-01-01_12-00-00-123456")
    assert lines[4].split() == ["pose_hold", "0.5", *["-"] * 12]


def test_what_looks_like_markup_is_printed_as_it_stands():
    rows = pd.DataFrame({"row": ["[bold]a", "b"], "mean": ["0.1\n[0.0, 0.2]", "-"]})
    for terminal in (True, False):
        text = "\n".join(printed(Sheet(rows), 80, terminal=terminal))
        assert "[bold]a" in text
        assert "[0.0, 0.2]" in text


def test_progress_keeps_the_time_left_in_80_columns():
    """Whatever stands before and after it; in one line."""
    out = io.StringIO()
    console = Console(file=out, width=80, force_terminal=True, color_system=None)
    counted = TextColumn("{task.completed}/{task.total}")
    bar = progress_bar(console, counted, Shortened("{task.fields[note]}"))
    clock = iter(range(1000))
    bar.get_time = lambda: float(next(clock))
    task = bar.add_task("envelope of runs/quickstart/2026-01-01_12-00-00-123456, round 3", total=100,
                        note="return 12.3, episode 9.5 s, 12345/s, 12.34 M frames")  # fmt: skip
    for done in (10, 20, 30):
        bar.update(task, completed=done)
    console.print(bar.get_renderable())
    lines = out.getvalue().rstrip("\n").split("\n")
    assert len(lines) == 1
    assert len(lines[0]) <= 80
    assert "envelope" in lines[0]
    assert re.search(r"0:00:\d\d left 0:00:\d\d 30/100", lines[0])
    assert "return" in lines[0]
