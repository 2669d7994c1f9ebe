"""Physical parameters of each world, against models that MuJoCo compiled with them."""

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.tables import robot_of
from zfall.robots import ZEROTH01
from zfall.simulation.model import compile_model

DERIVED = ("body_subtreemass", "dof_M0", "dof_invweight0", "body_invweight0", "actuator_acc0")


def values(base, **given: torch.Tensor) -> TensorDict:
    return TensorDict(given, batch_size=[base.num_envs])


def test_masses_and_payload_give_the_model_that_compiling_them_gives(make_base):
    """MjSpec compiles link masses x 1.2, 0.3 kg at the chest, armature x 0.5: all fields equal."""
    base = make_base(num_envs=2)
    points = list(base.parameters.push_points)
    payload = torch.zeros(2, len(points))
    payload[:, points.index("chest")] = 0.3
    masses = torch.full((2, len(base.parameters.links)), 1.2)
    armature = torch.full((2, 20), 0.5)
    given = values(base, link_mass=masses, payload=payload, joint_armature=armature)
    base.set_physics_params(given, torch.tensor([False, True]))

    spec = mujoco.MjSpec.from_file(ZEROTH01.mjcf)
    spec.option.timestep = 0.004
    plain = compile_model(ZEROTH01, physics_dt=0.004)
    for body in spec.bodies[1:]:
        body.explicitinertial = True
        body.mass *= 1.2
        body.inertia = np.array(body.inertia) * 1.2
        body.fullinertia = np.array(body.fullinertia) * 1.2
    for name in points:
        source = plain.body(f"push_point/{name}")
        parent = spec.body(plain.body(int(source.parentid[0])).name)
        point = parent.add_body(name=f"push_point/{name}", pos=source.pos)
        point.explicitinertial = True
        point.mass = 0.3 if name == "chest" else 0.0
        point.ipos = [0, 0, 0]
    for joint in spec.joints[1:]:
        joint.armature = 0.5 * float(plain.joint(joint.name).armature[0])
    expected = spec.compile()
    ours, untouched = base.simulation.model_of(1), base.simulation.model_of(0)
    for field in ("body_mass", "body_inertia", "body_ipos", "dof_armature", *DERIVED):
        np.testing.assert_allclose(
            getattr(ours, field), getattr(expected, field), rtol=1e-6, atol=1e-9, err_msg=field
        )
        np.testing.assert_array_equal(getattr(untouched, field), getattr(plain, field))


def test_joints_servos_and_friction_give_the_model_that_editing_the_mjcf_gives(make_base):
    base = make_base(num_envs=1)
    joints, links = torch.ones(1, 20), len(base.parameters.links)
    given = values(
        base,
        joint_friction_loss=1.5 * joints,
        joint_damping=0.7 * joints,
        servo_stiffness=1.2 * joints,
        servo_torque_limit=0.9 * joints,
        battery_voltage=torch.full((1, 1), 0.8),
        floor_friction=torch.full((1, 1), 0.6),
        foot_friction=torch.full((1, 1), 0.3),
        com_offset=torch.tensor([[0.01, 0.0, -0.02]]).repeat(1, links),
    )
    base.set_physics_params(given)
    spec = mujoco.MjSpec.from_file(ZEROTH01.mjcf)
    plain = compile_model(ZEROTH01, physics_dt=0.004)
    for joint in spec.joints[1:]:
        joint.frictionloss = 1.5 * float(plain.joint(joint.name).frictionloss[0])
        joint.damping[0] = 0.7 * float(plain.joint(joint.name).damping[0])
    for servo in spec.actuators:
        kp = 1.2 * 0.8 * float(plain.actuator(servo.name).gainprm[0])
        servo.gainprm[0], servo.biasprm[1] = kp, -kp
        servo.forcerange = 0.9 * 0.8 * plain.actuator(servo.name).forcerange
    for geom in spec.geoms:
        geom.friction[0] = 0.3 if geom.name in ("left_foot", "right_foot") else 0.6
    for body in spec.bodies[1:]:
        if plain.body(body.name).mass[0] > 0:
            body.explicitinertial = True
            body.ipos = np.add(plain.body(body.name).ipos, [0.01, 0.0, -0.02])
    expected, ours = spec.compile(), base.simulation.model_of(0)
    for field in ("dof_frictionloss", "dof_damping", "actuator_gainprm", "actuator_biasprm"):
        np.testing.assert_allclose(
            getattr(ours, field), getattr(expected, field), rtol=1e-6, err_msg=field
        )
    np.testing.assert_allclose(ours.actuator_forcerange, expected.actuator_forcerange)
    np.testing.assert_allclose(ours.geom_friction, expected.geom_friction)
    for body in spec.bodies[1:]:
        mine, other = ours.body(body.name), expected.body(body.name)
        np.testing.assert_allclose(mine.ipos, other.ipos, atol=1e-8)  # values are float32
    stands = []
    for model in (ours, expected):
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
        mujoco.mj_forward(model, data)
        stands.append(data)
    for body in spec.bodies[1:]:  # what the physics makes of it
        one, two = (data.body(body.name).xipos for data in stands)
        np.testing.assert_allclose(one, two, atol=1e-8, err_msg=body.name)
    np.testing.assert_allclose(*(data.geom_xpos for data in stands), atol=1e-8)


def test_a_heavier_robot_presses_harder_on_the_floor(make_task, make_base):
    base = make_base(num_envs=2)
    masses = torch.ones(2, len(base.parameters.links))
    masses[1] = 1.3
    base.set_physics_params(values(base, link_mass=masses))
    td = base.reset()
    for _ in range(40):
        td["target"] = base.stand_position.expand(2, 20)
        td = base.step(td)["next"]
    weight = td["feet_force"][..., 2].sum(-1)
    assert_close(weight, 9.81 * 3.3494 * torch.tensor([1.0, 1.3]), rtol=5e-3, atol=0)


def test_momentum_counts_the_mass_of_its_world(make_base):
    """Thrown at 1 m/s without gravity: p = m v with 3.3494 kg, 1.3 times that, and 0.5 kg more."""
    base = make_base(num_envs=3)
    base.simulation.model.opt.gravity[:] = 0
    masses = torch.ones(3, len(base.parameters.links))
    masses[1] = 1.3
    payload = torch.zeros(3, len(base.parameters.push_points))
    payload[2, 0] = 0.5
    base.set_physics_params(values(base, link_mass=masses, payload=payload))
    td = base.reset()
    base.simulation.qpos[:, 2] = 2.0
    base.simulation.qvel[:, 0] = 1.0
    td["target"] = base.stand_position.expand(3, 20)
    td = base.step(td)["next"]
    expected = torch.tensor([3.3494, 1.3 * 3.3494, 3.8494])
    assert_close(td["linear_momentum"][:, 0], expected, rtol=1e-3, atol=0)
    restored = make_base(num_envs=3)
    restored.load_state_dict(base.state_dict())
    assert_close(restored.parameters.mass, base.parameters.mass)


def test_on_a_slope_the_feet_feel_gravity_from_the_side(make_base):
    """Standing on a floor that falls by 0.1 rad forward: F_x = -m g sin(0.1) from the floor."""
    base = make_base(num_envs=2)
    slope = torch.tensor([[0.1, 0.0], [0.0, 0.0]])
    base.set_physics_params(values(base, slope=slope))
    td = base.reset()
    assert_close(td["projected_gravity"][0], torch.tensor([np.sin(0.1), 0, -np.cos(0.1)]).float())
    for _ in range(20):
        td["target"] = base.stand_position.expand(2, 20)
        td = base.step(td)["next"]
    force = td["feet_force"].sum(1)
    weight = 9.81 * 3.3494
    assert_close(force[0, 0].item(), -weight * np.sin(0.1), rtol=0.1, atol=0)
    assert abs(force[1, 0].item()) < 0.02 * weight


@pytest.mark.parametrize("name", ["zeroth01", "op3"])
def test_slippery_feet_slide_on_a_slope_steeper_than_their_friction(
    make_base, compose_config, name
):
    """tan(0.15) = 0.151: friction 0.1 cannot hold, 0.3 can; OP3's MJCF has none for its feet."""
    base = make_base(num_envs=2, robot=robot_of(compose_config(f"robot={name}").env))
    base.set_physics_params(
        values(
            base, slope=torch.tensor([[0.0, 0.15]] * 2), foot_friction=torch.tensor([[0.1], [0.3]])
        )
    )
    td = base.reset()
    for _ in range(12):
        td["target"] = base.stand_position.expand(2, -1)
        td = base.step(td)["next"]
    slid = td["feet_position"][..., 1].mean(-1)
    assert slid[0] > 0.03
    assert slid[1].abs() < 0.01


def test_a_weak_battery_limits_the_torque_and_an_offset_moves_the_joint(make_base):
    base = make_base(num_envs=3)
    base.simulation.model.opt.gravity[:] = 0
    offset = torch.zeros(3, 20)
    offset[2] = 0.05
    base.set_physics_params(
        values(base, battery_voltage=torch.tensor([[1.0], [0.5], [1.0]]), joint_zero_offset=offset)
    )
    td = base.reset()
    base.simulation.qpos[:, 2] = 2.0
    low = base.joint_range[:, 0].expand(3, 20)
    far = base.step(td.set("target", low - 2.0))["next"]["joint_torque"]
    assert far[0].abs().max().item() == pytest.approx(8.4546, rel=0.01)
    assert far[1].abs().max().item() == pytest.approx(4.2273, rel=0.01)
    td = base.reset()
    base.simulation.qpos[:, 2] = 2.0
    for _ in range(50):
        td["target"] = base.stand_position.expand(3, 20)
        td = base.step(td)["next"]
    moved = td["joint_position"][2] - td["joint_position"][0]
    # The servo stops where its encoder reads the target, up to dry friction / stiffness.
    assert_close(moved, torch.full((20,), -0.05), atol=0.02, rtol=0)


def test_only_masked_rows_change_and_the_state_restores_them(make_base):
    base = make_base(num_envs=3)
    friction = torch.tensor([[0.2], [0.4], [0.6]])
    base.set_physics_params(values(base, foot_friction=friction), torch.tensor([True, False, True]))
    assert_close(base.parameters.values["foot_friction"], torch.tensor([[0.2], [1.0], [0.6]]))
    other = make_base(num_envs=3)
    other.load_state_dict(base.state_dict())
    for world in range(3):
        one, two = base.simulation.model_of(world), other.simulation.model_of(world)
        np.testing.assert_array_equal(one.geom_friction, two.geom_friction)


def test_unknown_parameters_and_wrong_shapes_are_refused(make_base):
    base = make_base(num_envs=2)
    with pytest.raises(ValueError, match=r"physical parameters must be of link_mass, .*got 'mass'"):
        base.set_physics_params(values(base, mass=torch.ones(2, 1)))
    with pytest.raises(ValueError, match=r"slope must have the shape \(2, 2\), got \(2, 1\)"):
        base.set_physics_params(values(base, slope=torch.ones(2, 1)))
    with pytest.raises(ValueError, match=r"slope must be .*within \[-0.785, 0.785\], got 2"):
        base.set_physics_params(values(base, slope=torch.full((2, 2), 2.0)))
    broken = torch.tensor([[1.0], [torch.nan]])
    with pytest.raises(ValueError, match=r"foot_friction must be finite .*got nan"):
        base.set_physics_params(values(base, foot_friction=broken))
    with pytest.raises(ValueError, match="mask must be of 2 worlds, got 1"):
        base.set_physics_params(values(base, foot_friction=torch.ones(2, 1)), torch.ones(1) > 0)
    assert torch.equal(base.parameters.values["foot_friction"], torch.ones(2, 1))
