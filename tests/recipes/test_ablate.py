"""Studies: what is finished stays, what was cut goes on, what fails is marked."""

import multiprocessing
import re
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from tests.shell import run

STUDY = """
name: tiny
base: [experiment=quickstart_studied, num_envs=16, rollout_steps=4, epochs=2, checkpoint_every=1]
rows: {none: [], mirrored: [symmetry=augmentation], bad: [env.transforms.push.point=toe]}
seeds: [0, 1]
row_seeds: {mirrored: [0], bad: [1]}
total_frames: 256
battery: {name: planar, starts: 1, impulses: [0.1, 0.4], directions: 2, end_time: 3.4}
training_size: "0.4"
"""
ONE_ROW = STUDY.replace("row_seeds: {mirrored: [0], bad: [1]}\n", "")
OTHER = (
    ONE_ROW.replace("name: tiny", "name: other")
    .replace("none: []", "plain: []")
    .replace(", mirrored: [symmetry=augmentation], bad: [env.transforms.push.point=toe]", "")
)


@pytest.fixture
def studies(tmp_path) -> list[str]:
    own = tmp_path / "own" / "study"
    own.mkdir(parents=True)
    (own / "tiny.yaml").write_text(STUDY)
    (own / "other.yaml").write_text(OTHER)
    return ["--config-dir", str(own.parent), f"results={tmp_path}/results", f"runs={tmp_path}/runs"]


def without_speed(folder: Path, name: str) -> list[str]:
    text = (folder / "results" / f"{name}.csv").read_text().splitlines()
    return [line for line in text if "frames_per_s" not in line]


def ablate(args: list[str]) -> None:
    """``python -m recipes.ablate ARGS`` in this process."""
    import torch

    from recipes import ablate as recipe
    from recipes.shell import start

    torch.set_num_threads(1)
    sys.argv = ["recipes/ablate.py", *args]
    start(recipe.main)


@pytest.mark.long
def test_a_study_marks_what_failed_and_runs_what_is_shared_once(studies, tmp_path):
    done = run("ablate", *studies, "study=tiny")
    assert done.returncode == 0, done.stderr
    text = (tmp_path / "results" / "tiny.md").read_text()
    assert "| none |" in text
    assert "| bad, seed 1 | failed: env.transforms.push: point must be" in text
    for ending in ("csv", "tex", "png", "pdf"):
        assert (tmp_path / "results" / f"tiny.{ending}").exists()
    (file,) = (tmp_path / "results" / "results").iterdir()
    stored = file.read_text()
    assert stored.count('"result"') == 3  # two seeds of one row, one of the other
    assert f"{tmp_path}/results/tiny.pdf" in done.stdout
    figures = pd.read_csv(tmp_path / "results" / "tiny.csv")
    assert set(figures["row"]) == {"none", "mirrored"}
    done = run("ablate", *studies, "study=other")  # its only row is a row of the first
    assert done.returncode == 0, done.stderr
    assert [path.name for path in (tmp_path / "results" / "results").iterdir()] == ["tiny.jsonl"]
    assert file.read_text() == stored
    before = without_speed(tmp_path, "tiny")
    assert run("ablate", *studies, "study=tiny", "rebuild=true").returncode == 0
    assert without_speed(tmp_path, "tiny") == before


@pytest.mark.slow
def test_a_study_killed_and_started_again_gives_the_same_table(studies, tmp_path):
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["recipes.ablate"])
    alone = [*studies[:2], f"results={tmp_path}/alone/results", f"runs={tmp_path}/alone/runs"]
    path = tmp_path / "own" / "study" / "tiny.yaml"
    one_row = ONE_ROW.replace(
        " mirrored: [symmetry=augmentation], bad: [env.transforms.push.point=toe]", ""
    )
    path.write_text(one_row.replace("seeds: [0, 1]", "seeds: [0]"))
    for args, kills in ((alone, 0), (studies, 1)):
        for kill in range(kills + 1):
            process = context.Process(target=ablate, args=([*args, "study=tiny"],))
            process.start()
            if kill < kills:
                root = Path(args[3].removeprefix("runs="))
                written = 0
                while process.is_alive() and written < 2 + 3 * kill:  # updates of all runs so far
                    texts = [p.read_text() for p in root.glob("*/metrics.csv")]
                    written = sum(max(0, text.count("\n") - 1) for text in texts)
                    time.sleep(0.01)
                assert process.is_alive()
                process.kill()
            process.join()
        assert process.exitcode == 0
    assert without_speed(tmp_path, "tiny") == without_speed(tmp_path / "alone", "tiny")


def test_rows_that_are_the_same_are_refused(studies, tmp_path):
    path = tmp_path / "own" / "study" / "tiny.yaml"
    path.write_text(STUDY.replace("[symmetry=augmentation]", "[symmetry=none]"))
    done = run("ablate", *studies, "study=tiny")
    assert done.returncode != 0
    assert "rows must differ, mirrored (seed 0) and none (seed 0) are the same" in done.stderr


def test_a_yaml_that_is_no_study_is_refused(studies, tmp_path):
    path = tmp_path / "own" / "study" / "tiny.yaml"
    path.write_text(STUDY.replace("seeds: [0, 1]", "seed: [0, 1]"))
    done = run("ablate", *studies, "study=tiny")
    assert done.returncode == 1
    assert done.stderr.startswith("error: study.seed ")
    assert "did you mean seeds?" in done.stderr
    assert not (tmp_path / "results").exists()


def test_a_launcher_that_fails_is_named_and_leaves_the_rest_to_the_next_call(studies, tmp_path):
    done = run("ablate", *studies, "study=other", "launcher=nowhere")
    assert "launcher nowhere failed" in done.stderr
    assert "nowhere" in (tmp_path / "runs" / "other.log").read_text()
    assert re.search(r"plain, seed 0 +not run", done.stdout)
