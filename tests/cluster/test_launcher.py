"""Jobs of a light recipe on a cluster: what dies goes on, what fails is named, files come home."""

import io
import os
import signal
import subprocess
import sys
import threading
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import pytest

from recipes.shell import start
from tests.cluster import counting
from tests.cluster.conftest import ROOT, kill_a_worker, of_ray, wait_until
from tests.shell import Done

LAUNCHER = "hydra/launcher=ray"


def sweep(address: str, *args: str) -> Done:
    """``python -m tests.cluster.counting -m ARGS`` in this process."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    before = sys.argv
    sys.argv = ["counting.py", "-m", *args, LAUNCHER, f"hydra.launcher.address='{address}'"]
    try:
        with redirect_stdout(out), redirect_stderr(err):
            start(counting.main)
    except SystemExit as stop:
        code = 1
        err.write(str(stop.code))
    finally:
        sys.argv = before
    return Done(code, out.getvalue(), err.getvalue())


def counted(folder: Path) -> int:
    """Steps of all jobs so far."""
    return sum(path.read_text().count("\n") for path in folder.rglob("count.txt"))


def begins(folder: Path) -> list[list[int]]:
    """By job, where it began, and its threads."""
    texts = [(folder / name / "begins.txt").read_text().split() for name in ("0", "1")]
    return [[int(word) for word in text] for text in texts]


@pytest.mark.long
@pytest.mark.parametrize("shared", [pytest.param("true", marks=pytest.mark.slow), "false"])
def test_a_job_whose_worker_is_killed_goes_on_from_its_last_checkpoint(
    cluster, tmp_path, monkeypatch, shared
):
    """On a shared disk, and on one of the node's own, whose files are fetched."""
    monkeypatch.chdir(tmp_path)
    folder, killed = tmp_path / "sweep", tmp_path / "killed"

    def kill() -> None:
        try:
            wait_until(lambda: counted(folder) == 2 * counting.STOP)
            kill_a_worker()
        finally:
            killed.touch()  # or the jobs would wait for ever

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    files = ["hydra.sweep.dir=sweep", f"hydra.launcher.shared={shared}", "hydra.launcher.every=0.1"]
    done = sweep(cluster, "until=40,41", f"waits_for={killed}", *files)
    killer.join()
    assert done.returncode == 0, done.stderr
    for number, until in ((0, 40), (1, 41)):
        rows = "".join(f"{row}\n" for row in range(1, until + 1))
        assert (folder / str(number) / "count.txt").read_text() == rows
        assert f"counted {until}" in (folder / f"{number}.log").read_text()
        assert f"/2 #{number} until={until} waits_for={killed}: done" in done.stdout
    whole, cut = sorted(begins(folder), key=len)
    assert whole == [0, 1]
    assert cut[0] == 0
    assert cut[2] > 0  # not anew
    assert {*cut[1::2]} == {1}  # threads: the cores of a job
    assert not list(tmp_path.rglob(".of_*"))
    again = sweep(cluster, "until=42,43", *files)  # other jobs in the same folders: what is there
    assert again.returncode == 0, again.stderr  # is sent, or it would be written over
    assert [each[-2] for each in begins(folder)] == [40, 41]


@pytest.mark.long
def test_a_job_that_fails_is_named_and_the_others_end_well(cluster, tmp_path):
    done = sweep(cluster, "fails=true,false", "until=2", f"hydra.sweep.dir={tmp_path}")
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "1 of 2 failed; #0 fails=True until=2: fails must be false, got true." in line
    assert counted(tmp_path) == 2


@pytest.mark.long
def test_a_sweep_whose_driver_is_killed_loses_nothing_and_leaves_nothing(cluster, tmp_path):
    """The cluster stays; the jobs end with the driver, and go on with the next."""
    args = ["until=60", "seconds=0.05,0.051", f"hydra.sweep.dir={tmp_path}", LAUNCHER]
    command = [sys.executable, "-m", "tests.cluster.counting_from_shell", "-m", *args]
    driver = subprocess.Popen([*command, f"hydra.launcher.address='{cluster}'"], cwd=ROOT)
    wait_until(lambda: counted(tmp_path) >= 10)
    os.kill(driver.pid, signal.SIGKILL)
    driver.wait()
    wait_until(lambda: not of_ray("ray::execute"), 60)
    before = counted(tmp_path)
    assert before < 120
    done = sweep(cluster, *args[:-1])
    assert done.returncode == 0, done.stderr
    assert counted(tmp_path) == 120
    assert sum(each[-2] for each in begins(tmp_path)) >= before - 2  # one row may be half written


def test_a_node_without_the_disk_says_so(tmp_path):
    from types import SimpleNamespace

    from zfall.cluster.job import execute
    from zfall.versions import package_versions

    gone = SimpleNamespace(versions=package_versions(), sign=tmp_path / "elsewhere" / "sign")
    ending = execute(SimpleNamespace(log=tmp_path / "log"), gone)
    assert "hydra.launcher.shared must be false" in ending.error
    old = SimpleNamespace(versions={**package_versions(), "torch": "1.0"})
    assert "has torch" in execute(None, old).error


@pytest.mark.slow
def test_a_cluster_of_a_sweep_ends_with_it(tmp_path):
    """Also if the driver is killed."""
    before = {*of_ray()}
    args = ["-m", "until=500,501", f"hydra.sweep.dir={tmp_path}", LAUNCHER]
    command = [sys.executable, "-m", "tests.cluster.counting_from_shell", *args]
    driver = subprocess.Popen(command, cwd=ROOT)
    wait_until(lambda: counted(tmp_path) >= 4)
    assert {*of_ray()} - before
    driver.kill()
    driver.wait()
    wait_until(lambda: not {*of_ray()} - before, 90)
