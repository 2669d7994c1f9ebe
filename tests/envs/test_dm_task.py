"""The dm_control face: its contract, its physics by name, and what ends an episode."""

import pickle

import numpy as np
import pytest
from absl.testing import absltest
from dm_control.rl import control
from dm_env import StepType, test_utils
from numpy.testing import assert_allclose
from torchrl.envs import DMControlWrapper
from torchrl.envs.utils import check_env_specs

from zfall.envs.dm_task import load

GRAVITY = 9.81
CALM = {"training": False, "overrides": ["env.transforms.limit.seconds=20"]}


class TestContract(test_utils.EnvironmentTestMixin, absltest.TestCase):
    """The checks of dm_env, with actions that make the robot fall."""

    def make_object_under_test(self):
        return load("push_recovery", random=0)

    def make_action_sequence(self):
        generator = np.random.default_rng(0)
        for _ in range(40):
            yield generator.uniform(-3.0, 3.0, 20).astype(np.float32)


def hold(env, seconds: float):
    """Holds the reference pose for a time; returns the last time step."""
    for _ in range(round(seconds / env.control_timestep())):
        time_step = env.step(np.zeros(20))
    return time_step


def lift(env, height: float) -> None:
    """Puts the robot high up, at rest, as a user of dm_control would."""
    with env.physics.reset_context():
        env.physics.data.qpos[:] = env.physics.model.key_qpos[0]
        env.physics.data.qpos[2] = height


@pytest.fixture
def calm():
    env = load(**CALM)
    env.reset()
    return env


@pytest.mark.parametrize("speed", [1e7, 1e30])
def test_physics_that_fails_ends_the_episode_for_good(calm, speed):
    """A base that flies off faster than any physics, or so fast that MuJoCo gives up on it."""
    calm.physics.data.qvel[2] = speed
    time_step = calm.step(np.zeros(20))
    assert time_step.step_type == StepType.LAST
    assert time_step.discount == 0.0
    assert np.isfinite(time_step.reward)
    assert all(np.isfinite(value).all() for value in time_step.observation.values())
    assert calm.task._simulation.diverged.tolist() == [False]  # it was put back on its feet
    assert abs(calm.physics.data.qvel).max() < 1.0


def test_torchrl_wraps_it_and_its_seed_holds():
    env = DMControlWrapper(load(random=0))
    check_env_specs(env)
    starts = []
    for seed in (7, 7, 8):
        env.set_seed(seed)
        starts.append(env.reset()["observation"])
    assert (starts[0] == starts[1]).all()
    assert (starts[0] != starts[2]).any()


def test_episodes_of_one_seed_differ_and_come_again():
    runs = []
    for _ in range(2):
        env = load(random=3)
        runs.append([env.reset().observation["observation"] for _ in range(2)])
    assert_allclose(runs[0], runs[1])
    assert np.abs(runs[0][0] - runs[0][1]).max() > 1e-3


def test_center_of_mass_by_name_is_that_of_the_links(calm):
    hold(calm, 0.4)
    physics = calm.physics
    mass = physics.model.body_mass
    assert_allclose(physics.com_position(), mass @ physics.data.xipos / mass.sum(), atol=1e-9)
    before, dt = physics.com_position(), physics.timestep()
    velocity = physics.com_velocity()
    physics.step()
    assert_allclose((physics.com_position() - before) / dt, velocity, atol=0.01)


def test_quantities_by_name_are_those_of_the_state(calm):
    physics = calm.physics
    lift(calm, 1.0)
    half = 0.5**0.5
    physics.data.qpos[3:7] = [half, half, 0.0, 0.0]  # rolled to its right
    physics.named.data.qpos["left_knee_pitch"] = -0.5
    physics.named.data.qvel["left_knee_pitch"] = 0.7
    physics.forward()
    index = physics.robot.joints.index("left_knee_pitch")
    assert physics.joint_position()[index] == -0.5
    assert physics.joint_velocity()[index] == 0.7
    assert physics.base_position()[2] == 1.0
    assert_allclose(physics.projected_gravity(), [0.0, -1.0, 0.0], atol=1e-12)
    left, right = physics.feet_position()
    assert left[2] > right[2] + 0.1


def test_feet_touch_the_floor_where_the_robot_stands_and_not_in_the_air(calm):
    hold(calm, 0.4)
    assert calm.physics.feet_contact().all()
    lift(calm, 1.0)
    calm.step(np.zeros(20))
    assert not calm.physics.feet_contact().any()


def test_a_state_set_by_hand_is_where_the_step_begins(calm):
    """Free fall from rest for one control step, in physics steps of dt: g t (t + dt) / 2."""
    lift(calm, 2.0)
    physics = calm.physics
    before = physics.com_position()
    calm.step(np.zeros(20))
    t, dt = calm.control_timestep(), physics.timestep()
    fallen = before[2] - physics.com_position()[2]
    assert fallen == pytest.approx(GRAVITY * t * (t + dt) / 2, rel=1e-3)


def test_a_state_set_again_gives_the_same_states_again(calm):
    hold(calm, 0.2)
    saved, ends = calm.physics.get_state(), []
    for _ in range(2):
        calm.physics.set_state(saved)
        hold(calm, 0.4)
        ends.append(calm.physics.get_state())
    assert_allclose(ends[0], ends[1], rtol=0, atol=1e-12)
    assert np.abs(ends[0] - saved).max() > 1e-6


def test_a_force_applied_by_hand_acts_through_the_step_and_stays(calm):
    """Momentum is force x time."""
    physics = calm.physics
    lift(calm, 3.0)
    physics.named.data.xfrc_applied[1, 0] = 4.0
    hold(calm, 0.2)
    gained = physics.model.body_mass.sum() * physics.com_velocity()[0]
    assert gained == pytest.approx(4.0 * 0.2, rel=1e-2)
    assert physics.data.xfrc_applied[1, 0] == 4.0


def test_a_fall_ends_with_discount_0():
    env = load(training=False)
    env.reset()
    with env.physics.reset_context():
        env.physics.data.qpos[:3] = [0.0, 0.0, 0.5]
        env.physics.data.qpos[3:7] = [0.5**0.5, 0.0, 0.5**0.5, 0.0]  # flat in the air
    time_step = env.step(np.zeros(20))
    assert time_step.last()
    assert time_step.discount == 0.0
    assert env.step(np.zeros(20)).first()


def test_the_time_limit_of_the_table_ends_with_discount_1():
    env = load(training=False, overrides=["env.transforms.limit.seconds=0.2"])
    env.reset()
    kinds = [env.step(np.zeros(20)) for _ in range(5)]
    assert [k.step_type for k in kinds] == [StepType.MID] * 4 + [StepType.LAST]
    assert kinds[-1].discount == 1.0


def test_the_time_limit_of_dm_control_ends_with_discount_1():
    env = load(training=False, time_limit=0.2)
    env.reset()
    assert hold(env, 0.16).mid()
    last = hold(env, 0.04)
    assert last.last()
    assert last.discount == 1.0


@pytest.mark.parametrize("speed", [np.nan, 1e30])
def test_physics_that_fail_end_the_episode_with_numbers(calm, speed):
    calm.physics.data.qvel[7] = speed
    last = calm.step(np.zeros(20))
    assert last.last()
    assert last.discount == 0.0
    assert np.isfinite(last.observation["observation"]).all()
    assert np.isfinite(last.reward)
    assert calm.reset().first()
    assert hold(calm, 0.2).mid()


def test_without_a_task_the_physics_steps_as_any_other(calm):
    physics = calm.physics
    lift(calm, 2.0)
    physics.step(5)
    assert physics.time() == pytest.approx(5 * physics.timestep())
    physics.data.qpos[0] = np.nan
    with pytest.raises(control.PhysicsError):
        physics.step()


def test_copies_and_pickles_keep_state_and_names(calm):
    hold(calm, 0.2)
    expected = calm.physics.com_position(), calm.physics.joint_position()
    for other in (calm.physics.copy(), pickle.loads(pickle.dumps(calm.physics))):
        assert_allclose(other.com_position(), expected[0])
        assert_allclose(other.joint_position(), expected[1])


def test_the_loop_of_the_viewer_runs():
    runtime = pytest.importorskip("dm_control.viewer.runtime")
    env = load(random=0)
    loop = runtime.Runtime(env, lambda time_step: np.full(20, 0.1))
    for paused in (False, False, True, False):
        loop.tick(0.1, paused)
    assert loop.state == runtime.State.RUNNING
    assert loop.get_time() == pytest.approx(0.24)  # whole control steps, at most three a tick
    loop.restart()
    loop.tick(0.0, False)
    assert loop.get_time() == 0.0


def test_a_picture_shows_the_robot(calm):
    try:
        picture = calm.physics.render(height=64, width=64, camera_id="track")
    except (ImportError, RuntimeError, AttributeError, OSError):
        pytest.skip("no OpenGL on this machine")
    assert picture.std() > 10


def test_unknown_task_is_refused_and_names_those_there_are():
    with pytest.raises(ValueError, match=r"task must be one of .*push_recovery.*, got 'nope'"):
        load("nope")


def test_an_action_that_is_not_finite_ends_the_episode_with_discount_0():
    env = load("push_recovery", random=0)
    env.reset()
    action = np.zeros(20)
    action[3] = np.nan
    step = env.step(action)
    assert step.last()
    assert step.discount == 0.0
    assert np.isfinite(step.observation["observation"]).all()


def test_an_action_of_another_shape_is_refused():
    env = load("push_recovery", random=0)
    for shape in ((1,), (2, 10), (19,)):
        env.reset()
        with pytest.raises(ValueError, match=r"action must have the shape \(1, 20\)"):
            env.step(np.zeros(shape))
