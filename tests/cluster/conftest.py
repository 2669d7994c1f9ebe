"""A cluster of two nodes with a core each, on this machine."""

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

ray = pytest.importorskip("ray", reason="pip install 'zfall[ray]'")

MARK = f"ZFALL_TESTS={os.getpid()}"  # in the environment of all that we start
os.environ |= dict([MARK.split("=")])
ROOT = Path(__file__).parents[2]
STUDY = """
name: tiny
base: [experiment=quickstart_studied, num_envs=8, rollout_steps=4, checkpoint_every=1, epochs=1, logger=null]
rows: {none: [], mirrored: [symmetry=augmentation]}
seeds: [0]
total_frames: 256
battery: {name: planar, starts: 1, impulses: [0.1], directions: 2, end_time: 3.4}
training_size: "0.1"
"""


@pytest.fixture(scope="session")
def cluster() -> Iterator[str]:
    """The address of its head; nothing of it is left in the end."""
    from ray.cluster_utils import Cluster

    from zfall.cluster.connection import ray_of

    ray_of("test")
    # Its workers are told by the environment where our code is.
    before, os.environ["PYTHONPATH"] = os.environ.get("PYTHONPATH"), str(ROOT)
    node = {"num_cpus": 1, "object_store_memory": 100_000_000, "include_dashboard": False}
    for last in (False, False, True):
        try:
            made = Cluster(initialize_head=True, head_node_args=node)
            break
        except Exception:  # Ray waits for 30 s, which a busy machine may take
            if last:
                raise
    del node["include_dashboard"]
    try:
        made.add_node(**node)
        yield made.address
    finally:
        ray.shutdown()
        made.shutdown()
        if before is None:
            del os.environ["PYTHONPATH"]
        else:
            os.environ["PYTHONPATH"] = before
        wait_until(lambda: not of_ray(), 30)


@pytest.fixture
def studies(tmp_path: Path) -> list[str]:
    """Arguments of a tiny study."""
    own = tmp_path / "own" / "study"
    own.mkdir(parents=True)
    (own / "tiny.yaml").write_text(STUDY)
    return [f"--config-dir={own.parent}", "study=tiny"]


def of_ray(name: str = "") -> list[int]:
    """Processes that Ray has started for these tests, by the begin of what they call themselves."""
    names = (name,) if name else ("ray::", "raylet", "gcs_server")
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().decode().split("\0")
            ours = MARK.encode() in (entry / "environ").read_bytes().split(b"\0")
        except OSError:
            continue
        if ours and words[0].rpartition("/")[2].startswith(names):
            found.append(int(entry.name))
    return found


def wait_until(holds: Callable[[], object], seconds: float = 400.0) -> None:
    """Waits for something that must come to be."""
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end, "it did not come"
        time.sleep(0.01)


def rows(folder: Path) -> int:
    """Updates that all runs below a folder have behind them."""
    return sum(max(0, path.read_text().count("\n") - 1) for path in folder.rglob("metrics.csv"))


def kill_a_worker() -> None:
    """Ends one of those that run a job, without a word to it."""
    wait_until(lambda: of_ray("ray::execute"), 60)
    os.kill(of_ray("ray::execute")[0], signal.SIGKILL)


def without_speed(results: Path) -> dict[str, str]:
    """The tables of a study by file, but for the one figure that depends on the clock."""
    texts = {}
    for ending in ("csv", "md", "tex"):
        text = (results / f"tiny.{ending}").read_text()
        kept = []
        for line in text.splitlines():
            cut = {"md": " | ", "tex": " & "}.get(ending)
            if "frames_per_s" not in line:
                kept.append(line.rpartition(cut)[0] if cut else line)
        texts[ending] = "\n".join(kept)
    return texts
