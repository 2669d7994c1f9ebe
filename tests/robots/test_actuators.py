"""Actuators of a toy as servos: what they give at the joint, by hand; and what is refused."""

import mujoco
import numpy as np
import pytest

from tests.toy import toy_mjcf
from zfall.robots import Robot, bare_model

POSITION = '<position joint="{name}" kp="{kp}" kv="0.5" gear="{gear}" forcerange="-6 6" {more}/>'


def toy(folder, **changes: object) -> Robot:
    return Robot(name="toy", mjcf=str(toy_mjcf(folder, **changes)))


def position(*, kp: float, gear: float, more: str = "") -> str:
    return POSITION.format(name="{name}", kp=kp, gear=gear, more=more)


def test_a_motor_gets_a_controller_with_its_largest_torque(tmp_path):
    model = bare_model(toy(tmp_path))
    actuator = model.actuator("left_knee")
    np.testing.assert_allclose(actuator.forcerange, [-10.0, 10.0])  # gear x control range
    assert actuator.gainprm[0] == pytest.approx(10.0 / 0.35)  # more than the weight needs
    assert actuator.biasprm[2] < 0.0  # damped


def test_a_weak_motor_is_stiff_enough_to_hold_the_legs_up(tmp_path):
    """m g h, as a pendulum upside down, with m h the sum of m z; 1.5 N m / 0.35 rad is less."""
    weak = '<motor joint="{name}" ctrlrange="-1.5 1.5"/>'
    model = bare_model(toy(tmp_path, actuator=weak))
    moment = 1.3 * 0.35 + 0.6 * 0.225 + 0.4 * 0.1 + 0.2 * 0.01  # of all links, both legs [kg m]
    for joint in ("left_hip", "left_knee", "right_ankle"):
        actuator = model.actuator(joint)
        assert actuator.gainprm[0] == pytest.approx(9.81 * moment)
        np.testing.assert_allclose(actuator.forcerange, [-1.5, 1.5])


def test_a_geared_position_actuator_is_the_same_servo_at_the_joint(tmp_path):
    """Torque g kp (g target - g q): stiffness, damping and limit with the gear."""
    model = bare_model(toy(tmp_path, actuator=position(kp=3, gear=4)))
    actuator = model.actuator("right_ankle")
    assert actuator.gainprm[0] == pytest.approx(3 * 4**2)
    assert actuator.biasprm[2] == pytest.approx(-0.5 * 4**2)
    np.testing.assert_allclose(actuator.forcerange, [-24.0, 24.0])


@pytest.mark.parametrize(
    ("gear", "given", "expected"),
    [
        (0.5, "-0.5 0.5", (-1.0, 1.0)),
        (4, "-0.5 0.5", (-0.125, 0.125)),
        (-2, "-0.2 0.6", (-0.3, 0.1)),
        (1, "-0.5 0.5", (-0.5, 0.5)),
    ],
)
@pytest.mark.parametrize("stops", ['range="-1.5 1.5"', ""], ids=["stops", "free"])
def test_targets_of_a_geared_position_actuator_are_angles_of_the_joint(
    tmp_path, gear, given, expected, stops
):
    """Length g q follows the target: q = target / g."""
    servo = position(kp=90 / gear**2, gear=gear, more=f'ctrlrange="{given}"')
    path = toy_mjcf(tmp_path, actuator=servo)
    path.write_text(path.read_text().replace('range="-1.5 1.5"', stops))
    model = bare_model(Robot(name="toy", mjcf=str(path)))
    knee, actuator = model.joint("left_knee"), model.actuator("left_knee")
    assert actuator.ctrllimited
    np.testing.assert_allclose(actuator.ctrlrange, expected)
    np.testing.assert_allclose(knee.range, expected if not stops else (-1.5, 1.5))


def test_stiffness_leaves_the_targets_of_a_geared_actuator_where_they_are(tmp_path):
    servo = position(kp=3, gear=4, more='ctrlrange="-2 2"')
    robot = Robot(name="toy", mjcf=str(toy_mjcf(tmp_path, actuator=servo)), stiffness=80.0)
    actuator = bare_model(robot).actuator("left_hip")
    assert actuator.gainprm[0] == pytest.approx(80.0)
    np.testing.assert_allclose(actuator.ctrlrange, [-0.5, 0.5])


@pytest.mark.parametrize("gear", [0.5, 4, -2])
def test_a_geared_servo_moves_the_joint_as_its_mjcf_does(tmp_path, gear):
    """The target g q* of the plain MJCF is q* of the completed one; also beyond its range."""
    servo = position(kp=60 / gear**2, gear=gear, more=f'ctrlrange="{-abs(gear)} {abs(gear)}"')
    floor = '<worldbody><geom name="floor" type="plane" size="0 0 1"/></worldbody>'
    robot = toy(tmp_path, actuator=servo, more=floor)
    whole, plain = bare_model(robot), mujoco.MjModel.from_xml_path(robot.mjcf)
    plain.opt.integrator = whole.opt.integrator
    angles = {}
    for model, factor in ((whole, 1.0), (plain, gear)):
        data = mujoco.MjData(model)
        data.qpos[2] = 1.0  # in the air
        data.ctrl[:] = factor * np.array([0.2, 0.3, -0.1, -0.2, 0.1, 1.4])
        mujoco.mj_step(model, data, 100)
        angles[factor] = data.qpos[7:]
    np.testing.assert_allclose(angles[1.0], angles[gear], atol=1e-9)


@pytest.mark.parametrize(
    ("actuator", "says"),
    [
        ('<position joint="{name}" kp="60" forcerange="-2 8"/>', "left_hip .* -2 to 8 N m"),
        ('<position joint="{name}" kp="60" gear="-3" forcerange="-2 8"/>', "-24 to 6 N m"),
        ('<motor joint="{name}" gear="2" ctrlrange="0 5"/>', "0 to 10 N m"),
    ],
)
def test_an_actuator_that_is_stronger_one_way_is_refused(tmp_path, actuator, says):
    with pytest.raises(ValueError, match=says) as refused:
        toy(tmp_path, actuator=actuator)
    assert "\n" not in str(refused.value)
    assert "toy.xml" in str(refused.value)
    assert "symmetric forcerange" in str(refused.value)


def test_a_symmetric_limit_within_a_lopsided_one_counts(tmp_path):
    """The least of both ranges acts: 6 of 6 and of -7 to 8 N m."""
    path = toy_mjcf(tmp_path, actuator=position(kp=60, gear=1))
    text = path.read_text().replace(
        'name="left_hip" axis', 'name="left_hip" actuatorfrcrange="-7 8" axis'
    )
    path.write_text(text)
    actuator = bare_model(Robot(name="toy", mjcf=str(path))).actuator("left_hip")
    np.testing.assert_allclose(actuator.forcerange, [-6.0, 6.0])


def test_a_dc_motor_loses_torque_with_speed_and_gives_what_its_voltage_can(tmp_path):
    """At rest gear K V / R; each rad/s costs (gear K)^2 / R."""
    motor = (
        '<dcmotor name="{name}" joint="{name}" motorconst="0.05" resistance="2" gear="20" '
        'ctrlrange="-12 12" ctrllimited="true"/>'
    )
    model = bare_model(toy(tmp_path, actuator=motor))
    np.testing.assert_allclose(
        model.actuator("left_hip").forcerange, 20 * 0.05 * 12 / 2 * np.array([-1, 1])
    )
    assert model.joint("left_hip").damping[0] == pytest.approx(0.05 + (20 * 0.05) ** 2 / 2)


def test_declared_stiffness_is_used(tmp_path):
    path = str(toy_mjcf(tmp_path))
    model = bare_model(Robot(name="toy", mjcf=path, stiffness={"left_hip": 77.0}))
    assert model.actuator("left_hip").gainprm[0] == pytest.approx(77.0)
    assert model.actuator("right_hip").gainprm[0] != pytest.approx(77.0)


def test_a_joint_without_stops_has_a_range_for_its_targets(tmp_path):
    text = toy_mjcf(tmp_path).read_text().replace('range="-1 1"', "")
    (tmp_path / "toy.xml").write_text(text)
    model = bare_model(Robot(name="toy", mjcf=str(tmp_path)))
    np.testing.assert_allclose(model.joint("left_ankle").range, [-np.pi, np.pi])
    assert not model.jnt_limited[model.joint("left_ankle").id]
