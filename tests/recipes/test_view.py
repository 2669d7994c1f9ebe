"""What `view` refuses, each in one line, before it serves anything."""

import socket

import pytest

from tests.shell import run

pytest.importorskip("viser", reason="the extra [view] is not installed")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["run=nowhere"], "there is no folder nowhere"),
        (["worlds=0"], "worlds must lie in 1 to 16, got 0"),
        (["worlds=1", "compare=limp"], "worlds must be at least 2 to compare, got 1."),
        (["port=70000"], "port must lie in 0 to 65535, got 70000"),
        (["run=twin", "compare=zeroth_fall"], "run and compare must have the same control_dt"),
    ],
)
def test_bad_input_is_refused_in_one_line(given, message):
    done = run("view", *given)
    assert done.returncode == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_port_that_is_taken_is_refused():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = run("view", "run=limp", f"port={port}")
    assert f"port must be free at 127.0.0.1, got {port}" in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_run_without_a_checkpoint_yet_is_refused(tmp_path):
    (tmp_path / "checkpoints").mkdir()
    done = run("view", f"run={tmp_path}")
    assert done.returncode == 1
    assert str(tmp_path) in done.stderr
    assert done.stderr.count("\n") == 1


def test_what_is_not_installed_is_named(monkeypatch):
    monkeypatch.setattr("recipes.view.find_spec", lambda name: None)
    done = run("view")
    assert "view needs viser, trimesh, plotly: pip install zfall[view]" in done.stderr
