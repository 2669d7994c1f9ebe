"""A training in several processes, from the shell: resumed, killed, and misused."""

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from tests.recipes.test_killed import same
from tests.several import Ended, config, in_each, train_in_each
from zfall import checkpoint
from zfall.training.collection import Worlds
from zfall.training.launch import LOST, run_ranks
from zfall.training.meeting import owned_by_all, ranks_of

UPDATES = 5
SMALL = ["num_envs=8", "groups=2", "rollout_steps=4", "minibatches=2", "epochs=2", "showcase=null",
         "logger=null", "checkpoint_every=1", "env.transforms.limit.seconds=0.3",
         "env.transforms.push.interval=[0.0,0.1]"]  # fmt: skip
FRAMES = f"total_frames={UPDATES * 32}"


def in_both(*overrides: str) -> list[list[str]]:
    return [list(overrides)] * 2


def ended_well(ended: list[Ended]) -> None:
    for each in ended:
        assert each.code == 0, each.err


def refused(ended: list[Ended]) -> str:
    """The only line that was said when all ended."""
    assert all(each.code not in (0, None) for each in ended), ended
    (line,) = "".join(each.err for each in ended).splitlines()
    return line


def files(folder: Path) -> list[Path]:
    return sorted(path.relative_to(folder) for path in folder.glob("checkpoints/**/*.pt"))


def assert_same_run(one: Path, other: Path) -> None:
    """Rows, checkpoints and the parts of all ranks, to the last bit."""
    assert (one / "metrics.csv").read_bytes() == (other / "metrics.csv").read_bytes()
    assert files(one) == files(other)
    for path in files(one):
        left, right = (checkpoint.load(folder / path, {}) for folder in (one, other))
        assert same(*({k: v for k, v in x.items() if k != "config"} for x in (left, right)))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> Path:
    """A run of two ranks that nobody disturbed."""
    folder = tmp_path_factory.mktemp("whole")
    ended_well(train_in_each(in_both(*SMALL, FRAMES, f"hydra.run.dir={folder}/run"), folder))
    return folder / "run"


@pytest.mark.long
def test_a_run_of_two_ranks_goes_on_exactly(whole, tmp_path):
    """And every rank has written its part, once for the last update."""
    run = tmp_path / "run"
    shorter = in_both(*SMALL, "total_frames=64", f"hydra.run.dir={run}")
    ended_well(train_in_each(shorter, tmp_path))
    assert Path("checkpoints/parts/2-1-of-2.pt") in files(run)
    unused = f"hydra.run.dir={tmp_path}/unused"
    ended_well(train_in_each(in_both(f"resume={run}", FRAMES, unused), tmp_path))
    assert Path(f"checkpoints/parts/{UPDATES}-1-of-2.pt") in files(run)
    assert_same_run(run, whole)


@pytest.mark.long
def test_a_run_goes_on_in_another_number_of_ranks_and_says_what_is_new(whole, tmp_path):
    run = shutil.copytree(whole, tmp_path / "run")
    more = f"total_frames={(UPDATES + 1) * 32}"
    ended = train_in_each([[f"resume={run}", more, f"hydra.run.dir={tmp_path}/unused"]], tmp_path)
    ended_well(ended)
    assert "launch.ranks: its worlds are drawn anew" in ended[0].out
    content = checkpoint.load(run / "checkpoints" / "last.pt", checkpoint.TRAINING)
    assert content["updates"] == UPDATES + 1
    assert content["run"]["ranks"] == 1
    assert sum(len(state["carrier"]["done"]) for state in content["worlds"]) == 8
    assert [path.name for path in files(run)] == ["best.pt", "last.pt"]


def test_worlds_that_are_drawn_anew_keep_their_level_of_the_curriculum():
    """Two ranks' states of four worlds each, for one process with all eight."""
    cfg = config("experiment=best", "num_envs=8")
    worlds = Worlds(cfg.env, 8, 2)
    worlds.begin(0)
    states = worlds.state_dict()
    levels = torch.linspace(0.0, 0.7, 8)
    for state, own in zip(states, levels.split(4), strict=True):
        table = state["env"]["transform"]
        (key,) = (key for key in table if key.endswith(".level"))
        table[key] = own
    anew = Worlds(cfg.env, 8, 1)
    anew.begin(1)
    assert "drawn anew" in anew.redraw(states)[0]
    torch.testing.assert_close(anew.carrier["curriculum_level"][:, 0], levels)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (["seed=2"], "seed must be the same on all ranks, got 1 on rank 0 and 2 on rank 1"),
        (["launch.ranks=3"], "launch.ranks must be null or the 2 processes"),
        (["num_envs=9"], "num_envs must be a multiple of launch.ranks, 2, got 9"),
    ],
)
def test_what_ranks_cannot_train_is_refused_in_one_line(given, told, tmp_path):
    """The first is given to one of them alone."""
    of_both = [*SMALL, f"hydra.run.dir={tmp_path}/run", "seed=1"]
    first = of_both if given == ["seed=2"] else [*of_both, *given]
    line = refused(train_in_each([first, [*of_both, *given]], tmp_path))
    assert told in line
    assert not (tmp_path / "run").exists()


def test_a_rank_that_does_not_come_is_named(tmp_path):
    given = [*SMALL, "launch.timeout=1", f"hydra.run.dir={tmp_path}/run"]
    line = refused(train_in_each([given], tmp_path, size=2))
    assert "within launch.timeout, 1 s, of 2 there are missing: 1" in line


def test_a_part_that_is_gone_is_named(whole, tmp_path):
    run = shutil.copytree(whole, tmp_path / "run")
    (run / "checkpoints" / "parts" / f"{UPDATES}-1-of-2.pt").unlink()
    given = [f"resume={run}", f"total_frames={99 * 32}", f"hydra.run.dir={tmp_path}/unused"]
    line = refused(train_in_each(in_both(*given), tmp_path))
    assert f"{UPDATES}-1-of-2.pt must be there" in line


def test_a_folder_that_a_rank_does_not_see_is_refused(tmp_path):
    for error in in_each(separate_folders, 2, tmp_path, tmp_path):
        assert "hydra.run.dir must be a folder that all machines share, rank 1" in str(error)


def separate_folders(folder: Path) -> None:
    with ranks_of(config()) as ranks, owned_by_all(folder / f"of_{ranks.rank}", ranks):
        pass


@pytest.mark.parametrize(
    ("script", "told"),
    [
        ("import os, time; os.environ['RANK'] == '1' and os.kill(os.getpid(), 9); time.sleep(60)",
         "rank 1 was ended by SIGKILL; begin again"),
        (f"import sys; sys.exit({LOST})", "stood still for longer than launch.timeout"),
        ("import sys; sys.exit('error: it was this')", None),
    ],
)  # fmt: skip
def test_the_launcher_says_what_no_rank_can_and_leaves_none(script, told, tmp_path, capfd):
    began = time.monotonic()
    assert run_ranks(["-c", script], 2, tmp_path) == 1
    assert time.monotonic() - began < 30
    assert not children()
    lines = capfd.readouterr().err.splitlines()
    if told is None:
        assert set(lines) == {"error: it was this"}
    else:
        (line,) = lines
        assert told in line


def test_the_launcher_names_the_run_that_can_go_on(whole, capfd):
    assert run_ranks(["-c", "import os; os.kill(os.getpid(), 9)"], 2, whole) == 1
    assert f"go on with resume={whole}." in capfd.readouterr().err


def test_the_launcher_passes_ctrl_c_on_once(tmp_path):
    """Ranks end as after a ctrl-c of their own; the exit code is theirs."""
    script = (
        "import signal, sys, time, pathlib, os\n"
        "def stop(*a): sys.exit(130)\n"
        "signal.signal(signal.SIGINT, stop)\n"
        f"pathlib.Path({str(tmp_path)!r}, os.environ['RANK']).touch()\n"
        "time.sleep(60)"
    )
    code = (
        "import sys; from pathlib import Path; from zfall.training.launch import run_ranks\n"
        f"sys.exit(run_ranks(['-c', {script!r}], 2, Path({str(tmp_path)!r})))"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE)
    while len(list(tmp_path.iterdir())) < 2:
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err == b""


def children() -> list[int]:
    """Processes that this one has started and not waited for, the forkserver's left out."""
    found = []
    for entry in Path("/proc").iterdir() if Path("/proc").exists() else ():
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
        except (OSError, NotADirectoryError):
            continue
        command = (entry / "cmdline").read_bytes()
        if int(fields[1]) == os.getpid() and b"multiprocessing" not in command:
            found.append(int(entry.name))
    return found


def launched(args: list[str], err: Path) -> subprocess.Popen[bytes]:
    with err.open("wb") as file:
        command = [sys.executable, "-m", "recipes.train", *args, "launch.ranks=2"]
        return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=file)


def ranks_below(process: subprocess.Popen[bytes]) -> list[int]:
    listed = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text()
    return [int(pid) for pid in listed.split()]


def killed_and_resumed(whole: Path, folder: Path, frames: str, kills: int, seed: int) -> None:
    """Kills a rank at random moments; all end, say so in a line, and the run is the same."""
    moments, run, err = random.Random(seed), folder / "run", folder / "err"
    metrics, last = run / "metrics.csv", run / "checkpoints" / "last.pt"
    while True:
        if last.exists():
            args = [f"resume={run}", f"hydra.run.dir={folder}/unused"]
        else:
            shutil.rmtree(run, ignore_errors=True)
            args = [*SMALL, frames, f"hydra.run.dir={run}"]
        process = launched(args, err)
        if not kills:
            assert process.wait(300) == 0, err.read_text()
            break
        before = metrics.read_bytes() if metrics.exists() else b""
        while (
            process.poll() is None and (metrics.read_bytes() if metrics.exists() else b"") == before
        ):
            time.sleep(0.005)
        time.sleep(moments.uniform(0.0, 0.3))
        if process.poll() is not None or not (pids := ranks_below(process)):
            assert process.wait(60) == 0, err.read_text()
            break  # it had come to its end
        kills -= 1
        os.kill(moments.choice(pids), signal.SIGKILL)
        began = time.monotonic()
        code = process.wait(30)
        assert time.monotonic() - began < 30
        if code == 0:
            break
        (line,) = err.read_text().splitlines()
        assert "was ended by SIGKILL" in line
        for pid in pids:
            assert not Path(f"/proc/{pid}").exists()
    assert_same_run(run, whole)


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for processes as Linux lists them")
def test_a_rank_killed_ends_all_in_one_line_and_the_run_goes_on_exactly(whole, tmp_path):
    killed_and_resumed(whole, tmp_path, FRAMES, kills=1, seed=0)


@pytest.mark.slow
def test_ranks_killed_20_times_end_as_one_run_that_nobody_disturbed(tmp_path):
    """Each run of four kills; five of them."""
    frames = f"total_frames={40 * 32}"
    for seed in range(5):
        folder = tmp_path / str(seed)
        ended_well(train_in_each(in_both(*SMALL, frames, f"hydra.run.dir={folder}/whole"), folder))
        killed_and_resumed(folder / "whole", folder, frames, kills=4, seed=seed)


@pytest.mark.long
def test_of_two_ranks_the_first_makes_a_file_and_the_other_waits(tmp_path):
    """Both train with it: the second stage warm starts from the policy that was made."""
    text = "{_target_: tests.training.makers.Text, text: a}"
    copy = "{_target_: tests.training.makers.Copy, policy: 'stage:a'}"
    stages = (
        f"+stages={{note: {{make: {text}}}, a: {{total_frames: 32}}, copied: {{make: {copy}}},"
        " b: {total_frames: 32, warm_start: 'stage:copied'}}"
    )
    ended_well(train_in_each(in_both(*SMALL, stages, f"hydra.run.dir={tmp_path}/run"), tmp_path))
    assert (tmp_path / "run" / "made" / "note.txt").read_text() == "a"
    one, other = (
        checkpoint.load(tmp_path / "run" / "checkpoints" / f"{name}.pt")["policy"]
        for name in ("a", "copied")
    )
    assert all(torch.equal(one[key], other[key]) for key in one)
    assert (tmp_path / "run" / "metrics.csv").read_text().count("\n") == 3
