"""Runs the trials of a battery in parallel worlds."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
import torch
from hydra.utils import instantiate
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import ExplorationType, TransformedEnv, set_exploration_type, step_mdp

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import left_out, make_env
from zfall.envs.tables import declaring, robot_of
from zfall.envs.transforms.actions import JointVelocityTarget
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.envs.transforms.randomization import DomainRandomization
from zfall.envs.transforms.starts import ScriptedStart
from zfall.envs.worlds import in_world
from zfall.evaluation.definitions import Battery
from zfall.evaluation.kinds import kind_of
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, plan_pushes, plan_trials, those_of
from zfall.modules.memory import carry_memory
from zfall.simulation.turns import physics_first

BLOCK = 64  # worlds in one call of a policy, always: a trial re-run alone is the same trial

Policy = Callable[[TensorDictBase], TensorDictBase]


def start_positions(battery: Battery, trials: pd.DataFrame, env: HumanoidEnv) -> Tensor:
    """Joint angles at the start of each trial ``(len(trials), J)`` [rad]."""
    joints = len(env.stand_position)
    noise = [
        np.random.default_rng(np.random.SeedSequence([seed, trial])).standard_normal(joints)
        for seed, trial in trials[["seed", "trial"]].to_numpy(dtype=int).tolist()
    ]
    low, high = env.joint_range.unbind(-1)
    angles = env.stand_position + battery.start_noise * torch.tensor(np.array(noise)).float()
    return torch.clamp(angles, low, high)


def trial_parameters(battery: Battery, trials: pd.DataFrame, env: HumanoidEnv) -> dict[str, Tensor]:
    """Physical parameters ``(len(trials), size)`` that a battery sets, by name; none if nominal."""
    spec, params = env.physics_param_spec, {}
    drawn = np.array(
        [  # not the stream of the start positions, which all batteries share
            np.random.default_rng(np.random.SeedSequence([seed, trial, 1])).random(2)
            for seed, trial in trials[["seed", "trial"]].to_numpy(dtype=int).tolist()
        ]
    )
    if battery.foot_friction is not None:
        params["foot_friction"] = torch.full((len(trials), 1), battery.foot_friction)
    if battery.mass_factor is not None:
        factor = torch.tensor(between(battery.mass_factor, drawn[:, 0])).float()
        params["link_mass"] = factor[:, None].repeat(1, spec["link_mass"].shape[1])
    if battery.load is not None:
        params["payload"] = torch.zeros(len(trials), spec["payload"].shape[1])
        points = list(env.parameters.push_points)
        if "chest" not in points:
            raise ValueError(
                f"battery.load must have a push point chest to lie on, {env.robot.name} has "
                f"{', '.join(points)}: declare it in push_points."
            )
        column = points.index("chest")
        params["payload"][:, column] = torch.tensor(between(battery.load, drawn[:, 1])).float()
    return params


def between(bounds: tuple[float, float], share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values from the lower bound, at 0, to the upper one, at 1."""
    low, high = bounds
    return low + (high - low) * share


def battery_env(
    battery: Battery, cfg: DictConfig, num_envs: int, *, servos: bool = True, pushes: int = 1
) -> tuple[TransformedEnv, ScriptedStart, ScriptedPush]:
    """The env of a run as a battery uses it: its control and observation, our starts and pushes.

    In a battery's ``world`` the hardware is that of the world.

    Args:
        battery: the definition.
        cfg: config of the env, as in ``recipes/env``; its ``training_only`` is left out, and
            whatever starts or pushes.
        num_envs: number of worlds.
        servos: whether the servos act at all.
        pushes: how many a trial has at most.

    Raises:
        ValueError: if it draws what the battery sets of the physics.
    """
    cfg = in_world(cfg, battery.world)
    base = instantiate(cfg.base_env, num_envs=num_envs, powered=servos, _convert_="all")
    start = ScriptedStart(base, states={"joint_position": base.stand_position.repeat(num_envs, 1)})
    points = [*battery.points, *battery.points[:1] * (pushes - len(battery.points))]
    push = ScriptedPush(
        base,
        point=points,  # of each push; a trial's own are given in their buffer
        duration=battery.durations[0],
        time=battery.push_time,
        plan=torch.zeros(num_envs, len(points), 3),
    )
    # First the push: a world's physics may turn it into something else, see BallPush.
    table = {"battery_push": push, **dict(cfg.transforms.items()), "battery_start": start}
    gone = left_out(OmegaConf.select(cfg, "training_only", default={}))
    training_only = {*gone, *starts_and_pushes(cfg)}
    env = make_env(base, table, training_only=training_only, training=False)
    _check_physics(battery, env)
    return env, start, push


def starts_and_pushes(cfg: DictConfig) -> list[str]:
    """Names of the transforms of an env in whose place a battery has its own.

    Their classes declare ``replaced_in_batteries = True``.
    """
    return declaring(cfg, "replaced_in_batteries")


def _check_physics(battery: Battery, env: TransformedEnv) -> None:
    """Refuses randomisation that was left on and would draw anew what the battery sets."""
    params = trial_parameters(battery, pd.DataFrame({"seed": [0], "trial": [0]}), env.base_env)
    for transform in env.transform:
        if isinstance(transform, DomainRandomization) and params.keys() & transform.params.keys():
            raise ValueError(
                f"battery {battery.name} must be the only one to set "
                f"{min(params.keys() & transform.params.keys())}: take the randomisation out of "
                "keep or of battery.world.physics, or name it in training_only."
            )


def arrange(
    battery: Battery,
    trials: pd.DataFrame,
    pushes: Pushes,
    env: HumanoidEnv,
    start: ScriptedStart,
    push: ScriptedPush,
) -> None:
    """Gives every world the start and the pushes of its trial, in its next episode.

    Args:
        battery: the definition.
        trials: one for each world.
        pushes: theirs.
        env: the base env.
        start, push: of ``battery_env``.
    """
    start.states["joint_position"] = start_positions(battery, trials, env)
    events = pushes.time.shape[1]
    for buffer, value in (
        (push.time, pushes.time),
        (push.plan, pushes.force),
        (push.duration, pushes.duration),
        (push.index, pushes.point),
    ):
        buffer[:, :events] = value
    push.time[:, events:] = torch.inf


def begin_streams(env: HumanoidEnv, seed: int, trials: pd.Series) -> None:
    """Gives every world the random numbers of its trial, for noise and delays that are kept on.

    Args:
        env: the base env.
        seed: of the battery.
        trials: number of the trial of each world ``(N,)``.
    """
    own = np.random.SeedSequence([seed, 3]).generate_state(1, np.uint64)  # unlike a training's
    env.streams.begin(int(own[0]), trials.to_numpy(dtype=np.int64))


def run_battery(
    battery: Battery,
    cfg: DictConfig,
    actor: torch.nn.Module | None,
    *,
    seed: int = 0,
    num_envs: int = 512,
    servos: bool = True,
    progress: Callable[[int, int], None] = lambda done, total: None,
    plan: pd.DataFrame | None = None,
    only: Sequence[int] | None = None,
    finished: pd.DataFrame | None = None,
    keep: Callable[[pd.DataFrame], None] = lambda trials: None,
    watch: Callable[[HumanoidEnv, TensorDictBase], None] = lambda env, td: None,
) -> pd.DataFrame:
    """Runs all trials; returns them with their outcomes.

    Trials are independent of each other and of how many run together: a few of them alone come
    out the same, also with noise and delays. A world whose outcome is known is not stepped any
    more.

    Args:
        battery: the definition.
        cfg: config of the env, as in ``recipes/env``.
        actor: the policy, run without exploration; ``None`` holds the reference pose.
        seed: of the battery.
        num_envs: worlds that run together, at most; rounded up to whole blocks.
        servos: whether the servos act at all.
        progress: called with the number of control steps done and their total.
        plan: the trials, if not those of ``plan_trials``; their forces follow from the impulses.
        only: numbers of the trials to run; all if ``None``.
        finished: trials with outcomes that an earlier call had, not to be run again.
        keep: is given what is finished so far after every chunk of trials.
        watch: is given the base env and what followed each control step.
    """
    unit = robot_of(cfg).impulse_unit
    trials = plan_trials(battery, unit, seed) if plan is None else plan.reset_index(drop=True)
    trials["force_n"] = trials["impulse"] * unit / trials["duration_s"]
    pushes = plan_pushes(battery, trials)
    count = len(trials) if only is None else len(only)
    worlds = BLOCK * -(-min(num_envs, count) // BLOCK)
    env, start, push = battery_env(battery, cfg, worlds, servos=servos, pushes=pushes.time.shape[1])
    base = env.base_env
    trials = those_of(trials, only)
    results = []
    if finished is not None and len(finished):
        results.append(finished)
        trials = trials[~trials["trial"].isin(finished["trial"])]
    steps = round(battery.end_time / base.control_dt)
    prepare = getattr(kind_of(battery), "prepare", lambda battery, trials, env: None)
    chunks = [trials.iloc[i : i + worlds] for i in range(0, len(trials), worlds)]
    for index, chunk in enumerate(chunks):
        rows = np.arange(worlds).clip(max=len(chunk) - 1)  # padded with its last trial
        padded = chunk.iloc[rows]
        arrange(battery, padded, pushes[padded.index.to_numpy()], base, start, push)
        begin_streams(base, seed, padded["trial"])
        prepare(battery, padded, env)
        params = trial_parameters(battery, padded, base)
        if params:
            base.set_physics_params(TensorDict(params, batch_size=[worlds]))
        outcomes = Outcomes(base, battery)
        padding = torch.arange(worlds) >= len(chunk)
        base.simulation.step_only(~padding)
        for step, td in enumerate(play(env, actor, steps)):
            outcomes.update(td)
            watch(base, td)
            progress(index * steps + step + 1, len(chunks) * steps)
            known = outcomes.settled | padding
            if known.all():
                break
            base.simulation.step_only(~known)
        table = outcomes.table().iloc[: len(chunk)]
        own = pushes[chunk.index.to_numpy()]
        for name, column in kind_of(battery).columns(own, outcomes).items():
            table[name] = column
        drawn = {"link_mass": "mass_factor", "payload": "load_kg"}
        for name in drawn.keys() & params.keys():
            table[drawn[name]] = params[name].amax(1)[: len(chunk)].double().numpy()
        results.append(pd.concat([chunk.reset_index(drop=True), table], axis=1))
        keep(pd.concat(results, ignore_index=True))
    return pd.concat(results, ignore_index=True).sort_values("trial", ignore_index=True)


def play(
    env: TransformedEnv, actor: torch.nn.Module | None, steps: int
) -> Iterator[TensorDictBase]:
    """Runs the env from a fresh reset, without exploration, and yields what follows each step.

    Without an actor the servos hold the reference pose. The env carries the memory of a recurrent
    one: it gets a primer for it unless it has one.
    """
    act: Any = actor
    if actor is None:
        act = hold_pose(env)
    else:
        carry_memory(env, actor)
    exploring = set_exploration_type(ExplorationType.DETERMINISTIC)
    with torch.no_grad(), physics_first(), exploring:
        td = env.reset()
        for _ in range(steps):
            td = torch.cat([act(block) for block in td.split(BLOCK)])
            td = env.step(td)
            yield td["next"]
            td = step_mdp(td)


def hold_pose(env: TransformedEnv) -> Policy:
    """The baseline: the servos hold the reference pose, to which a velocity action first goes."""
    pose = env.base_env.stand_position
    for transform in env.transform:
        if isinstance(transform, JointVelocityTarget):
            toward = transform.action_toward
            return lambda td: td.set("action", toward(pose, td["target"]))
    action = env.full_action_spec["action"].zero()
    return lambda td: td.set("action", action[: len(td)])
