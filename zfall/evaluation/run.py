"""Puts policies to batteries: from Python with ``evaluate``, with files as ``recipes.evaluate``."""

import hashlib
import itertools
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import DictConfig, OmegaConf
from rich.console import Console

from zfall.envs.make import left_out
from zfall.evaluation.battery import run_battery, starts_and_pushes
from zfall.evaluation.candidate import (
    Candidate,
    load_candidates,
    read_trials,
    remove_trials,
    write_trials,
)
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.headings import surroundings
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.plans import plan_trials
from zfall.evaluation.results import Result, labels, result_of, write_results
from zfall.policies.load import Policy
from zfall.terminal import QUIET, progress_bar
from zfall.trust import trusting


def evaluate(
    policy: Policy | str,
    battery: Battery | str = "planar",
    *,
    seed: int = 0,
    num_envs: int = 512,
    checkpoint: str = "last",
    env: DictConfig | str | None = None,
    change: Sequence[str] = (),
    keep: Sequence[str] = (),
    memory: bool = True,
    trust: Sequence[str] = (),
    console: Console = QUIET,
    **options: Any,
) -> Result:
    """Puts a policy to a battery; writes nothing.

    .. code-block:: python

        result = evaluate("best", "planar", starts=5, impulses=[0.3, 0.6])
        print(result.summary["i50_mean"])
        print(result.trials.groupby("impulse")["recovered"].mean())

    Args:
        policy: what ``zfall.load_policy`` gives, the name of one, a run folder, or a baseline.
        battery: its name, or what ``load_battery`` gives.
        seed: of the battery.
        num_envs: worlds that run together, at most; changes no outcome.
        checkpoint: of a run folder, ``last``, ``best``, or a stage of it that is over.
        env: of a baseline, config or name; ``None``: that of the battery's kind.
        change: values of the env to replace, ``["transforms.action.scale=0.5"]``.
        keep: what of the env's ``training_only`` to leave on, ``["noise", "delay"]``.
        memory: whether it remembers from step to step; else each step is its first.
        trust: modules of one's own that a run may name, see ``zfall.trust``; their code is run.
        console: on which to show progress.
        options: numbers of the battery to replace, ``starts=5``.

    Returns:
        ``trials``, one a row, and ``summary``, as ``trials.csv`` and ``summary.json`` have them.

    Raises:
        ValueError: on an unknown policy, battery or option, or values that do not fit.
    """
    if isinstance(battery, Battery) and options:
        raise ValueError(f"options must be given to load_battery, got {', '.join(options)}.")
    given = battery if isinstance(battery, Battery) else load_battery(battery, **options)
    with trusting(trust):
        (candidate,) = load_candidates(
            [policy],
            task=env,
            default_task=kind_of(given).baseline_task,
            checkpoint=checkpoint,
            change=change,
            keep=keep,
            memory=memory,
            world=given.world,
        )
    given = given.of_size(candidate.robot)
    trials = trials_of(given, candidate, seed=seed, num_envs=num_envs, console=console)
    known = candidate.known(given)
    where = surroundings(candidate.env_cfg, given, candidate.kept)
    return result_of(
        given, candidate.label, candidate.robot, trials, known=known, surroundings=where
    )


def trials_of(
    battery: Battery,
    candidate: Candidate,
    *,
    seed: int = 0,
    num_envs: int = 512,
    console: Console = QUIET,
    label: str | None = None,
    folder: Path | None = None,
    conditions: Mapping[str, Any] | None = None,
) -> pd.DataFrame:
    """All trials of a battery, in the way that its kind runs them.

    Args:
        battery: the definition.
        candidate: what is put to it.
        seed: of the battery.
        num_envs: worlds that run together, at most.
        console: on which to show progress.
        label: before the bar.
        folder: where what is finished is kept, so that an interrupted call can go on; ``None``:
            nowhere.
        conditions: of which what is kept there must be.
    """
    label = label or f"{battery.name} of {candidate.name}"
    kind = kind_of(battery)

    def run(
        label: str,
        plan: pd.DataFrame | None = None,
        finished: pd.DataFrame | None = None,
        keep: Callable[[pd.DataFrame], None] = lambda trials: None,
    ) -> pd.DataFrame:
        with progress_bar(console) as bar:
            task = bar.add_task(label)
            return run_battery(
                battery,
                candidate.env_cfg,
                candidate.actor,
                seed=seed,
                num_envs=num_envs,
                servos=candidate.servos,
                progress=lambda done, total: bar.update(task, completed=done, total=total),
                plan=plan,
                finished=finished,
                keep=keep,
            )

    under = dict(conditions or {})
    if kind.independent:
        if folder is None:
            return run(label)
        partial = folder / "trials.partial.csv"
        finished = read_trials(partial, under)
        if finished is not None:
            console.print(f"goes on after {len(finished)} trials of {partial}")
        return run(
            label, finished=finished, keep=lambda so_far: write_trials(partial, so_far, under)
        )
    numbers = itertools.count()

    def one_round(plan: pd.DataFrame) -> pd.DataFrame:
        number = next(numbers)
        name = f"{label}, round {number}"
        if folder is None:
            return run(name, plan)
        path = folder / "rounds" / f"{candidate.label}_{number}.csv"
        path.parent.mkdir(exist_ok=True)
        wanted = under | {"of": candidate.label, "round": number}
        done = read_trials(path, wanted)
        if done is None:
            done = run(name, plan)
            write_trials(path, done, wanted)
        return done

    return kind.run(battery, plan_trials(battery, candidate.robot.impulse_unit, seed), one_round)


def run_or_read(
    battery: Battery,
    candidate: Candidate,
    folder: Path,
    *,
    seed: int,
    num_envs: int,
    console: Console,
    read: bool = False,
    referenced: bool = False,
    shell: Sequence[str] | None = None,
) -> Result:
    """All trials of a battery, and its files; goes on where an interrupted call stopped.

    Args:
        battery: the definition.
        candidate: what is put to it.
        folder: of its results.
        seed: of the battery.
        num_envs: worlds that run together, at most.
        console: to print on.
        read: whether results that are there already under the same conditions are read.
        referenced: whether polar plots have reference lines.
        shell: what the shell gave to the recipe besides the run, which the summary keeps.
    """
    battery = battery.of_size(candidate.robot)
    known, (name,) = candidate.known(battery), labels([candidate.name])
    where = surroundings(candidate.env_cfg, battery, candidate.kept)
    plain: dict[str, Any] = {"referenced": referenced, "surroundings": where}
    conditions = candidate.conditions(battery, seed=seed)
    if read and (done := read_trials(folder / "trials.csv", conditions)) is not None:
        console.print(f"{battery.name} of {candidate.name}: read from {folder}/trials.csv")
        return result_of(battery, name, candidate.robot, done, None, known, **plain)
    only = left_out(OmegaConf.select(candidate.env_cfg, "training_only", default={}))
    gone = ", ".join(dict.fromkeys([*only, *starts_and_pushes(candidate.env_cfg)]))
    console.print(
        f"{battery.name} of {candidate.name}; of the env's transforms left out: {gone or 'nothing'}"
    )
    given: dict[str, Any] = {"seed": seed, "num_envs": num_envs, "console": console}
    trials = trials_of(battery, candidate, folder=folder, conditions=conditions, **given)
    background = None
    behind = kind_of(battery).background(battery)
    if behind is not None and candidate.actor is not None:
        still = candidate.still()
        given |= {"label": "pose_hold, to compare with", "conditions": conditions}
        kept = None if kind_of(behind).independent else folder  # a chunk is soon run again
        background = trials_of(behind, still, folder=kept, **given)
    write_trials(folder / "trials.csv", trials, conditions)
    remove_trials(folder / "trials.partial.csv")
    shutil.rmtree(folder / "rounds", ignore_errors=True)
    result = result_of(battery, name, candidate.robot, trials, background, known, **plain)
    write_results(result, folder, console, shell)
    return result


def setting_name(battery: str, given: Mapping[str, Any]) -> str:
    """Name of the folder of results: the battery and what differs from it, ``planar_starts-5``.

    Results of one setting do not overwrite those of another.

    Args:
        battery: its name.
        given: what differs, by key; a list is joined by commas.
    """
    lists = {
        key: [value] if isinstance(value, str) or not isinstance(value, Sequence) else value
        for key, value in given.items()
    }
    texts = {key: ",".join(map(str, values)) for key, values in lists.items()}
    name = "_".join([battery, *(f"{key}-{text}" for key, text in texts.items())])
    if len(name) > 100 or "/" in name:
        digest = hashlib.sha256(name.encode()).hexdigest()[:8]
        name = f"{battery}_{digest}"
    return name
