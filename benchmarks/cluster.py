"""A study of eight short runs on 1 and on 2 nodes of one core: ``python -m benchmarks.cluster``.

Both clusters are on this machine. One run goes before, so that the files of both studies are in
memory. Needs two free cores; prints the seconds of each, and their ratio.
"""

import os
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

from recipes import ablate
from recipes.shell import start
from zfall.cluster.connection import ray_of

RUNS, FRAMES = 8, 16_384
STUDY = f"""
name: short
base: [experiment=quickstart_studied, num_envs=64, logger=null]
rows: {{none: [], mirrored: [symmetry=augmentation]}}
seeds: [0, 1, 2, 3]
total_frames: {FRAMES}
battery: {{name: planar, starts: 2, impulses: [0.2, 0.4], directions: 4}}
training_size: "0.4"
"""


def main() -> None:
    """Measures the study of ``RUNS`` runs on 1 and on 2 nodes."""
    ray_of("benchmarks.cluster")
    os.environ["PYTHONPATH"] = str(Path(__file__).parents[1])
    with TemporaryDirectory() as folder:
        (Path(folder) / "study").mkdir()
        (Path(folder) / "study" / "short.yaml").write_text(STUDY)
        _seconds(folder, "warm", nodes=1, runs=1)
        one, two = (_seconds(folder, f"of{n}", nodes=n, runs=RUNS) for n in (1, 2))
    print(f"1 node {one:.1f} s, 2 nodes {two:.1f} s: {two / one:.2f} of the time")


def _seconds(folder: str, name: str, nodes: int, runs: int) -> float:
    """How long the runs take, without the start of the nodes."""
    from ray.cluster_utils import Cluster

    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        for _ in range(nodes - 1):
            cluster.add_node(num_cpus=1)
        numbers = ",".join(map(str, range(runs)))
        places = [f"results={folder}/{name}/results", f"runs={folder}/{name}/runs"]
        launcher = ["hydra/launcher=ray", f"hydra.launcher.address='{cluster.address}'"]
        sys.argv = ["recipes/ablate.py", "-m", f"--config-dir={folder}", "study=short", *places]
        sys.argv += [f"jobs={numbers}", *launcher]
        began = time.perf_counter()
        start(ablate.main)
        return time.perf_counter() - began
    finally:
        cluster.shutdown()


if __name__ == "__main__":
    main()
