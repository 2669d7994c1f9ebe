"""The base env: specs, units, clocks, resets and faults."""

import math
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.humanoid import HumanoidEnv
from zfall.robots import ZEROTH01, Ball, Contact
from zfall.robots.servos import STS3250
from zfall.rotations import rotate
from zfall.simulation.quantities import SUBSTEP_KEYS


def stand(env: HumanoidEnv, seconds: float) -> TensorDict:
    """Holds the reference pose; returns what follows the last step."""
    td = env.reset()
    for _ in range(round(seconds / env.control_dt)):
        td["target"] = env.stand_position.expand(env.num_envs, -1)
        td = env._step(td)
    return td


def test_specs_hold(make_base):
    check_env_specs(make_base())


def test_joints_may_come_in_another_order_than_the_actuators(make_base):
    turn = [*range(3, 20), 0, 1, 2]  # not its own inverse
    other = replace(ZEROTH01, joints=tuple(ZEROTH01.joints[i] for i in turn))
    torch.manual_seed(0)
    target = torch.tensor(ZEROTH01.stand_position) + 0.2 * torch.randn(2, 20)
    states = []
    for robot, targets in ((ZEROTH01, target), (other, target[:, turn])):
        env = make_base(num_envs=2, robot=robot)
        td = env.reset()
        td["target"] = targets
        states.append(env._step(td))
    assert states[0]["joint_velocity"].abs().max() > 0.5
    for key in ("joint_position", "joint_velocity", "joint_torque"):
        assert_close(states[1][key], states[0][key][:, turn], rtol=0, atol=0)


def test_standing_still_has_the_forces_and_momenta_of_rest(make_base):
    env = make_base(num_envs=1)
    td = stand(env, 4.0)[0]
    weight = env.mass * 9.81
    assert td["feet_force"][:, 2].sum().item() == pytest.approx(weight, rel=5e-3)
    assert td["feet_corner_force"].sum().item() == pytest.approx(weight, rel=5e-3)
    assert td["feet_contact"].all()
    assert_close(td["contact_force_peak"][:-2], torch.zeros(12))
    assert td["base_acceleration"].norm().item() == pytest.approx(9.81, abs=0.01)
    assert td["linear_momentum"].norm() < 2e-3
    assert td["angular_momentum"].norm() < 1e-3
    assert td["com_position"][2].item() == pytest.approx(ZEROTH01.com_height, abs=1e-3)


def test_center_of_pressure_lies_below_the_center_of_mass_at_rest(make_base):
    """Force-weighted mean of both feet, in world axes, by statics."""
    td = stand(make_base(num_envs=1), 4.0)[0]
    cop = torch.cat([td["feet_cop"], torch.zeros(2, 1)], -1)
    spots = td["feet_position"] + rotate(td["feet_orientation"], cop)
    share = td["feet_force"][:, 2] / td["feet_force"][:, 2].sum()
    assert_close((share[:, None] * spots).sum(0)[:2], td["com_position"][:2], atol=1e-3, rtol=0)


def test_corner_forces_and_center_of_pressure_agree(make_base):
    """The lever rule over the four corners of a sole of 0.103446 x 0.074 m."""
    td = stand(make_base(num_envs=1), 4.0)[0]
    force = td["feet_corner_force"]  # front left, front right, rear left, rear right
    forward = 0.051723 * (force[:, :2].sum(-1) - force[:, 2:].sum(-1)) / force.sum(-1)
    left = 0.037 * (force[:, ::2].sum(-1) - force[:, 1::2].sum(-1)) / force.sum(-1)
    assert_close(td["feet_cop"], torch.stack([forward, left], -1), atol=5e-4, rtol=0)


def test_free_fall_has_the_speed_and_momentum_of_a_falling_body(make_base):
    env = make_base(num_envs=1, control_dt=0.02)
    start = {"base_position": torch.tensor([[0.0, 0.0, 2.0]]),
             "base_linear_velocity": torch.tensor([[0.5, -0.3, 0.0]])}  # fmt: skip
    td = env.reset(TensorDict({"start": start}, batch_size=[1]))
    for _ in range(5):
        td["target"] = env.stand_position[None]
        td = env._step(td)
    assert_close(td["base_acceleration"], torch.zeros(1, 3), atol=0.6, rtol=0)  # servos settle
    # The sensors are one physics step older than the state.
    speed = torch.tensor([[0.5, -0.3, -9.81 * (0.1 - env.physics_dt)]])
    assert_close(td["com_velocity"], speed, atol=1e-3, rtol=0)
    assert_close(td["linear_momentum"], env.mass * speed, atol=4e-3, rtol=0)
    assert not td["feet_contact"].any()
    assert_close(td["feet_cop"], torch.zeros(1, 2, 2))


def test_angular_velocity_is_in_body_axes_and_velocity_in_world_axes(make_base):
    """A robot that lies on its side (rolled by 90 degrees) and spins about its own z axis."""
    env = make_base(num_envs=1)
    half = 0.5**0.5
    start = {"base_position": torch.tensor([[0.0, 0.0, 2.0]]),
             "base_orientation": torch.tensor([[half, half, 0.0, 0.0]]),
             "base_linear_velocity": torch.tensor([[0.0, 0.4, 0.0]]),
             "base_angular_velocity": torch.tensor([[0.0, 0.0, 2.0]])}  # fmt: skip
    td = env.reset(TensorDict({"start": start}, batch_size=[1]))
    assert_close(td["base_angular_velocity"], torch.tensor([[0.0, 0.0, 2.0]]))
    assert_close(td["base_linear_velocity"], torch.tensor([[0.0, 0.4, 0.0]]))
    # Body y points up, so gravity points along -y of the body.
    assert_close(td["projected_gravity"], torch.tensor([[0.0, -1.0, 0.0]]), atol=1e-6, rtol=0)
    # Its own z axis is world -y: the angular momentum points there.
    direction = td["angular_momentum"][0] / td["angular_momentum"][0].norm()
    assert direction[1].item() < -0.9


def test_forces_add_up_in_their_step_and_are_gone_after_it(make_base):
    """In free flight the momentum grows by what acts: newtons x seconds, of each world its own."""
    env = make_base(num_envs=2, control_dt=0.04)
    env.simulation.model.opt.gravity[:] = 0
    td = env.reset(TensorDict({"start": {"base_position": [[0.0, 0.0, 2.0]] * 2}}, batch_size=[2]))
    torso, pelvis = env.push_target("torso"), env.push_target("pelvis")
    foreign = torch.zeros(2, 10, env.num_bodies, 6)
    foreign[:, :, torso, 2] = 1.0
    x, y = torch.tensor([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])

    def momentum_gained(*forces, wrench=None):
        """Of two steps: the sensors of one are a physics step old."""
        nonlocal td
        before, step = td["linear_momentum"], td.copy()
        step["target"] = env.stand_position.expand(2, -1)
        if wrench is not None:
            step["push", "wrench"] = wrench
        for target, force in forces:
            env.add_force(step, target, force)
        td = env.step(step)["next"].copy()
        td["target"] = env.stand_position.expand(2, -1)
        td = env.step(td)["next"]
        return (td["linear_momentum"] - before) / 0.04

    each = torch.tensor([torso, pelvis])
    gained = momentum_gained((torso, 3.0 * x), (each, 2.0 * y.expand(2, 10, 3)), (torso, x))
    assert_close(gained, (4.0 * x + 2.0 * y).expand(2, 3), atol=1e-2, rtol=0)
    z = torch.tensor([0.0, 0.0, 1.0])
    assert_close(
        momentum_gained((pelvis, 5.0 * x), wrench=foreign),
        (5 * x + z).expand(2, 3),
        atol=1e-2,
        rtol=0,
    )
    assert_close(momentum_gained(), torch.zeros(2, 3), atol=1e-2, rtol=0)
    assert foreign.count_nonzero() == 20  # added to elsewhere


def test_start_without_height_puts_the_lowest_corner_on_the_floor(make_base):
    env = make_base(num_envs=16)
    angle = env.stand_position + 0.2 * torch.randn(16, 20)
    angle = torch.clamp(angle, *env.joint_range.unbind(-1))
    td = env.reset(TensorDict({"start": {"joint_position": angle}}, batch_size=[16]))
    x, y = ZEROTH01.sole_half_size
    corners = torch.tensor([[sx * x, sy * y, 0.0] for sx in (-1, 1) for sy in (-1, 1)])
    quaternion = td["feet_orientation"][:, :, None].expand(-1, -1, 4, -1)
    heights = td["feet_position"][:, :, None] + rotate(quaternion, corners.expand(16, 2, 4, 3))
    assert_close(heights[..., 2].amin((1, 2)), torch.zeros(16), atol=1e-5, rtol=0)
    assert_close(td["joint_position"], angle)


def test_partial_reset_leaves_the_other_worlds_alone(make_base):
    env = make_base(num_envs=4)
    td = stand(env, 0.2)
    td["target"] = env.stand_position.expand(4, -1) + 0.1
    td = env._step(td)
    before = td["joint_position"].clone()
    td["_reset"] = torch.tensor([[False], [True], [False], [False]])
    after = env.reset(td)
    assert_close(after["joint_position"][1], env.stand_position, atol=1e-6, rtol=0)
    rest = [0, 2, 3]
    assert torch.equal(after["joint_position"][rest], before[rest])
    assert torch.equal(env.simulation.qpos[rest, 7:].float().sort().values,
                       before[rest].sort().values)  # fmt: skip


def test_reset_of_some_worlds_shows_what_the_others_showed_also_in_a_restored_env(make_base):
    """Every key: as after the step in the other worlds, as after a whole reset in the new ones.

    With a ball, floors that fall to different sides, and robots of different mass.
    """
    env, restored = (make_base(3, ball=Ball(mass=0.5, radius=0.04)) for _ in range(2))
    drawn = {
        "slope": 0.1 * torch.randn(3, 2),
        "payload": torch.rand(3, len(env.parameters.push_points)),
    }
    for world in (env, restored):
        world.record_substeps(SUBSTEP_KEYS)
        world.set_physics_params(TensorDict(drawn, [3]))
    whole = env.reset()
    td = TensorDict({"target": env.stand_position + 0.1 * torch.randn(3, 20)}, [3])
    for _ in range(5):
        stepped = env.step(td.copy())["next"]
    restored.reset()  # has seen something else
    restored.load_state_dict(env.state_dict())
    rows = torch.tensor([False, True, False])
    for world in (env, restored):
        mixed = world._reset(TensorDict({"_reset": rows[:, None]}, [3]))
        assert (mixed["joint_position"][rows] - stepped["joint_position"][rows]).abs().max() > 0.01
        for key in world.observation_spec.keys(True, True):
            assert_close(mixed[key][rows], whole[key][rows], rtol=1e-6, atol=1e-6)
            if world is env or key[0] != "substeps":  # which a saved state does not hold
                assert_close(mixed[key][~rows], stepped[key][~rows], rtol=1e-6, atol=1e-6)


def test_control_acts_at_the_resolution_of_the_physics(make_base):
    """A target of the last physics step alone moves a joint less than one of all ten."""
    env = make_base(num_envs=3)
    td = env.reset()
    control = env.stand_position.expand(3, env.substeps, -1).clone()
    control[1, -1, 0] += 0.5
    control[2, :, 0] += 0.5
    td["control"] = control
    moved = env._step(td)["joint_position"][:, 0]
    assert moved[0].abs() < 1e-4 < moved[1] < 0.1 * moved[2]


def test_joint_torque_is_the_servo_law_averaged_over_the_step(make_base):
    """At the first physics step the joint has not moved: torque = stiffness x 0.1 rad."""
    env = make_base(num_envs=1, control_dt=0.004)
    td = env.reset()
    td["target"] = env.stand_position[None] + 0.1
    torque = env._step(td)["joint_torque"][0]
    legs = [
        i
        for i, name in enumerate(ZEROTH01.joints)
        if any(p in name for p in ("hip", "knee", "ankle"))
    ]
    assert_close(torque[legs], torch.full((12,), 3.124), atol=2e-3, rtol=0)


def test_the_largest_torque_is_that_of_a_step_of_the_physics(make_base):
    """Of targets that change in every physics step, each world's own; to either side."""
    env = make_base(num_envs=16)
    env.record_substeps(["joint_torque"])
    td = env.reset()
    control = env.stand_position + 0.05 * torch.randn(16, env.substeps, 20)
    out = env._step(td.set("control", control))
    by_step = out["substeps", "joint_torque"].abs()
    assert_close(out["joint_torque_peak"], by_step.flatten(1).amax(1, keepdim=True))
    assert (out["joint_torque_peak"][:, 0] > out["joint_torque"].abs().amax(1) + 0.1).all()


def test_fixed_seed_rollouts_are_the_same_to_the_bit(make_base):
    rollouts = []
    for threads in (1, 2):
        torch.manual_seed(3)
        env = make_base(threads=threads)
        env.set_seed(1)
        rollouts.append(env.rollout(10))
    for key, value in rollouts[0].items(True, True):
        assert torch.equal(value, rollouts[1][key]), key


def test_diverged_world_ends_and_never_shows_a_value_that_is_not_finite(make_base):
    env = make_base(num_envs=3)
    td = env.reset()
    env.simulation.qvel[1] = 1e30
    td["target"] = env.stand_position.expand(3, -1)
    out = env._step(td)
    assert out["terminated"].squeeze().tolist() == [False, True, False]
    assert out["diverged"].squeeze().tolist() == [False, True, False]
    assert all(value.isfinite().all() for value in out.values() if value.dtype == torch.float32)


def test_a_value_beyond_any_physics_ends_the_world_also_amid_the_step(make_base):
    """All links are thrown up by 2e6 m/s2 for one of ten physics steps, and stopped in the next."""
    env = make_base(num_envs=2)
    td = env.reset()
    td["target"] = env.stand_position.expand(2, -1)
    force = 2e6 * torch.from_numpy(env.simulation.model.body_mass[1:])
    env.simulation.wrench[1, 2, :, 2], env.simulation.wrench[1, 3, :, 2] = force, -force
    end = env.simulation.step(td["target"][:, None].expand(-1, 10, -1))[:, -1]
    assert not env.simulation.diverged.any()
    assert end.abs().max() < 1e3
    env.reset()
    td["push", "wrench"] = env.simulation.wrench.clone()
    assert env._step(td)["diverged"].squeeze().tolist() == [False, True]


def test_saved_env_goes_on_bit_for_bit(make_base):
    env = make_base()
    td = stand(env, 0.2)
    saved = env.state_dict()
    td["target"] = env.stand_position.expand(4, -1) + 0.2
    expected = env._step(td.clone())["joint_position"]
    other = make_base()
    other.load_state_dict(saved)
    assert torch.equal(other._step(td.clone())["joint_position"], expected)


def test_a_state_of_other_servos_is_refused_with_what_differs(make_base, tmp_path):
    """Also after a file; one from before servos were written down is taken as it was."""
    published, sold = make_base(1), make_base(1, servos=dict.fromkeys(ZEROTH01.joints, STS3250))
    softer = dict.fromkeys(ZEROTH01.joints, STS3250) | {"left_knee_pitch": replace(STS3250, kp=22)}
    torch.save(sold.state_dict(), tmp_path / "state.pt")
    saved = torch.load(tmp_path / "state.pt", weights_only=True)
    make_base(1, servos=sold.servos).load_state_dict(saved)
    with pytest.raises(ValueError, match="same servos, the actuators of the MJCF, got STS3250"):
        published.load_state_dict(saved)
    with pytest.raises(ValueError, match="same servos, STS3250, got the actuators of the MJCF"):
        sold.load_state_dict(published.state_dict())
    with pytest.raises(ValueError, match=r"same servos\.left_knee_pitch\.kp, 22, got 32"):
        make_base(1, servos=softer).load_state_dict(saved)
    old = saved | {"made_for": {k: v for k, v in saved["made_for"].items() if k != "servos"}}
    published.load_state_dict(old)


def test_a_state_of_harder_parts_is_refused(make_base):
    """One from before contacts were written down is of the MJCF's."""
    soft = make_base(1, physics_dt=0.001)
    hard = make_base(1, physics_dt=0.001, contact=Contact(frequency=20.0, damping_ratio=0.2))
    with pytest.raises(ValueError, match="same contact, that of the MJCF, got "):
        soft.load_state_dict(hard.state_dict())
    old = soft.state_dict()
    del old["made_for"]["contact"]
    soft.load_state_dict(old)
    with pytest.raises(ValueError, match="same contact, .*, got that of the MJCF"):
        hard.load_state_dict(old)


@pytest.mark.parametrize(("values", "message"), [
    ({"num_envs": 0}, "num_envs must be at least 1, got 0"),
    ({"num_envs": -3}, "num_envs must be at least 1, got -3"),
    ({"control_dt": 0.03}, "control_dt must be a multiple of physics_dt, got control_dt 0.03"),
    ({"control_dt": 0.001}, "control_dt must be a multiple of physics_dt"),
    ({"physics_dt": 0.0}, "physics_dt must be positive"),
    ({"control_dt": math.nan}, "control_dt must be positive and finite, got nan"),
    ({"control_dt": math.inf}, "control_dt must be positive and finite, got inf"),
    ({"threads": 0}, "threads must be at least 1, or null for all cores, got 0"),
])  # fmt: skip
def test_bad_numbers_are_refused_with_rule_and_value(values, message):
    with pytest.raises(ValueError, match=message):
        HumanoidEnv(**({"num_envs": 1, "control_dt": 0.04} | values))


def test_recorded_substeps_are_those_of_an_env_with_that_control_rate(make_base):
    """The same targets at the rate of the physics: every step of one is a substep of the other."""
    slow, fast = make_base(num_envs=2), make_base(num_envs=2, control_dt=0.004)
    slow.record_substeps(SUBSTEP_KEYS)
    check_env_specs(slow)
    td, fine = slow.reset(), fast.reset()
    for key in SUBSTEP_KEYS:
        assert torch.equal(td["substeps", key], fine[key][:, None].expand(-1, 10, -1)), key
    for _ in range(3):
        target = slow.stand_position + 0.3 * torch.randn(2, 20)
        td["target"] = target
        td = slow._step(td)
        for step in range(10):
            fine["target"] = target
            fine = fast._step(fine)
            for key in SUBSTEP_KEYS:  # each call starts the solver cold
                assert_close(td["substeps", key][:, step], fine[key], atol=1e-4, rtol=1e-3)
    for key in set(SUBSTEP_KEYS) - {"base_acceleration", "joint_torque"}:
        assert torch.equal(td["substeps", key][:, -1], td[key]), key


def test_substeps_after_a_partial_reset_are_those_of_the_new_state(make_base):
    env = make_base(num_envs=2)
    env.record_substeps(["joint_position"])
    td = env.reset()
    td["target"] = env.stand_position.expand(2, -1) + 0.3
    td = env._step(td)
    td = env._reset(TensorDict({"_reset": torch.tensor([[False], [True]])}, [2]))
    expected = env.stand_position.expand(10, -1)
    assert_close(td["substeps", "joint_position"][1], expected)


def test_key_that_is_not_known_at_every_physics_step_is_refused(make_base):
    with pytest.raises(
        ValueError, match=r"keys must be known .*\(joint_position.*\), got com_position"
    ):
        make_base().record_substeps(["com_position"])


def test_time_constant_of_the_servos_is_damping_over_stiffness(make_base):
    """Published gains: legs 1.34640385 / 31.243846, shoulders 16 / 22 of that stiffness."""
    constant = make_base().servo_time_constant
    assert_close(constant[:12], torch.full((12,), 1.34640385 / 31.243846))
    assert_close(constant[[12, 13, 16, 17]], torch.full((4,), 1.34640385 / 31.243846 * 22 / 16))
