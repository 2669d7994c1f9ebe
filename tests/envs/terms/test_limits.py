"""Each bound: a motion that breaks it at the step foretold, and one just inside that does not."""

import math
from collections.abc import Callable, Iterator
from functools import partial

import pytest
import torch
from scipy.spatial.transform import Rotation
from tensordict import TensorDict

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.terms.limits import (
    base_low,
    base_tilted,
    drifted,
    feet_close,
    overpowered,
    reference_left,
    stop_hit,
)
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.starts import ScriptedStart
from zfall.envs.transforms.windows import (
    JointErrorMin,
    JointPower,
    JointStopSpeed,
    OdometryDisplacement,
)
from zfall.robots import ZEROTH01

DT = 0.04
NONE = TensorDict(batch_size=[1])
TILT = partial(base_tilted, roll=[-0.4, 0.4], pitch=[-0.25, 0.7])
DRIFT = partial(drifted, x=0.46, y=0.69, heading=math.pi / 2)


def first(condition: Callable, frames: Iterator[TensorDict]) -> int | None:
    """Step at which a condition first holds, 0 being the start; ``None`` if it never does."""
    for step, td in enumerate(frames):
        if condition(NONE, td).item():
            return step
    return None


def of(**values: object) -> TensorDict:
    return TensorDict({k: torch.tensor([v]).float() for k, v in values.items()}, [1])


def turned(yaw: float, pitch: float = 0.0, roll: float = 0.0) -> list[float]:
    return Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat()[[3, 0, 1, 2]].tolist()


def test_height():
    """1.01 cm a step from 0.332 m: 0.1098 m after 22 steps, 0.0997 m after 23."""
    sink = [of(base_position=[0.0, 0.0, 0.332 - 0.0101 * k]) for k in range(40)]
    assert first(partial(base_low, height=0.109), sink) == 23
    assert first(partial(base_low, height=0.109), sink[:23]) is None


@pytest.mark.parametrize(("axis", "sign", "bound"), [
    ("roll", 1, 0.4), ("roll", -1, 0.4), ("pitch", 1, 0.7), ("pitch", -1, 0.25),
])  # fmt: skip
def test_tilt(axis, sign, bound):
    """0.021 rad a step, whatever the heading."""
    lean = [of(base_orientation=turned(2.0, **{axis: sign * 0.021 * k})) for k in range(60)]
    foretold = math.ceil(bound / 0.021)
    assert first(TILT, lean) == foretold
    assert first(TILT, lean[:foretold]) is None


def test_turning_on_the_spot_is_no_tilt():
    assert first(TILT, [of(base_orientation=turned(0.1 * k)) for k in range(70)]) is None


def test_feet_that_come_together():
    """Soles 0.074 m wide, 0.136 m apart, coming closer by 1 mm a step: 5 mm are left at 57."""

    def step(k: int) -> TensorDict:
        level = [1.0, 0.0, 0.0, 0.0]
        apart = 0.1361 - 0.001 * k
        return of(feet_position=[[0.0, apart, 0.0], [0.0, 0.0, 0.1]], feet_orientation=[level] * 2)

    close = partial(feet_close, robot=ZEROTH01, distance=0.005)
    assert first(close, map(step, range(80))) == 58
    assert first(close, map(step, range(58))) is None


@pytest.mark.parametrize(("speed", "hit"), [(1.35, True), (1.25, False)])
def test_stops(speed, hit):
    """An elbow 2 mrad before its stop loses 0.07 rad/s until it is there."""
    base = HumanoidEnv(num_envs=1, control_dt=DT, physics_dt=0.0005, powered=False)
    base.simulation.model.opt.gravity[:] = 0
    angle, rate = base.stand_position.clone(), torch.zeros(20)
    angle[14], rate[14] = base.joint_range[14, 1] - 0.002, speed
    states = {
        "joint_position": angle[None],
        "joint_velocity": rate[None],
        "base_position": torch.tensor([[0.0, 0.0, 5.0]]),
    }
    env = make_env(base, {
        "start": ScriptedStart(base, states=states),
        "action": JointPositionTarget(base, scale=1.0),
        "stop": JointStopSpeed(base),
    })  # fmt: skip

    def frames() -> Iterator[TensorDict]:
        td = env.reset()
        yield td
        for _ in range(5):
            td["action"] = torch.zeros(1, 20)
            td = env.step(td)["next"]
            yield td

    assert first(partial(stop_hit, speed=1.25), frames()) == (1 if hit else None)


def walk(v: tuple[float, float, float], seconds: float) -> Iterator[TensorDict]:
    """Odometry at constant velocity, through the window of 20 s."""
    window = OdometryDisplacement(HumanoidEnv(num_envs=1, control_dt=DT), seconds=20.0)
    for k in range(round(seconds / DT)):
        x, y, heading = (DT * k * value for value in v)
        td = of(base_position=[x, y, 0.3], base_orientation=turned(heading))
        yield window._reset(NONE, td) if k == 0 else window._call(td)


@pytest.mark.parametrize(("v", "step"), [
    ((0.024, 0.0, 0.0), math.ceil(0.46 / 0.024 / DT)),  # 0.48 m in 20 s
    ((-0.024, 0.0, 0.0), math.ceil(0.46 / 0.024 / DT)),
    ((0.0225, 0.0, 0.0), None),  # 0.45 m in 20 s, 1.3 m in all
    ((0.0, 0.035, 0.0), math.ceil(0.69 / 0.035 / DT)),
    ((0.0, -0.034, 0.0), None),
    ((0.0, 0.0, 0.08), math.ceil(math.pi / 2 / 0.08 / DT)),
    ((0.0, 0.0, -0.078), None),  # 1.56 rad in 20 s; it turns right round in 58 s
])  # fmt: skip
def test_drift(v, step):
    assert first(DRIFT, walk(v, seconds=58.0)) == step


@pytest.mark.parametrize(("inside", "step"), [
    ([], 100), ([0], 101), ([50], 151), ([50, 150], 251), ([50, 151, 252, 353], None),
])  # fmt: skip
def test_transient(inside, step):
    """0.31 rad off but for some steps with 0.29: the bound breaks 4 s after the last of them.

    Steps 50 and 151 have a window of 4 s, with both its ends 101 steps, between them.
    """
    base = HumanoidEnv(num_envs=1, control_dt=DT)
    window = JointErrorMin(base, seconds=4.0)

    def frames() -> Iterator[TensorDict]:
        for k in range(400):
            position = base.stand_position.clone()
            position[3] += 0.29 if k in inside else 0.31  # a knee
            position[12] += 1.0  # an arm does not count
            td = TensorDict({"joint_position": position[None]}, [1])
            yield window._reset(NONE, td) if k == 0 else window._call(td)

    assert first(partial(reference_left, error=0.3), frames()) == step


@pytest.mark.parametrize(("torque", "step"), [(8.35, 5), (8.30, None)])
def test_power(torque, step):
    """Two knees that speed up by 0.6 rad/s a step to 3: 2 ((8.35 - 1.3464 3) 3 - 0.2 3) = 24.66 W.

    With 8.30 N m it is 24.36 W; at 2.4 rad/s, a step before, 23.61 W.
    """
    base = HumanoidEnv(num_envs=1, control_dt=DT)
    window = JointPower(base)
    torques, velocity = torch.zeros(1, 10, 20), torch.zeros(1, 10, 20)
    torques[..., [3, 9]] = torque

    def frames() -> Iterator[TensorDict]:
        before = TensorDict(
            {"joint_velocity": velocity[:, -1], "joint_torque": torques[:, -1]}, [1]
        )
        before = window._reset(NONE, before)
        yield before
        for k in range(1, 8):
            speed = velocity.clone()
            speed[..., [3, 9]] = min(0.6 * k, 3.0)
            before["joint_velocity"] = speed[:, 0]
            td = TensorDict({"substeps": {"joint_torque": torques, "joint_velocity": speed}}, [1])
            yield window._step(before, td)

    assert first(partial(overpowered, power=24.5), frames()) == step
