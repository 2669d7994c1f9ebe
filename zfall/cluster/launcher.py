"""Jobs of a hydra sweep as Ray tasks: ``hydra/launcher=ray``."""

import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.plugins import Plugins
from hydra.core.singleton import Singleton
from hydra.core.utils import JobReturn, JobStatus, configure_log, setup_globals
from hydra.plugins.launcher import Launcher
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf, open_dict

from zfall.cluster.connection import connected
from zfall.cluster.job import Ending, Job, Sweep, execute, recipe_of
from zfall.cluster.mirror import Keeper, on_own_disk
from zfall.commands import shown_path
from zfall.errors import check_number
from zfall.versions import package_versions

KEY = "hydra.launcher"
_PLUGINS = str(Path(__file__).with_name("plugins"))
STOPPING = 60.0  # seconds in which jobs may end after ctrl-c, with a checkpoint


def register() -> None:
    """Lets hydra find ``hydra/launcher=ray``, in recipes of any folder."""
    if _PLUGINS not in sys.path:
        sys.path.append(_PLUGINS)
    known = Plugins.instance()
    if f"{RayLauncher.__module__}.RayLauncher" not in known.class_name_to_class:
        known.register(RayLauncher)  # hydra had looked for plugins before
    node = OmegaConf.to_container(OmegaConf.load(Path(__file__).with_name("ray.yaml")))
    given: Any = {"group": "hydra/launcher", "name": "ray", "provider": "zfall"}
    ConfigStore.instance().store(node=node, **given)


class RayLauncher(Launcher):
    """Runs the jobs of a sweep on the nodes of a cluster, and says of each as it ends what came.

    A job whose worker or node dies is begun again, wherever there is room. A recipe that keeps
    checkpoints goes on from the last. A job that fails leaves the others alone.

    Args:
        address: ``HOST:PORT`` of a cluster's head, ``auto``, or ``None``: one is started here.
        cpus: cores of a job, and its threads.
        gpus: of a job.
        memory: of a job [GB]; ``None``: is not counted.
        resources: of a job, by the cluster's own names.
        retries: of a job whose worker or node dies.
        shared: whether all nodes see this disk; else files are sent to and fro.
        reads: files and folders that a job is sent if not.
        every: seconds after which what a job has written is fetched if not.
        given: by key, values for each job whose recipe has the key and leaves it null.

    Raises:
        ValueError: on a number that no job can have.
    """

    __module__ = "hydra_plugins.zfall_ray"  # hydra makes plugins of that package alone

    def __init__(
        self,
        *,
        address: str | None,
        cpus: int,
        gpus: float,
        memory: float | None,
        resources: Mapping[str, float] | None,
        retries: int,
        shared: bool,
        reads: Sequence[str | None],
        every: float,
        given: Mapping[str, Any],
    ):
        check_number(cpus, f"{KEY}.cpus", lambda x: x >= 1 and x == int(x), "be a whole number > 0")
        check_number(gpus, f"{KEY}.gpus", lambda x: 0 <= x < math.inf, "be 0 or more")
        check_number(every, f"{KEY}.every", lambda x: 0 < x < math.inf, "be positive")
        check_number(
            retries, f"{KEY}.retries", lambda x: x >= 0 and x == int(x), "be a whole number >= 0"
        )
        if memory is not None:
            check_number(memory, f"{KEY}.memory", lambda x: 0 < x < math.inf, "be positive")
        self.address, self.shared, self.every, self.given = address, shared, every, given
        self.retries, self.cores = int(retries), int(cpus)
        self.needs: dict[str, Any] = {"num_cpus": int(cpus), "num_gpus": gpus}
        self.needs |= {"resources": dict(resources)} if resources else {}
        self.needs |= {"memory": int(memory * 1e9)} if memory is not None else {}

    def setup(
        self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig
    ) -> None:
        """Is told by hydra what to launch."""
        self.context, self.task, self.config = hydra_context, task_function, config

    def launch(
        self, job_overrides: Sequence[Sequence[str]], initial_job_idx: int
    ) -> Sequence[JobReturn]:
        """Runs jobs to their end.

        Raises:
            ValueError: if there is no such cluster, or some failed, naming each.
        """
        setup_globals()
        configure_log(self.config.hydra.hydra_logging, self.config.hydra.verbose)
        jobs = [self._job(initial_job_idx + i, each) for i, each in enumerate(job_overrides)]
        recipe = recipe_of(self.task)
        folder = Path(str(self.config.hydra.sweep.dir))
        with connected(self.address) as ray:
            check_fits(ray.nodes(), self.needs, self.address)
            folder.mkdir(parents=True, exist_ok=True)
            with sign_in(folder) as sign:
                sweep = Sweep(
                    recipe,
                    self.context,
                    Singleton.get_state(),
                    Path.cwd(),
                    self.cores,
                    package_versions(),
                    sign,
                )
                around = None if self.shared else self._mirror(ray, jobs, folder)
                remote = ray.remote(max_retries=self.retries, **self.needs)(execute)
                shared = ray.put(sweep)
                running = {remote.remote(job, shared, around): job for job in jobs}
                endings: dict[int, Ending] = {}
                for job, ending in ended(ray, running):
                    endings[job.number] = ending
                    how = f"failed: {ending.error} ({job.log})" if ending.error else "done"
                    print(f"{len(endings)}/{len(jobs)} {job.name}: {how}", flush=True)
        failed = [job for job in jobs if endings[job.number].error]
        if failed:
            first = failed[0]
            raise ValueError(
                f"all jobs of a sweep must end well, {len(failed)} of {len(jobs)} failed; "
                f"{first.name}: {endings[first.number].error} ({first.log})"
            )
        return [_return_of(job, endings[job.number].value) for job in jobs]

    def _job(self, number: int, overrides: Sequence[str]) -> Job:
        """A job, its config composed, with the same folder wherever it runs."""
        config = self.context.config_loader.load_sweep_config(self.config, list(overrides))
        with open_dict(config):
            config.hydra.job.id = f"{config.hydra.job.name}_{number}"
            config.hydra.job.num = number
            for key, value in self.given.items():
                if key in config and config[key] is None:
                    config[key] = value
            # It may contain the time; a node without our disk has another working directory.
            given = Path(str(self.config.hydra.sweep.dir))
            config.hydra.sweep.dir = folder = shown_path(given.absolute())
            config.hydra.sweep.subdir = subdir = str(config.hydra.sweep.subdir)
        return Job(number, config, Path(folder) / subdir, Path(folder) / f"{subdir}.log")

    def _mirror(self, ray: Any, jobs: Sequence[Job], folder: Path) -> Callable[[Job, Sweep], Any]:
        """Carries files of jobs; the keeper's disk is the one of this process."""
        from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

        here = Path.cwd()
        if not folder.absolute().is_relative_to(here):
            raise ValueError(
                f"hydra.sweep.dir must lie in the working directory with {KEY}.shared=false, "
                f"got {folder}."
            )
        reads = {job.number: [*paths_read(job.config, here), str(job.folder)] for job in jobs}
        names = {job.number: " ".join(job.config.hydra.overrides.task) for job in jobs}
        node = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=False)
        actor = ray.remote(num_cpus=0, scheduling_strategy=node)(Keeper)
        keeper = actor.remote(here, folder.absolute() / ".files", reads, names)
        return partial(on_own_disk, keeper=keeper, every=self.every)


def paths_read(config: DictConfig, here: Path) -> list[str]:
    """Which files and folders of the working directory a job reads, by its config.

    Raises:
        ValueError: if one lies elsewhere.
    """
    paths = [Path(str(each)) for each in config.hydra.launcher.reads if each is not None]
    found = [path.absolute() for path in paths if path.exists()]  # others name what ships
    for path in found:
        if not path.is_relative_to(here):
            raise ValueError(
                f"{KEY}.reads must lie in the working directory with shared=false, got {path}."
            )
    return [str(path.relative_to(here)) for path in found]


def check_fits(nodes: Sequence[Mapping[str, Any]], needs: Mapping[str, Any], address: Any) -> None:
    """Refuses jobs that need more than a cluster of our own has; another one may grow.

    Raises:
        ValueError: naming what does not fit.
    """
    wanted = {"CPU": needs["num_cpus"], "GPU": needs["num_gpus"], **needs.get("resources", {})}
    wanted |= {"memory": needs["memory"]} if "memory" in needs else {}
    wanted = {name: count for name, count in wanted.items() if count}
    have = [node["Resources"] for node in nodes if node["Alive"]]
    if any(all(each.get(name, 0) >= count for name, count in wanted.items()) for each in have):
        return
    most = {name: max((each.get(name, 0) for each in have), default=0) for name in wanted}
    line = f"{KEY}: a node must have what a job needs, {wanted}; the most that one has is {most}"
    if address is None:
        raise ValueError(f"{line}.")
    print(f"{line}. Waits for one.", flush=True)


@contextmanager
def sign_in(folder: Path) -> Iterator[Path]:
    """A file by which another node knows that it sees the same disk."""
    sign = folder.absolute() / f".of_{os.uname().nodename}_{os.getpid()}"
    sign.touch()
    try:
        yield sign
    finally:
        sign.unlink(missing_ok=True)


def ended(ray: Any, running: dict[Any, Job]) -> Iterator[tuple[Job, Ending]]:
    """Jobs as they end; ctrl-c ends all of them, those that train with a checkpoint."""
    try:
        while running:
            for ref in ray.wait(list(running))[0]:
                yield running.pop(ref), _ending_of(ray, ref)
    except KeyboardInterrupt:
        for ref in running:
            ray.cancel(ref)
        if running:
            ray.wait(list(running), num_returns=len(running), timeout=STOPPING)
        raise


def _ending_of(ray: Any, ref: Any) -> Ending:
    try:
        ending: Ending = ray.get(ref)
    except ray.exceptions.RayError as error:
        reason = next((line.strip() for line in str(error).splitlines() if line.strip()), "no word")
        return Ending(error=f"{type(error).__name__}: {reason}")
    return ending


def _return_of(job: Job, value: Any) -> JobReturn:
    """What hydra's sweepers read."""
    done = JobReturn(
        overrides=list(job.config.hydra.overrides.task),
        cfg=OmegaConf.masked_copy(job.config, [*{str(key) for key in job.config} - {"hydra"}]),
        hydra_cfg=OmegaConf.masked_copy(job.config, ["hydra"]),
        working_dir=str(Path.cwd()),
        task_name=job.config.hydra.job.name,
        status=JobStatus.COMPLETED,
    )
    done.return_value = value
    return done
