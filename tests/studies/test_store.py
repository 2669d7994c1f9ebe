"""What tells trainings apart, and what is known of a test without results."""

import pytest

from zfall.studies import plan
from zfall.studies.store import Store, training_digest


def test_a_training_depends_on_the_weights_of_its_teacher(compose_config, tmp_path):
    (tmp_path / "checkpoints").mkdir()
    cfg = compose_config(
        "experiment=best", "imitation=teacher", f"auxiliary_losses.imitation.teacher={tmp_path}"
    )
    found = []
    for content in (b"one", b"other", b"one"):
        (tmp_path / "checkpoints" / "last.pt").write_bytes(content)
        found.append(training_digest(cfg))
    assert found[0] == found[2] != found[1]


@pytest.mark.parametrize(
    "override", ["name=first", "logger=[]", "logger=[{_target_: mine.Logger, project: balance}]"]
)
def test_names_and_loggers_tell_no_trainings_apart(compose_config, override):
    assert training_digest(compose_config(override)) == training_digest(compose_config())
    assert training_digest(compose_config("seed=1")) != training_digest(compose_config())


def test_the_number_of_groups_tells_no_trainings_apart(compose_config):
    digests = {training_digest(compose_config(f"groups={groups}")) for groups in (1, 2)}
    assert len(digests) == 1
    assert training_digest(compose_config("num_envs=8")) not in digests


def test_a_failure_is_shown_in_place_of_figures(tmp_path):
    store, test = Store(tmp_path / "results", tmp_path / "runs"), plan.Test("", None, "name")
    assert store.why_missing(test) == "not run"
    store.mark_failed(test, ValueError("loss must stay finite,\ngot nan"))
    assert store.why_missing(test) == "failed: loss must stay finite, got nan"
