"""Servos in the physics: a joint alone on a bench, and the robot with them."""

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from zfall.robots import ZEROTH01
from zfall.robots.servos import SERVOS, STS3215, STS3250, servo
from zfall.simulation.model import compile_model
from zfall.simulation.servos import put_servo

EVERY = pytest.mark.parametrize("one", SERVOS.values(), ids=SERVOS)
SERVO_OF = {
    joint: STS3215 if "elbow" in joint or "gripper" in joint else STS3250
    for joint in ZEROTH01.joints
}


class Bench:
    """A motor's shaft with a small wheel, no gravity, a constant torque against it."""

    def __init__(self, one, voltage=None, dt=0.004):
        spec = mujoco.MjSpec()
        spec.option.timestep, spec.option.gravity = dt, [0, 0, 0]
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        wheel = spec.worldbody.add_body(name="wheel")
        wheel.add_joint(name="shaft", type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
        inertia = 0.1 * one.armature
        wheel.explicitinertial, wheel.mass, wheel.inertia = True, 0.1, [inertia] * 3
        shaft = spec.add_actuator(name="shaft", trntype=mujoco.mjtTrn.mjTRN_JOINT, target="shaft")
        shaft.set_to_motor()
        put_servo(spec, "shaft", one)
        self.model = spec.compile()
        share = (voltage or one.voltage) / one.voltage  # as PhysicsParameters does it
        self.model.actuator_gainprm[0, 0] *= share
        self.model.actuator_biasprm[0, 1] *= share
        self.model.actuator_forcerange[0] *= share
        self.data = mujoco.MjData(self.model)

    def run(self, target: float, load: float, seconds: float) -> tuple[float, float]:
        """Angle and speed after some time."""
        self.data.ctrl[0], self.data.qfrc_applied[0] = target, -load
        for _ in range(round(seconds / self.model.opt.timestep)):
            mujoco.mj_step(self.model, self.data)
        return float(self.data.qpos[0]), float(self.data.qvel[0])


@EVERY
@pytest.mark.parametrize("volts", [1.0, 11.1 / 12])
@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.75])
def test_speed_under_load_lies_on_the_sheet_s_line(one, volts, share):
    """Without load the no-load speed, with a part of the stall torque that much less."""
    voltage = volts * one.voltage
    load = share * one.stall_torque
    _, speed = Bench(one, voltage).run(1e3, load, 3.0)
    motor = (one.stall_torque + one.friction) * volts
    expected = (motor - one.friction - load) / one.damping  # by hand from the sheet
    if volts == 1.0:
        assert expected == pytest.approx((1 - share) * one.no_load_speed)
    assert speed == pytest.approx(expected, abs=0.01 * one.no_load_speed)


@EVERY
@pytest.mark.parametrize("volts", [1.0, 11.1 / 12])
def test_motor_lifts_just_less_than_its_stall_torque(one, volts):
    """At rest under 99 % of it the shaft goes up, under 101 % it does not."""
    stall = (one.stall_torque + one.friction) * volts - one.friction
    lifted, _ = Bench(one, volts * one.voltage).run(1e3, 0.99 * stall, 1.0)
    stayed, _ = Bench(one, volts * one.voltage).run(1e3, 1.01 * stall, 1.0)
    assert lifted > 0.3 * 0.01 * stall / one.damping
    assert stayed < 0.1 * lifted  # dry friction creeps a little


@EVERY
@pytest.mark.parametrize("volts", [1.0, 11.1 / 12])
def test_position_sags_by_the_load_over_the_stiffness(one, volts):
    """Without dry friction; with it the shaft may stop anywhere within friction / stiffness."""
    voltage, load = volts * one.voltage, 0.2 * one.stall_torque
    smooth = servo(one.name, friction=0.0)
    angle, speed = Bench(smooth, voltage).run(0.5, load, 5.0)
    assert abs(speed) < 1e-6
    assert 0.5 - angle == pytest.approx(load / one.stiffness(voltage), rel=1e-3)
    angle, _ = Bench(one, voltage).run(0.5, load, 5.0)
    play = one.friction / one.stiffness(voltage)
    assert abs(0.5 - angle - load / one.stiffness(voltage)) <= play


def test_a_fast_shaft_brakes_with_more_than_the_stall_torque():
    """Full duty against the motion: the back-EMF adds to it, beyond the clip."""
    bench = Bench(STS3250, dt=1e-4)
    bench.data.qvel[0] = 5.0
    _, speed = bench.run(-1e3, 0.0, 1e-4)
    torque = STS3250.motor_torque() + 5.0 * STS3250.damping + STS3250.friction
    assert (5.0 - speed) / 1e-4 == pytest.approx(torque / (1.1 * STS3250.armature), rel=0.01)


def test_every_joint_of_the_robot_gets_its_servo():
    model = compile_model(ZEROTH01, physics_dt=0.004, servos=SERVO_OF)
    for name, one in SERVO_OF.items():
        actuator, joint = model.actuator(name), model.joint(name)
        assert actuator.gainprm[0] == pytest.approx(32 * one.duty_per_radian * one.stall_torque)
        assert actuator.biasprm[:3].tolist() == [0, -actuator.gainprm[0], 0]
        limit = one.stall_torque + one.friction
        np.testing.assert_allclose(actuator.forcerange, [-limit, limit])
        assert joint.damping[0] == pytest.approx(one.stall_torque / one.no_load_speed)
        assert joint.frictionloss[0] == pytest.approx(one.friction)
        assert joint.armature[0] == pytest.approx(one.armature)


def test_servos_change_the_joints_and_nothing_else():
    plain = compile_model(ZEROTH01, physics_dt=0.004)
    ours = compile_model(ZEROTH01, physics_dt=0.004, servos=SERVO_OF)
    own = {"dof_damping", "dof_frictionloss", "dof_armature", "actuator_gainprm"}
    own |= {"actuator_biasprm", "actuator_forcerange"}
    derived = {"dof_M0", "dof_invweight0", "body_invweight0", "actuator_acc0", "stat"}
    for field in dir(plain):
        value = getattr(plain, field)
        if isinstance(value, np.ndarray) and field not in own | derived:
            np.testing.assert_array_equal(value, getattr(ours, field), err_msg=field)


def test_a_battery_s_voltage_scales_the_motor_s_torque_alone(make_base):
    """The fields of a world at 11.1 V are those of the servo at that voltage."""
    base = make_base(num_envs=2, servos=SERVO_OF)
    share = torch.tensor([[1.0], [11.1 / 12]])
    base.set_physics_params(TensorDict({"battery_voltage": share}, [2]))
    model = base.simulation.model_of(1)
    for name, one in SERVO_OF.items():
        motor = one.motor_torque(11.1)
        assert model.actuator(name).forcerange[1] == pytest.approx(motor, rel=1e-6)
        assert model.actuator(name).gainprm[0] == pytest.approx(one.stiffness(11.1), rel=1e-6)
        assert model.joint(name).damping[0] == pytest.approx(one.damping)


def test_a_battery_above_the_sheet_s_voltage_is_refused(make_base):
    base = make_base(num_envs=1, servos=SERVO_OF)
    with pytest.raises(ValueError, match=r"battery_voltage must be .*\[0.5, 1.05\], got 1.1"):
        base.set_physics_params(TensorDict({"battery_voltage": torch.tensor([[1.1]])}, [1]))


def test_robot_with_servos_of_the_sheets_stands(make_base):
    base = make_base(num_envs=1, servos=SERVO_OF)
    td = base.reset()
    for _ in range(75):
        td["target"] = base.stand_position[None]
        td = base.step(td)["next"]
    assert td["base_position"][0, 2] == pytest.approx(0.331, abs=2e-3)
    assert td["joint_velocity"].abs().max() < 1e-2


@pytest.mark.parametrize(("change", "message"), [
    ({"left_knee_pitch": None}, "each joint of zeroth01, lacks left_knee_pitch"),
    ({"tail": STS3250}, "each joint of zeroth01, also has tail"),
    ({"left_knee_pitch": 4.9}, "servos.left_knee_pitch must be a Servo, got 4.9"),
    ({"left_knee_pitch": servo("STS3250", friction=None)}, "servos.left_knee_pitch: friction of"),
    ({"left_knee_pitch": servo("STS3250", armature=None)}, "servos.left_knee_pitch: armature of"),
])  # fmt: skip
def test_servos_that_do_not_fit_the_robot_are_refused_by_joint(change, message):
    with pytest.raises(ValueError, match=message):
        compile_model(ZEROTH01, physics_dt=0.004, servos=SERVO_OF | change)
    with pytest.raises(ValueError, match="servos must be a table of joints"):
        compile_model(ZEROTH01, physics_dt=0.004, servos=4.9)
