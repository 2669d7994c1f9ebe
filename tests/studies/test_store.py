"""Stored results: found again, shared, and what is known of a test without one."""

import json
import math
import threading

import pandas as pd
import pytest

from tests.studies.conftest import CURVE, some_test, write
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
    store, test = Store(tmp_path / "results", tmp_path / "runs"), some_test(seed=0)
    assert store.why_missing(test) == "not run"
    store.mark_failed(test, ValueError("loss must stay finite,\ngot nan"))
    assert store.why_missing(test) == "failed: loss must stay finite, got nan"


def test_a_result_is_found_whatever_study_it_is_of(tmp_path):
    store = Store(tmp_path / "results", tmp_path / "runs")
    assert store.find(some_test(seed=0)) is None
    write(store, some_test(seed=0, total_frames=1), success=0.1, clean=math.nan)
    write(store, some_test(seed=1, total_frames=1), study="other", success=0.2)
    for each in (store, Store(store.results, store.runs)):
        first, second = (
            each.find(some_test(seed=seed, total_frames=1, name="x")) for seed in (0, 1)
        )
        assert (first.figures["success"], second.figures["success"]) == (0.1, 0.2)
        assert math.isnan(first.figures["clean"])
        pd.testing.assert_frame_equal(first.curve, pd.DataFrame(CURVE))
    lines = (store.results / "results" / "tiny.jsonl").read_text().splitlines()
    entries = [json.loads(line, parse_constant=pytest.fail) for line in lines]  # strict JSON
    assert {"torch", "torchrl", "mujoco", "tensordict", "numpy"} <= set(entries[-1]["versions"])


def test_what_results_share_is_stored_once(tmp_path):
    store, test = Store(tmp_path / "results", tmp_path / "runs"), some_test(seed=0)
    write(store, test)
    write(store, type(test)("", None, {**test.inputs, "measures": 2}))
    lines = (store.results / "results" / "tiny.jsonl").read_text().splitlines()
    kinds = ["result" if "result" in line else next(iter(line)) for line in map(json.loads, lines)]
    assert kinds == ["id", "id", "id", "result", "result"]  # training, battery, curve


def test_a_full_disk_leaves_the_results_before_and_nothing_else(tmp_path, request):
    store = Store(tmp_path / "results", tmp_path / "runs")
    write(store, some_test(seed=0))
    folder = store.results / "results"
    before = (folder / "tiny.jsonl").read_text()
    request.getfixturevalue("full_disk")
    with pytest.raises(OSError, match="No space left"):
        write(store, some_test(seed=1))
    assert [path.name for path in folder.iterdir()] == ["tiny.jsonl"]
    assert (folder / "tiny.jsonl").read_text() == before


def test_processes_that_write_at_once_lose_nothing(tmp_path):
    def some(first: int) -> None:
        for seed in range(first, 20, 4):
            write(Store(tmp_path / "results", tmp_path / "runs"), some_test(seed=seed))

    threads = [threading.Thread(target=some, args=(first,)) for first in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    store = Store(tmp_path / "results", tmp_path / "runs")
    assert all(store.find(some_test(seed=seed)) for seed in range(20))


@pytest.mark.parametrize("line", ["<<<<<<< HEAD", "{}", "[]", '{"result": {}, "training": "gone"}'])
def test_a_line_that_is_damaged_is_named(tmp_path, line):
    store = Store(tmp_path / "results", tmp_path / "runs")
    write(store, some_test(seed=0))
    path = store.results / "results" / "tiny.jsonl"
    path.write_text(f"{path.read_text()}{line}\n")
    with pytest.raises(ValueError, match="tiny.jsonl, line 5, must be"):
        store.find(some_test(seed=0))


def test_the_nearest_result_is_named_with_what_differs(tmp_path):
    store = Store(tmp_path / "results", tmp_path / "runs")
    assert "no stored results" in store.nearest(some_test(seed=0))
    write(store, some_test(seed=0, gamma=0.9, lmbda=0.9))
    write(store, some_test(seed=0, gamma=0.95), study="other")
    found = store.nearest(some_test(seed=0, gamma=0.99))
    assert found.endswith("none of other (seed 0), differs in gamma (0.95 stored, 0.99 wanted)")


def test_any_key_that_names_a_policy_counts_by_its_weights(compose_config, tmp_path):
    """A loss of the user's may call its teacher otherwise."""
    (tmp_path / "checkpoints").mkdir()
    loss = f"{{_target_: mine.Distilled, expert: {tmp_path}}}"
    cfg, found = compose_config(f"+auxiliary_losses.mine={loss}"), []
    for content in (b"one", b"other", b"one"):
        (tmp_path / "checkpoints" / "last.pt").write_bytes(content)
        found.append(training_digest(cfg))
    assert found[0] == found[2] != found[1]


def test_a_warm_start_counts_by_its_weights_and_not_by_its_name(compose_config, tmp_path):
    found = []
    for name in ("here", "there"):
        (tmp_path / name / "checkpoints").mkdir(parents=True)
        (tmp_path / name / "checkpoints" / "last.pt").write_bytes(b"the same")
        found.append(training_digest(compose_config(f"warm_start={tmp_path / name}")))
    assert found[0] == found[1] != training_digest(compose_config())
