"""A policy of another framework falls and stands in our battery as in its own loop.

The loop here is written from the conventions of mjlab and rsl_rl alone: it steps MuJoCo by itself,
makes the observation from ``qpos`` and ``qvel``, runs the torch module and not the ONNX, pushes by
``xfrc_applied``, and says by itself who fell.
"""

import mujoco
import numpy as np
import pytest
import torch
import yaml
from hydra.utils import instantiate
from tensordict import TensorDict
from torch import nn

from tests.foreign_networks import write_mlp
from zfall.evaluation.battery import run_battery, start_positions
from zfall.evaluation.candidate import load_candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plans import plan_trials
from zfall.robots import ZEROTH01

# Breadth first, as PhysX numbers joints: none of the orders of ours.
LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee_pitch", "ankle_pitch", "ankle_roll")
JOINTS = [f"{side}_{joint}" for joint in LEG for side in ("left", "right")]
REFERENCE = {n: ZEROTH01.stand.get(n, 0.0) + 0.004 * (i % 5 - 2) for i, n in enumerate(JOINTS)}
SCALE, CONTROL, PHYSICS, STEPS = 0.25, 50, 250, 3
IMPULSES = (0.15, 0.3, 0.45, 0.6, 0.8)


def terms(position, velocity, gravity, spin, before) -> list[np.ndarray]:
    """Of one step, with the scales of the yaml below."""
    return [0.2 * spin, gravity, position, 0.05 * velocity, np.clip(before, -1.0, 1.0)]


@pytest.fixture(scope="module")
def trained():
    """rsl_rl's actor, three linear layers and ELUs, trained to lean against gravity and speed."""
    torch.manual_seed(3)
    sizes = [3 * STEPS, 3 * STEPS, *[len(JOINTS) * STEPS] * 3]
    mlp = nn.Sequential(
        nn.Linear(sum(sizes), 48), nn.ELU(), nn.Linear(48, 32), nn.ELU(), nn.Linear(32, len(JOINTS))
    )
    adam = torch.optim.Adam(mlp.parameters(), 3e-3)
    for _ in range(250):
        parts = [0.15 * torch.randn(128, size) for size in sizes]
        history = [part.view(128, STEPS, -1) for part in parts]
        (spin, gravity, position, velocity, before) = (each[:, -1] for each in history)
        forward = 2.0 * gravity[:, :1] - 1.0 * spin[:, 1:2]
        aside = 2.0 * gravity[:, 1:2] + 1.0 * spin[:, :1]
        wanted = 0.1 * history[2][:, 0] - 0.3 * position - 0.2 * velocity + 0.1 * before
        for place, name in enumerate(JOINTS):
            if "ankle_pitch" in name or "hip_pitch" in name:
                wanted[:, place] += forward[:, 0] * (1 if "left" in name else -1)
            if "ankle_roll" in name:
                wanted[:, place] += aside[:, 0]
        loss = (mlp(torch.cat(parts, -1)) - wanted).square().mean()
        adam.zero_grad()
        loss.backward()
        adam.step()
    return mlp.eval()


@pytest.fixture(scope="module")
def policy(trained, tmp_path_factory):
    """The yaml of the policy, next to its ONNX."""
    folder = tmp_path_factory.mktemp("foreign")
    write_mlp(folder / "policy.onnx", trained)
    described = {
        "network": "policy.onnx",
        "rates": {"control": CONTROL, "physics": PHYSICS},
        "joints": JOINTS,
        "action": {"scale": SCALE, "reference": REFERENCE, "clip": 1.5},
        "observation": [
            {"term": "base_angular_velocity", "scale": 0.2},
            "projected_gravity",
            "joint_position",
            {"term": "joint_velocity", "scale": 0.05},
            {"term": "previous_action", "clip": [-1.0, 1.0]},
        ],
        "history": {"steps": STEPS, "stack": "terms", "oldest": "first", "start": "repeat"},
    }
    (folder / "policy.yaml").write_text(yaml.safe_dump(described, sort_keys=False))
    return folder / "policy.yaml"


@pytest.fixture(scope="module")
def battery():
    return load_battery("planar", directions=4, impulses=list(IMPULSES), starts=1, measures=[])


@pytest.fixture(scope="module")
def pushed(battery):
    """Twenty pushed trials."""
    trials = plan_trials(battery, ZEROTH01.impulse_unit, 0)
    return trials[trials["impulse"] > 0]


def own_loop(mlp, base, battery, trial, start, told) -> bool:
    """One trial in MuJoCo alone; whether the robot stays up. Targets go to ``told``, by joint."""
    model = base.simulation.model
    assert model.opt.timestep == pytest.approx(1 / PHYSICS)
    data = mujoco.MjData(model)
    dofs = {name: model.joint(name).dofadr[0] for name in JOINTS}
    places = {name: model.joint(name).qposadr[0] for name in JOINTS}
    data.qpos[:] = start
    feet = [g for g in range(model.ngeom) if "Foot" in _body(model, g)]
    assert feet
    default = np.array([REFERENCE[name] for name in JOINTS])
    pose = {name: ZEROTH01.stand.get(name, 0.0) for name in base.robot.joints} | REFERENCE
    pusher = model.body("push_point/torso").id
    angle, force = trial["direction_rad"], trial["force_n"]
    before, history, fell = np.zeros(len(JOINTS)), None, False
    for step in range(round(battery.end_time * CONTROL)):
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        gravity = turn.reshape(3, 3).T @ [0.0, 0.0, -1.0]
        position = np.array([data.qpos[places[name]] for name in JOINTS]) - default
        velocity = np.array([data.qvel[dofs[name]] for name in JOINTS])
        now = terms(position, velocity, gravity, data.qvel[3:6].copy(), before)
        history = [[each] * STEPS for each in now] if history is None else history
        if step:
            history = [[*kept[1:], each] for kept, each in zip(history, now, strict=True)]
        seen = torch.tensor(np.concatenate([np.concatenate(kept) for kept in history])).float()
        with torch.no_grad():
            before = np.clip(mlp(seen[None])[0].numpy(), -1.5, 1.5)
        targets = pose | dict(zip(JOINTS, default + SCALE * before, strict=True))
        told.append([np.clip(targets[j], *model.joint(j).range) for j in base.robot.joints])
        for actuator in range(model.nu):
            name = model.actuator(actuator).name
            data.ctrl[actuator] = np.clip(targets[name], *model.joint(name).range)
        for tick in range(PHYSICS // CONTROL):
            time = step / CONTROL + tick / PHYSICS
            acts = battery.push_time - 1e-9 < time < battery.push_time + 0.1 - 1e-9
            data.xfrc_applied[pusher, :2] = acts * force * np.array([np.cos(angle), np.sin(angle)])
            mujoco.mj_step(model, data)
            fell |= any(_touches(model, contact, feet) for contact in data.contact[: data.ncon])
        if fell:
            return False
    upright = np.arccos(1 - 2 * (data.qpos[4] ** 2 + data.qpos[5] ** 2)) < battery.max_tilt
    mujoco.mj_forward(model, data)
    return bool(upright and data.subtree_com[0, 2] > battery.min_height * base.robot.com_height)


def _body(model, geom) -> str:
    return model.body(model.geom_bodyid[geom]).name


def _touches(model, contact, feet) -> bool:
    """Whether something but a foot touches the floor."""
    floor = [g for g in contact.geom if model.geom_type[g] == mujoco.mjtGeom.mjGEOM_PLANE]
    others = [g for g in contact.geom if g not in floor and g not in feet]
    return bool(floor and others and contact.dist < 0)


@pytest.mark.long
def test_twenty_pushes_end_as_in_the_policy_s_own_loop(trained, policy, battery, pushed):
    candidate = load_candidate(str(policy))
    given = candidate.env_cfg, candidate.actor
    targets = []
    ours = run_battery(
        battery,
        *given,
        only=pushed["trial"].tolist(),
        watch=lambda env, td: targets.append(td["target"][: len(pushed)].clone()),
    )
    base = instantiate(candidate.env_cfg.base_env, num_envs=20, _convert_="all")  # its servos
    joints = {"joint_position": start_positions(battery, pushed, base)}
    base.reset(TensorDict({"start": TensorDict(joints, [20])}, [20]))  # the soles on the floor
    starts = base.simulation.qpos.numpy().copy()
    theirs, standing = [], round(battery.push_time * CONTROL)
    for number, (_, trial) in enumerate(pushed.iterrows()):
        told = []
        theirs.append(own_loop(trained, base, battery, trial, starts[number], told))
        same = torch.stack([step[number] for step in targets[:standing]]).numpy()
        np.testing.assert_allclose(same, told[:standing], rtol=0, atol=1e-4)  # [rad]
    assert ours["recovered"].tolist() == theirs
    assert len(theirs) == 20
    assert 4 <= sum(theirs) <= 16  # pushes that tell
