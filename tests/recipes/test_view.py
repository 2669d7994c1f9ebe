"""What `view` refuses, each in one line, before it serves anything."""

import signal
import socket
import subprocess
import sys

import pytest

from tests.shell import ROOT, run

pytest.importorskip("viser", reason="the extra [view] is not installed")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["run=nowhere"], "there is no folder nowhere"),
        (["worlds=0"], "worlds must lie in 1 to 16, got 0"),
        (["worlds=1", "compare=limp"], "worlds must be at least 2 to compare, got 1."),
        (["port=70000"], "port must lie in 0 to 65535, got 70000"),
        (["run=twin_25hz", "compare=zeroth_fall"], "run and compare must have the same control_dt"),
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


@pytest.mark.long
def test_ctrl_c_ends_it_with_one_line_and_frees_the_port(tmp_path):
    command = [sys.executable, "-m", "recipes.view", "run=limp", "worlds=1", "port=0"]
    command += [f"hydra.run.dir={tmp_path}/run"]
    with subprocess.Popen(
        command, cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("open http://127.0.0.1:")
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (130, "", "stopped\n")
    port = int(line.split(":")[2].split(" ")[0])
    with socket.socket() as again:
        again.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        again.bind(("127.0.0.1", port))


def test_what_is_not_installed_is_named(monkeypatch):
    monkeypatch.setattr("recipes.view.find_spec", lambda name: None)
    done = run("view")
    assert "view needs viser, trimesh, plotly: pip install zfall[view]" in done.stderr
