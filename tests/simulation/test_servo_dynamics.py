"""What MuJoCo has not of a servo: a joint alone on a bench, and the robot with it."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from zfall.robots import ZEROTH01
from zfall.robots.servos import SERVOS, STS3215, STS3250, XL330_M288
from zfall.simulation.cpu import Simulation
from zfall.simulation.servo_dynamics import AMBIENT, ServoDynamics
from zfall.simulation.servos import put_servo

EVERY = pytest.mark.parametrize("one", SERVOS.values(), ids=SERVOS)
SERVO_OF = {
    joint: STS3215 if "elbow" in joint or "gripper" in joint else STS3250
    for joint in ZEROTH01.joints
}
FACTORS = ("load_friction", "joint_friction_loss", "joint_damping", "joint_armature")
FACTORS += ("servo_stiffness", "servo_torque_limit")


class Bench:
    """Shafts with a small wheel each, no gravity, in steps of 40 ms."""

    def __init__(self, *servos, worlds=1, dt=0.004, stop=None, **values):
        spec = mujoco.MjSpec()
        spec.option.timestep, spec.option.gravity = dt, [0, 0, 0]
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        names = [f"shaft{i}" for i in range(len(servos))]
        for name, one in zip(names, servos, strict=True):
            wheel = spec.worldbody.add_body(name=name)
            joint = wheel.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0, 0, 1])
            if stop is not None:
                joint.limited, joint.range = True, [-stop, stop]
            inertia = 0.1 * one.armature
            wheel.explicitinertial, wheel.mass, wheel.inertia = True, 0.1, [inertia] * 3
            motor = spec.add_actuator(name=name, trntype=mujoco.mjtTrn.mjTRN_JOINT, target=name)
            motor.set_to_motor()
            put_servo(spec, name, one)
            spec.add_sensor(
                name=f"joint_torque/{name}",
                type=mujoco.mjtSensor.mjSENS_JOINTACTFRC,
                objtype=mujoco.mjtObj.mjOBJ_JOINT,
                objname=name,
            )
        self.servos, self.dt, substeps = servos, dt, round(0.04 / dt)
        model = spec.compile()
        self.simulation = Simulation(model, worlds, substeps, threads=1)
        self.values = {name: torch.ones(worlds, len(servos)) for name in FACTORS}
        self.values |= {"battery_voltage": torch.ones(worlds, 1)}
        self.values |= {"supply_resistance": torch.zeros(worlds, 1)}
        self.values |= {"joint_zero_offset": torch.zeros(worlds, len(servos))}
        self.values |= values
        by_name = dict(zip(names, servos, strict=True))
        self.dynamics = ServoDynamics(model, names, by_name, self.values, 0.04)

    def step(self, target, load=0.0):
        """One control step: angles, speeds and motors' forces after each physics step."""
        worlds, joints = self.simulation.qpos.shape
        self.simulation.wrench[:, :, :, 5] = torch.as_tensor(load, dtype=torch.float64)
        control = torch.as_tensor(target, dtype=torch.float64).expand(worlds, 1, joints)
        self.dynamics.act(self.simulation)
        control = control.expand(-1, self.simulation.substeps, -1)
        sensors = self.simulation.step(control)
        self.dynamics.advance(self.simulation, sensors)
        return (*(each.clone() for each in self.simulation.substates), sensors.clone())

    def run(self, seconds, target, load=0.0):
        """Torque of the motors after some time, their back-EMF apart ``(N, J)``."""
        for _ in range(round(seconds / 0.04)):
            *_, sensors = self.step(target, load)
        return sensors[:, -1].numpy()

    @property
    def speed(self):
        return self.simulation.qvel.numpy()


@EVERY
@pytest.mark.parametrize("load", [-0.5, 0.0, 0.2, 0.4])  # shares of stall; below 0 it helps
@pytest.mark.parametrize("factor", [1.0, 1.3])
def test_friction_under_load_is_that_of_its_law(one, load, factor):
    """What a turning shaft lacks of the motor's torque and of the load that it carries."""
    against = load * one.stall_torque
    bench = Bench(replace(one, overload=None), load_friction=torch.full((1, 1), factor))
    torque = bench.run(3.0, 1e3, -against)[0, 0]
    speed = bench.speed[0, 0]
    assert speed > 0.1
    rubbed = torque - one.damping * speed - against
    constant = one.friction
    law = one.gear_friction(torque - one.back_emf * speed, -against, speed) - constant
    assert rubbed == pytest.approx(constant + factor * law, rel=0.02)


@pytest.mark.parametrize("one", [STS3250, STS3215])
@pytest.mark.parametrize("load", [0.5, -1.5])
def test_friction_of_a_shaft_that_holds_a_load_is_that_of_its_law(one, load):
    bench = Bench(one)
    motor = bench.run(6.0, 0.0, load)[0, 0]
    law = one.gear_friction(motor, load, bench.speed[0, 0])
    assert abs(bench.speed[0, 0]) < 0.05
    assert bench.simulation.model_of(0).dof_frictionloss[0] == pytest.approx(law, rel=0.02)


def test_friction_under_load_is_by_hand_that_of_the_source():
    """|e E - m M| + s |E| exp(-1), at the Stribeck speed."""
    expected = 0.0524 + abs(0.244 * 0.5 - 0.045 * 2.0) + 0.142 * 0.5 * np.exp(-1)
    assert STS3215.gear_friction(2.0, 0.5, 0.371) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("one", "most", "speed"),
    [(STS3250, 1.06, 0.01), (STS3215, 1.06, 0.01), (XL330_M288, 1.15, 0.03)],
)  # friction at rest is soft, and as it goes faster with speed in the XL330 a creeping shaft lifts more
def test_with_what_its_motor_gives_before_the_gears_a_servo_meets_its_sheet(one, most, speed):
    """From rest it lifts the sheet's stall torque, and without a load it turns as fast."""
    motor = replace(one, overload=None).before_gears()
    speeds = []
    for load in (0.97, most):
        bench = Bench(motor)
        bench.run(1.0, 1e3, -load * one.stall_torque)
        speeds.append(bench.speed[0, 0])
    assert speeds[0] > 0.1 * one.no_load_speed
    assert abs(speeds[1]) < 0.02 * one.no_load_speed
    free = Bench(motor)
    free.run(2.0, 1e3)
    assert free.speed[0, 0] == pytest.approx(one.no_load_speed, rel=speed)


def test_the_motor_before_the_gears_by_hand():
    """7.21 N m in front of gears that let 4.90 through at rest."""
    m, e, s, friction, stall = 0.045, 0.244, 0.142, STS3250.friction, 50 * 0.0980665
    motor = STS3250.before_gears()
    assert motor.motor_torque() == pytest.approx((stall * (1 + e + s) + friction) / (1 - m))
    lost = STS3250.gear_friction(motor.motor_torque(), -stall, 0.0)
    assert motor.motor_torque() - lost == pytest.approx(stall)
    line = motor.motor_torque() ** 2 / (motor.back_emf * 12.0)
    assert STS3250.stall_current == pytest.approx(line, rel=0.005)  # as its sheet's comment says


def test_the_env_has_the_motors_before_their_gears(make_base):
    """In its model; ``servos`` are those of the sheets, for ratings and states."""
    base = make_base(servos=SERVO_OF, servo_dynamics=True)
    assert base.servos["left_knee_pitch"] is STS3250
    found = base.simulation.model.actuator("left_knee_pitch").forcerange[1]
    assert found == pytest.approx(STS3250.before_gears().motor_torque())


@pytest.mark.parametrize("one", [STS3250, STS3215])
def test_an_overload_gives_way_after_two_seconds(one):
    bench, torques = Bench(one, stop=0.01), []
    for _ in range(100):
        *_, sensors = bench.step(0.8)  # rad against the stop: full duty
        torques.append(sensors[0, -1, 0].item())
    torques = np.array(torques) / one.motor_torque()
    given_way = np.flatnonzero(torques < 0.5)[0] * 0.04
    assert given_way == pytest.approx(2.0, abs=0.0401)
    assert torques[: round(given_way / 0.04)] == pytest.approx(1.0, rel=1e-6)
    assert torques[-1] == pytest.approx(0.2, rel=1e-6)


def test_an_overload_ends_when_little_is_needed_and_with_the_episode():
    bench = Bench(STS3250, worlds=2, stop=0.01)
    bench.run(2.2, 0.8)
    bench.dynamics.reset(bench.simulation, torch.tensor([True, False]))
    torque = bench.run(0.04, 0.8)
    assert torque[:, 0] == pytest.approx(STS3250.motor_torque() * np.array([1.0, 0.2]), rel=1e-6)
    bench.run(0.08, 0.02)  # the error is all but gone
    assert bench.run(0.04, 0.8)[1, 0] == pytest.approx(STS3250.motor_torque(), rel=1e-6)


def test_short_or_small_loads_are_no_overload():
    bench = Bench(STS3250, stop=0.01)
    for _ in range(3):
        bench.run(1.9, 0.8)
        bench.run(0.08, 0.02)
    need = 0.7 * STS3250.motor_torque() / STS3250.stiffness()
    torque = bench.run(4.0, 0.01 + need)  # the stop is soft
    assert torque[0, 0] == pytest.approx(0.75 * STS3250.motor_torque(), rel=0.06)


@pytest.mark.parametrize("volts", [12.0, 11.1])
def test_supply_sags_at_stall_by_the_windings_resistance(volts):
    """Two stalled motors: V = battery / (1 + R (I1 + I2) / 12), as resistors would."""
    share = torch.full((1, 1), volts / 12)
    ohm = torch.full((1, 1), 0.1)
    one = Bench(STS3215, STS3250, stop=0.01, supply_resistance=ohm, battery_voltage=share)
    torque = one.run(0.4, 0.8)
    expected = volts / (1 + 0.1 * (2.7 + 5.37) / 12)
    read = one.dynamics.read()
    assert read["supply_voltage"].item() == pytest.approx(expected, rel=1e-6)
    assert read["battery_voltage"].item() == pytest.approx(volts, rel=1e-6)
    full = np.array([STS3215.motor_torque(expected), STS3250.motor_torque(expected)])
    assert torque[0] == pytest.approx(full, rel=1e-6)


def test_a_turning_motor_draws_less_by_its_back_emf():
    ohm = torch.full((1, 1), 0.1)
    bench = Bench(replace(STS3215, overload=None), supply_resistance=ohm)
    bench.run(3.0, 1e3)
    speed, volts = bench.speed[0, 0], bench.dynamics.supply_voltage()[0, 0]
    back = (STS3215.damping - 0.0591) * speed / STS3215.motor_torque()
    assert volts == pytest.approx(12 - 0.1 * 2.7 * (volts / 12 - back), rel=1e-6)
    assert 0 < 12 - volts < 0.1 * 2.7


def test_a_braking_motor_does_not_charge_the_battery():
    """A load turns it faster than it would turn itself: its duty drives, its current brakes."""
    fast = replace(STS3250, overload=None)
    bench = Bench(fast, supply_resistance=torch.full((1, 1), 0.1))
    torque = bench.run(3.0, 1e3, 5.0)[0, 0]
    assert torque - fast.back_emf * bench.speed[0, 0] < -0.1
    assert bench.dynamics.supply_voltage()[0, 0] == 12.0


def test_supply_does_not_oscillate_however_large_its_resistance():
    bench = Bench(*[STS3250] * 4, stop=0.01, supply_resistance=torch.full((1, 1), 0.5))
    bench.run(0.4, 0.8)  # until it rests at the stop
    volts = []
    for _ in range(10):
        bench.step(0.8)
        volts.append(bench.dynamics.supply_voltage()[0, 0])
    assert volts == pytest.approx([12 / (1 + 0.5 * 4 * 5.37 / 12)] * 10, rel=1e-5)


@EVERY
def test_energy_is_kept_over_a_random_motion(one):
    """Electrical energy is that of motion, and what copper and friction took: within 1 %.

    The motor's constants k and R follow from its line: it has the torque k V / R at rest, and
    loses k^2 / R for each rad/s to its back-EMF.
    """
    bench = Bench(one, dt=0.001)
    k = one.back_emf * one.voltage / one.motor_torque()
    resistance = k * one.voltage / one.motor_torque()
    generator = torch.Generator().manual_seed(0)
    electrical = copper = friction = carried = 0.0
    load, last = 0.0, 0.0
    for step in range(250):
        if step % 10 == 0:
            target = float(2 * torch.randn((), generator=generator))
            load = float(0.2 * one.stall_torque * torch.randn((), generator=generator))
        _, speeds, sensors = bench.step(target, load)
        dry = bench.dynamics._dry[0, 0]
        after, torque = speeds[0, :, 0].numpy(), sensors[0, :, 0].numpy()
        speed = (after + np.concatenate([[last], after[:-1]])) / 2
        last = after[-1]
        volts = torque / one.motor_torque() * one.voltage
        current = (volts - k * speed) / resistance
        electrical += (volts * current).sum() * bench.dt
        copper += resistance * (current**2).sum() * bench.dt
        friction += (one.viscous_friction * speed**2 + dry * abs(speed)).sum() * bench.dt
        carried -= load * speed.sum() * bench.dt
    moving = 0.5 * 1.1 * one.armature * last**2
    assert friction > 0.1 * electrical  # the balance is of more than copper
    assert electrical == pytest.approx(copper + friction + carried + moving, rel=0.01)


def test_windings_warm_up_to_the_end_of_their_loss():
    """From cold, as ``Servo.temperature`` has it for a torque that is constant."""
    warm = replace(STS3215, thermal_resistance=10.0, thermal_time_constant=60.0, overload=None)
    bench = Bench(warm, stop=0.01)
    torque = bench.run(30.0, 0.05)[0, 0]
    assert bench.dynamics.quantities[-1].name == "servo_temperature"
    expected = warm.temperature(torque, 30.0, AMBIENT)
    found = bench.dynamics.read()["servo_temperature"].item()
    assert found - AMBIENT == pytest.approx(expected - AMBIENT, rel=0.01)


def test_a_world_is_the_same_in_any_company():
    generator, runs = torch.Generator().manual_seed(0), []
    factors = 0.7 + 0.6 * torch.rand(64, 3, generator=generator)
    ohm = 0.1 * torch.rand(64, 1, generator=generator)
    targets = torch.randn(20, 3, generator=generator, dtype=torch.float64)
    for worlds in (1, 3, 64):
        values = {"load_friction": factors[:worlds], "supply_resistance": ohm[:worlds]}
        bench = Bench(STS3250, STS3250, STS3215, worlds=worlds, **values)
        for target in targets:
            bench.step(target)
        runs.append((bench.simulation.qpos[0].clone(), bench.dynamics.supply_voltage()[0]))
    for place, volts in runs[1:]:
        assert torch.equal(place, runs[0][0])
        assert volts == runs[0][1]


@pytest.fixture
def robot(make_base):
    base = make_base(num_envs=3, servos=SERVO_OF, servo_dynamics=True)
    ohm = TensorDict({"supply_resistance": torch.tensor([[0.0], [0.05], [0.15]])}, [3])
    base.reset()
    base.set_physics_params(ohm)
    return base


def swing(base, steps=5, seed=0):
    generator = torch.Generator().manual_seed(seed)
    for _ in range(steps):
        target = base.stand_position + 0.4 * torch.randn(3, 20, generator=generator)
        td = base.step(TensorDict({"target": target}, [3]))["next"]
    return td


def test_the_env_writes_the_voltages_that_a_robot_could_measure(robot):
    td = swing(robot)
    assert (td["battery_voltage"] == 12.0).all()
    assert td["supply_voltage"][0] == 12.0
    assert td["supply_voltage"][2] < td["supply_voltage"][1] < 12.0
    assert "servo_temperature" not in td  # nobody publishes the thermal constants
    robot.observation_spec.assert_is_in(td.select(*robot.observation_spec.keys(True, True)))


def test_an_episode_begins_with_rested_servos(robot):
    before = swing(robot)
    rows = torch.tensor([[False], [False], [True]])
    td = robot.reset(before.clone().set("_reset", rows))
    assert td["supply_voltage"][2] == 12.0
    assert td["supply_voltage"][1] == before["supply_voltage"][1]
    for name, value in robot.servo_dynamics.state_dict().items():
        assert not value[2].any(), name


def test_what_is_measured_at_a_reset_does_not_depend_on_the_episode_before(robot, make_base):
    """Gears that had been loaded would brake the first motion, and the accelerometer feel it."""
    generator = torch.Generator().manual_seed(1)
    bent = robot.stand_position + 0.3 * torch.randn(3, 20, generator=generator)
    start = TensorDict({"start": {"joint_position": bent}}, [3])
    fresh = make_base(num_envs=3, servos=SERVO_OF, servo_dynamics=True)
    expected = fresh.reset(start.clone()).select(*fresh.observation_spec.keys())
    swing(robot)
    found = robot.reset(start.clone())
    assert all(torch.equal(found[key], value) for key, value in expected.items())


def test_a_restored_or_copied_env_goes_on_bit_for_bit(robot, make_base):
    swing(robot)
    other = make_base(num_envs=3, servos=SERVO_OF, servo_dynamics=True)
    other.load_state_dict(robot.state_dict())
    copied = copy.deepcopy(robot)
    expected = swing(robot, seed=1)
    for env in (other, copied):
        found = swing(env, seed=1)
        assert all(torch.equal(found[key], value) for key, value in expected.items())


def test_without_load_friction_or_resistance_only_overload_is_left(make_base):
    """A robot whose factors are 0 moves as one without these dynamics."""
    motors = {joint: one.before_gears() for joint, one in SERVO_OF.items()}
    plain = make_base(num_envs=3, servos=motors)
    ours = make_base(num_envs=3, servos=SERVO_OF, servo_dynamics=True)
    ours.set_physics_params(TensorDict({"load_friction": torch.zeros(3, 20)}, [3]))
    for env in (plain, ours):
        env.reset()
    expected, found = swing(plain), swing(ours)
    assert torch.equal(found["joint_position"], expected["joint_position"])


def test_what_does_not_go_together_is_refused_in_one_line(make_base):
    base = make_base(num_envs=1, servos=SERVO_OF)
    for key in ("load_friction", "supply_resistance"):
        with pytest.raises(ValueError, match=rf"{key} must go with .*servo_dynamics=true"):
            base.set_physics_params(TensorDict({key: torch.ones(1, 1)}, [1]))
    with pytest.raises(ValueError, match="servo_dynamics must go with servos.*got none"):
        make_base(servo_dynamics=True)
    mixed = SERVO_OF | {"left_elbow_roll": XL330_M288}
    with pytest.raises(ValueError, match=r"one voltage .*STS3250 12 V.*XL330-M288 5 V"):
        make_base(servos=mixed, servo_dynamics=True)
    secret = SERVO_OF | {"left_elbow_roll": replace(STS3215, stall_current=None)}
    base = make_base(num_envs=1, servos=secret, servo_dynamics=True)
    with pytest.raises(ValueError, match="stall_current of the servo STS3215 must be a number"):
        base.set_physics_params(TensorDict({"supply_resistance": torch.ones(1, 1)}, [1]))
    plain = make_base(num_envs=1, servos=SERVO_OF)
    with pytest.raises(ValueError, match="the same servo_dynamics, False, got True"):
        plain.load_state_dict(base.state_dict())
