"""What becomes of a change: a recipe is run until its work would begin."""

from collections.abc import Callable
from typing import Any

from tests.fuzz.changes import Change
from tests.shell import run

WORK = [  # where it begins, in each recipe
    *("zfall.training.loop.train", "zfall.evaluation.run.run_or_read"),
    *("zfall.evaluation.single_trial.show_trial", "zfall.evaluation.play.walk"),
    *("zfall.policies.export.export", "recipes.bench.measure"),
    *("zfall.training.speed.measure_experiment", "zfall.studies.study.Study.run"),
    *("zfall.falling.recording.pushed_worlds", "zfall.falling.trigger.record"),
    *("zfall.falling.movements.save_catches", "zfall.checkpoint.save"),
]
BEGINS = "the work begins"
RULES = (" must ", " is not ", " not find ", "did you mean", " needs ", " takes no ", "Could not")
RULES += ("not found", "no key", "give just one", " lacks ", " has ", " missing", " reads what")


class Outcome:
    """Accepted, refused or broken; and of a refusal, what its line names."""

    def __init__(self, change: Change, code: int, text: str, broken: str = ""):
        lines = text.strip().splitlines()
        self.broken = broken
        self.accepted = not broken and (code == 0 or lines[-1:] == [BEGINS])
        self.line = lines[-1] if lines else ""
        refused = not broken and not self.accepted
        one = len(lines) == 1 and self.line.startswith("error: ")
        if refused and not one:
            self.broken = f"not one line: {text[-400:]}"
        parts = [part for part in change.key.split(".") if not part.isdigit()]
        self.names_key = any(part in self.line for part in parts[-2:])
        self.names_rule = any(rule in self.line for rule in RULES)
        value = change.words[-1].partition("=")[2].strip("'\"")
        self.names_value = (
            value in self.line
            or "got" in self.line
            or not value
            or "~" in (change.words[-1][0])
            or change.words[-1].startswith("+")
            or "did you mean" in self.line
            or "is not a" in self.line
        )


def outcome_of(change: Change, patch: Callable[[str, Any], None], folder: str) -> Outcome:
    """Runs a changed recipe until its work would begin.

    Args:
        change: what is changed.
        patch: ``monkeypatch.setattr``.
        folder: for what it might write.
    """

    def begin(*args: Any, **values: Any) -> None:
        raise SystemExit(BEGINS)

    for place in WORK:
        patch(place, begin)
    own = [] if change.recipe == "ablate" else [f"hydra.run.dir={folder}"]
    try:
        done = run(change.recipe, *own, *change.words)
    except BaseException as error:
        return Outcome(change, 1, "", f"{type(error).__name__}: {error}")
    return Outcome(change, done.returncode, done.stderr)
