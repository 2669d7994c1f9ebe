"""One physics, three faces: TorchRL, dm_control and gymnasium go through the same states."""

import gymnasium
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from zfall.envs.dm_task import load
from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.tasks import build_task
from zfall.envs.transforms.pushes import ScriptedPush
from zfall.envs.transforms.starts import ScriptedStart

ID = "zfall/PushRecovery-v0"
WORLDS, STEPS, JOINTS = 2, 125, 20
SCRIPTED = ("start", "push", "noise", "terminations", "limit")  # goes, or is replaced
rng = np.random.default_rng(0)
ACTIONS = 0.3 * rng.standard_normal((STEPS, WORLDS, JOINTS))
START = torch.from_numpy(0.05 * rng.standard_normal((WORLDS, JOINTS))).float()
SPEED = torch.from_numpy(0.2 * rng.standard_normal((WORLDS, JOINTS))).float()
FORCE = torch.tensor([[25.0, 0.0, 0.0], [0.0, -20.0, 0.0]])  # [N]


@pytest.fixture(scope="module")
def table(compose_config):
    """Builds the task with start, push and delay given, for some of the worlds."""

    def build(rows: slice) -> dict:
        cfg = compose_config("num_envs=1", "env.transforms.delay.delay=[0.008,0.008]").env
        transforms = {k: v for k, v in cfg.transforms.items() if k not in SCRIPTED}
        stand = torch.tensor(HumanoidEnv(num_envs=1, control_dt=0.04).robot.stand_position)
        states = {"joint_position": stand + START[rows], "joint_velocity": SPEED[rows]}
        target = "zfall.envs.transforms"
        force = FORCE[rows]
        transforms |= {
            "start": {"_target_": f"{target}.starts.{ScriptedStart.__name__}", "states": states},
            "push": {
                "_target_": f"{target}.pushes.{ScriptedPush.__name__}",
                "point": "torso",
                "duration": 0.1,
                "time": torch.full((len(force),), 0.99),
                "plan": force,
            },
        }
        return {"base_env": cfg.base_env, "transforms": transforms}

    return build


def state_of(env) -> np.ndarray:
    simulation = env.base_env.simulation
    return torch.cat([simulation.qpos, simulation.qvel], -1).numpy().copy()


@pytest.fixture(scope="module")
def torchrl_run(table):
    """States ``(STEPS, WORLDS, nq + nv)``, observations and rewards of the TorchRL env."""
    env = build_task(table(slice(None)), num_envs=WORLDS)
    td, runs = env.reset(), []
    for action in ACTIONS:
        td["action"] = torch.from_numpy(action).float()
        data, td = env.step_and_maybe_reset(td)
        after = data["next"]
        runs.append((state_of(env), after["observation"].numpy(), after["reward"][:, 0].numpy()))
    return [np.stack(values) for values in zip(*runs, strict=True)]


def test_the_push_and_the_fall_are_in_the_script(torchrl_run):
    """Else the agreement below would be of robots that stand still."""
    height = torchrl_run[0][:, :, 2]
    assert (height[:20] > 0.25).all()
    assert (height.min(0) < 0.15).any()


def test_dm_control_goes_through_the_states_of_torchrl(table, torchrl_run):
    for world in range(WORLDS):
        env = load(table(slice(world, world + 1)))
        env.reset()
        for step in range(STEPS):
            time_step = env.step(ACTIONS[step, world])
            state = np.concatenate([env.physics.position(), env.physics.velocity()])
            expected = (values[step, world] for values in torchrl_run)
            np.testing.assert_allclose(state, next(expected), rtol=0, atol=1e-9)
            np.testing.assert_allclose(
                time_step.observation["observation"], next(expected), atol=1e-6
            )
            assert time_step.reward == pytest.approx(next(expected), abs=1e-6)
        assert env.physics.time() == pytest.approx(5.0)


def test_gymnasium_goes_through_the_states_of_torchrl(table, torchrl_run):
    for world in range(WORLDS):
        env = gymnasium.make(ID, task=table(slice(world, world + 1)))
        env.reset()
        for step in range(STEPS):
            observation, reward, *_ = env.step(ACTIONS[step, world])
            expected = (values[step, world] for values in torchrl_run)
            state = state_of(env.unwrapped.torchrl_env)[0]
            np.testing.assert_allclose(state, next(expected), rtol=0, atol=1e-9)
            np.testing.assert_allclose(observation, next(expected), atol=1e-6)
            assert reward == pytest.approx(next(expected), abs=1e-6)


def test_gymnasium_in_many_worlds_goes_through_the_states_of_torchrl(table, torchrl_run):
    env = gymnasium.make_vec(ID, num_envs=WORLDS, task=table(slice(None)))
    env.reset()
    for step in range(STEPS):
        observation, reward, *_ = env.step(ACTIONS[step])
        states, observations, rewards = torchrl_run
        state = state_of(env.unwrapped.torchrl_env)
        np.testing.assert_allclose(state, states[step], rtol=0, atol=1e-9)
        np.testing.assert_allclose(observation, observations[step], atol=1e-6)
        np.testing.assert_allclose(reward, rewards[step], atol=1e-6)


def test_dm_control_takes_the_same_physical_parameters(table):
    """A slope and weak servos: the robot slides and sags, in both faces alike."""
    fast = build_task(table(slice(0, 1)), num_envs=1)
    face = load(table(slice(0, 1)))
    fast.reset()
    face.reset()
    slow = face.task.torchrl_env
    for env in (fast, slow):
        params = {"slope": torch.tensor([[0.3, 0.0]]), "servo_stiffness": torch.full((1, 20), 0.3)}
        params["link_mass"] = torch.full_like(
            env.base_env.physics_param_spec.zero()["link_mass"], 1.3
        )
        env.base_env.set_physics_params(TensorDict(params))
    td = fast.reset()
    face.reset()
    for step in range(25):
        td["action"] = torch.from_numpy(ACTIONS[step, :1]).float()
        td = fast.step_and_maybe_reset(td)[1]
        face.step(ACTIONS[step, 0])
    ends = [state_of(env)[0] for env in (fast, slow)]
    np.testing.assert_allclose(ends[0], ends[1], rtol=0, atol=1e-9)
    assert ends[0][0] > 0.05  # down the slope, along x
