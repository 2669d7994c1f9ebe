"""Studies on a cluster whose processes die: the tables are those of a study that nobody disturbed."""

import multiprocessing
import os
import random
import signal
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from tests.cluster.conftest import kill_a_worker, of_ray, rows, wait_until, without_speed
from tests.shell import run

SIX = ["study.seeds=[0,1,2]", "study.total_frames=1024"]


def jobs(count: int, address: str, *args: str) -> list[str]:
    """Arguments for the runs of a study as jobs of a cluster."""
    numbers = ",".join(map(str, range(count)))
    launcher = ["hydra/launcher=ray", f"hydra.launcher.address='{address}'"]
    return ["-m", *args, f"jobs={numbers}", *launcher, "hydra.launcher.retries=20"]


def places(folder: Path) -> list[str]:
    return [f"results={folder}/results", f"runs={folder}/runs"]


def tables(folder: Path, studies: list[str]) -> dict[str, Any]:
    """Makes the tables of what is finished."""
    done = run("ablate", *studies, *places(folder), "rebuild=true")
    assert done.returncode == 0, done.stderr
    assert "not run" not in done.stdout
    assert "failed" not in done.stdout
    curves = (folder / "results" / "tiny.png").read_bytes()
    return {**without_speed(folder / "results"), "png": curves}


def undisturbed(folder: Path, studies: list[str]) -> dict[str, Any]:
    """The tables of the study in this process, one run after the other."""
    done = run("ablate", *studies, *places(folder))
    assert done.returncode == 0, done.stderr
    return tables(folder, studies)


def ablate(args: list[str]) -> None:
    """``python -m recipes.ablate ARGS`` in a process of its own."""
    from recipes import ablate as recipe
    from recipes.shell import start

    sys.argv = ["recipes/ablate.py", *args]
    start(recipe.main)


@pytest.mark.slow
def test_a_study_whose_worker_is_killed_has_the_same_tables(cluster, studies, tmp_path):
    expected = undisturbed(tmp_path / "alone", studies)
    own, folder = [*studies, *places(tmp_path)], tmp_path / "runs"
    killer = threading.Thread(
        target=lambda: (wait_until(lambda: rows(folder) >= 3), kill_a_worker()), daemon=True
    )
    killer.start()
    done = run("ablate", *jobs(2, cluster, *own))
    killer.join()
    assert done.returncode == 0, done.stderr
    assert "2/2 #" in done.stdout  # a line for each as it ends
    assert tables(tmp_path, studies) == expected


@pytest.mark.slow
def test_a_study_of_six_runs_survives_ten_kills_of_workers(cluster, studies, tmp_path):
    own, moments = [*studies, *SIX], random.Random(0)
    expected = undisturbed(tmp_path / "alone", own)
    killed, over = [], threading.Event()

    def kill() -> None:
        while len(killed) < 10 and not over.wait(moments.uniform(0.5, 4.0)):
            if at_work := of_ray("ray::execute"):
                os.kill(moments.choice(at_work), signal.SIGKILL)
                killed.append(time.monotonic())
                wait_until(lambda: len(of_ray("ray::execute")) > 0 or over.is_set())

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    done = run("ablate", *jobs(6, cluster, *own, *places(tmp_path)))
    over.set()
    killer.join()
    assert done.returncode == 0, done.stderr
    assert len(killed) == 10
    assert tables(tmp_path, own) == expected


@pytest.mark.slow
def test_a_study_of_six_runs_survives_ten_kills_of_its_driver(studies, tmp_path):
    """As from the shell, with a cluster of its own: nothing stays of one that was killed."""
    own, moments, others = [*studies, *SIX], random.Random(1), {*of_ray()}
    expected = undisturbed(tmp_path / "alone", own)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["recipes.ablate"])
    args = [*own, *places(tmp_path), "launcher=ray"]
    for _ in range(10):
        driver = context.Process(target=ablate, args=(args,))
        before = rows(tmp_path / "runs")
        driver.start()
        wait_until(lambda before=before: rows(tmp_path / "runs") > before)
        driver.join(moments.uniform(0.0, 1.0))
        driver.kill()
        driver.join()
        wait_until(lambda: not {*of_ray()} - others, 90)
    ablate_again = run("ablate", *args)
    assert ablate_again.returncode == 0, ablate_again.stderr
    assert tables(tmp_path, own) == expected
