"""What of another kind than the config takes is refused in one line, by every recipe."""

import pytest

from tests.shell import run
from zfall.errors import in_one_line

BEST, POSE = "run=best", "run=pose_hold"


@pytest.mark.parametrize(
    ("recipe", "given", "message"),
    [
        ("falling.falls", [POSE, "impulses=0.8"], "impulses must be a list, [0.8], got 0.8."),
        ("falling.falls", [POSE, "times=0.08"], "times must be a list, [0.08], or null, got 0.08."),
        ("falling.falls", [POSE, "seed=x"], "seed must be a whole number, got x."),
        ("falling.falls", [POSE, "change=x"], "change must be a list, [x], got x."),
        (
            "falling.catches",
            ["falls=README.md"],
            "falls must be a file that recipes.falling.falls wrote, README.md",
        ),
        ("falling.catches", ["falls=README.md", "speeds=2"], "speeds must be a list, [2], got 2."),
        ("falling.catches", ["falls=README.md", "rounds=0"], "rounds must be at least 1, got 0."),
        (
            "falling.catches",
            ["falls=README.md", "spread=x"],
            "spread must be a number, got x.",
        ),
        (
            "falling.switch",
            ["recover=best", "kneel=script", "change=3"],
            "change must be a list, [3]",
        ),
        (
            "falling.switch",
            ["recover=best", "kneel=script", "checkpoint=3"],
            "checkpoint must be text, got 3.",
        ),
        ("play", [BEST, "video=3"], "video must be true or false, got 3."),
        ("play", [BEST, "seed=-1"], "seed must be at least 0 and below 2^63, got -1."),
        ("export", [BEST, "change=3"], "change must be a list, [3], got 3."),
        ("bench", ["seconds=x"], "seconds must be a number, got x."),
        ("ablate", ["study=control", "results=3"], "results must be text, got 3."),
        ("ablate", ["study=control", "rebuild=x"], "rebuild must be true or false, got x."),
    ],
)
def test_other_kinds_of_values_are_refused_in_one_line(recipe, given, message, tmp_path):
    done = run(recipe, *given, f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 1
    assert f"error: {message}" in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_what_a_file_says_cannot_move_the_cursor_of_the_terminal():
    assert in_one_line(ValueError("it is \x1b[2Jof\r\x9bb")) == "it is [2Jof b"


def test_an_override_that_hydra_cannot_read_is_refused_with_how_to_quote_it():
    done = run("evaluate", BEST, "change=[transforms.push.size=3]")
    assert done.returncode == 1
    assert done.stderr.startswith("error: change=[transforms.push.size=3] must be KEY=VALUE")
    assert "quotes" in done.stderr
    assert "http" not in done.stderr
