"""Drives the robot by an exported policy: drive.py policy.onnx policy.json [newtons of the push]"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np
import onnxruntime

if not 3 <= len(sys.argv) <= 4:
    sys.exit(f"usage: {sys.argv[0]} policy.onnx policy.json [newtons of a push to the left, 20]")
policy = onnxruntime.InferenceSession(sys.argv[1])
about = json.loads(Path(sys.argv[2]).read_text())
newtons = float(sys.argv[3]) if len(sys.argv) > 3 else 20.0
seconds, push = 10.0, np.array([0.0, newtons, 0.0])  # for 0.1 s after 3 s [N], on the torso
mjcf = Path(__file__).parents[1] / "zfall/robots/assets/zeroth01.xml"
model = mujoco.MjModel.from_xml_path(about.get("mjcf", str(mjcf)))
model.opt.timestep = about["physics_dt_s"]
data, stand = mujoco.MjData(model), model.key("stand").id
mujoco.mj_resetDataKeyframe(model, data, stand)
joints = about["joints"]
qpos = [int(model.joint(j).qposadr[0]) for j in joints]
qvel = [int(model.joint(j).dofadr[0]) for j in joints]
ctrl = [model.actuator(j).id for j in joints]
target = np.array(about["reference_rad"], dtype=np.float32)
action = np.zeros_like(target)
memories = {name: np.zeros(shape, np.float32) for name, shape in about["memories"].items()}


def read(name: str) -> np.ndarray:
    """A quantity of the observation."""
    if name in ("base_acceleration", "joint_torque", "contact_impulse") or "_peak" in name:
        sys.exit(f"{name} is a mean or peak over the control step, which this does not take")
    feet = [data.sensor(f"feet_contact/{foot}").data for foot in ("left", "right")]
    own = {
        "imu_orientation": data.qpos[3:7] * (1.0 if data.qpos[3] >= 0 else -1.0),
        "command": np.zeros(6),
        "projected_gravity": -data.xmat[1].reshape(3, 3)[2],
        "base_linear_velocity": data.qvel[:3],
        "base_angular_velocity": data.qvel[3:6],
        "joint_position": data.qpos[qpos],
        "joint_velocity": data.qvel[qvel],
        "target": target,
        "last_action": action,
        "feet_contact": np.array([foot[0] > 0 for foot in feet]),
        "feet_force": -np.concatenate([foot[1:4] for foot in feet]),
    }
    if name in own:
        return own[name].reshape(-1)
    sensors = [i for i in range(model.nsensor) if model.sensor(i).name.split("/")[0] == name]
    if not sensors:
        sys.exit(f"{name} is no sensor of the robot")
    return np.concatenate([data.sensor(i).data for i in sensors])


substeps = round(about["control_dt_s"] / about["physics_dt_s"])
mujoco.mj_forward(model, data)
for _ in range(round(seconds / about["control_dt_s"])):
    observation = np.concatenate([read(part["name"]) for part in about["observation"]])
    inputs = {"observation": observation[None].astype(np.float32), **memories}
    (action,), *after = policy.run(None, inputs)
    memories = dict(zip(memories, after, strict=True))
    target = np.array(about["reference_rad"]) + about["scale_rad"] * action
    target = np.clip(target, about["low_rad"], about["high_rad"]).astype(np.float32)
    data.ctrl[ctrl] = target
    for _ in range(substeps):
        data.body("Top_Brace").xfrc_applied[:3] = push * (3.0 <= data.time + 1e-9 < 3.1)
        mujoco.mj_step(model, data)
    mujoco.mj_kinematics(model, data)  # what the policy sees belongs to the state it acts in
print(f"after {seconds} s the base is {data.qpos[2]:.3f} m above the floor")
