"""The task of ``push_recovery`` as one writes it for gymnasium: a world per env, in NumPy."""

from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.envs.mujoco import MujocoEnv
from numpy.typing import NDArray

from zfall.robots import ZEROTH01

Array = NDArray[Any]

SUBSTEPS = 10  # physics steps of 4 ms in a control step of 40 ms
SCALE = 0.6  # angle by which an action of 1 turns a servo [rad]
NOISE = {"gravity": 0.01, "gyro": 0.02, "position": 0.01, "velocity": 0.2}
EPISODE = 500  # control steps


class GymnasiumPeer(MujocoEnv):
    """Pushes, delay, noise, rewards, falls and observations of ``recipes/env/push_recovery.yaml``.

    The observation holds the policy's vector and, behind it, the critic's.

    Args:
        training: whether there are noise, delays, pushes and random starts.
    """

    metadata = {"render_modes": []}
    _action: Array
    _target: Array
    _force: Array
    _start: float
    _clock: int

    def __init__(self, training: bool = True) -> None:
        super().__init__(ZEROTH01.mjcf, SUBSTEPS, observation_space=None)
        model, joints = self.model, [self.model.joint(name) for name in ZEROTH01.joints]
        self.training = training
        self._qpos = np.array([joint.qposadr[0] for joint in joints])
        self._qvel = np.array([joint.dofadr[0] for joint in joints])
        self._low, self._high = np.array([joint.range for joint in joints]).T
        self._order = [ZEROTH01.joints.index(model.actuator(i).name) for i in range(model.nu)]
        self._stand = np.array(ZEROTH01.stand_position)
        self._torso = model.body("Top_Brace").id  # whose center of mass is the push point
        self._sensor = {model.sensor(i).name: model.sensor(i) for i in range(model.nsensor)}
        self._torque = self._columns(f"joint_torque/{joint}" for joint in ZEROTH01.joints)
        self._body = self._columns(  # forces of the floor on all but the feet
            name
            for name in self._sensor
            if name.startswith("contact_force_peak/") and not name.endswith("_foot")
        )
        feet = [self._columns([f"feet_contact/{foot}"]) for foot in ZEROTH01.feet]
        self._found = [columns[0] for columns in feet]
        self._load = np.concatenate([columns[1:4] for columns in feet])
        self._places = self._columns(f"feet_position/{foot}" for foot in ZEROTH01.feet)
        self._travel, self._spin = map(self._columns, (["com_velocity"], ["angular_momentum"]))
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (model.nu,), np.float32)
        size = len(self.reset()[0])
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (size,), np.float32)

    def step(self, action: Array) -> tuple[Array, np.float64, bool, bool, dict[str, np.float64]]:
        model, data, dt = self.model, self.data, self.model.opt.timestep
        target = np.clip(self._stand + SCALE * np.clip(action, -1.0, 1.0), self._low, self._high)
        torque, touched, pushed = np.zeros(len(self._torque)), False, np.zeros(3)
        for step in range(SUBSTEPS):
            data.ctrl[:] = (target if step >= self._lag else self._target)[self._order]
            begin = self._clock * SUBSTEPS * dt + step * dt
            share = min(begin + dt, self._start + 0.1) - max(begin, self._start)
            data.xfrc_applied[self._torso, :3] = max(share / dt, 0.0) * self._force
            pushed += data.xfrc_applied[self._torso, :3] / SUBSTEPS
            mujoco.mj_step(model, data)
            torque += data.sensordata[self._torque] / SUBSTEPS
            touched = touched or bool(data.sensordata[self._body].any())
        self._clock += 1
        if self._clock * SUBSTEPS * dt >= self._start + 0.1:
            self._plan(self._start + 0.1)
        up = self._up()
        fell = touched or np.arccos(np.clip(up[2], -1.0, 1.0)) > 1.0
        error, speed = data.qpos[self._qpos] - self._stand, data.qvel[:2]
        reward = (
            0.1 * (not fell)
            + 0.1 * np.exp((up[2] - 1.0) / 0.1)
            + 0.05 * np.exp(-(error @ error) / 1.4**2)
            + 0.1 * np.exp(-(speed @ speed) / 0.32**2)
            - 0.003 * np.square(action - self._action).sum()
            - 1.0 * fell
        )
        self._action, self._target = np.array(action), target
        late = self._clock >= EPISODE
        return self._observe(up, torque, pushed), np.float64(reward), bool(fell), late, {}

    def reset_model(self) -> Array:
        data, rng = self.data, self.np_random
        data.qpos[:] = self.model.key("stand").qpos
        if self.training:
            angle = self._stand + 0.05 * rng.standard_normal(len(self._stand))
            data.qpos[self._qpos] = np.clip(angle, self._low, self._high)
            data.qvel[self._qvel] = 0.2 * rng.standard_normal(len(self._stand))
            mujoco.mj_kinematics(self.model, data)
            data.qpos[2] -= self._lowest()
        data.ctrl[:] = self._stand[self._order]
        mujoco.mj_forward(self.model, data)
        self._lag = rng.integers(3) if self.training else 0  # physics steps
        self._clock, self._force = 0, np.zeros(3)
        self._start = np.inf
        if self.training:
            self._plan(0.0)
        self._action, self._target = np.zeros(self.model.nu), self._stand
        return self._observe(self._up(), data.sensordata[self._torque], self._force)

    def _plan(self, end: float) -> None:
        """Draws the next push, after a rest from ``end`` on [s]."""
        rng = self.np_random
        self._start = end + rng.uniform(0.5, 3.0)
        size, heading = rng.uniform(0.2, 0.6), rng.uniform(0.0, 2.0 * np.pi)
        newton = size * ZEROTH01.impulse_unit / 0.1
        self._force = newton * np.array([np.cos(heading), np.sin(heading), 0.0])

    def _observe(self, up: Array, torque: Array, pushed: Array) -> Array:
        data, draw = self.data, self.np_random.standard_normal
        sensed = {
            "gravity": -up,
            "gyro": data.qvel[3:6],
            "position": data.qpos[self._qpos],
            "velocity": data.qvel[self._qvel],
        }
        true = [*sensed.values(), self._target]
        if self.training:
            sensed = {k: v + NOISE[k] * draw(len(v)) for k, v in sensed.items()}
        values = data.sensordata
        contact = values[self._found] > 0
        base = [data.qvel[:3], values[self._travel], data.qpos[:3]]
        feet = [contact, -values[self._load], values[self._places]]
        privileged = [*true, *base, *feet, values[self._spin], torque, pushed]
        return np.concatenate([*sensed.values(), self._target, *privileged]).astype(np.float32)

    def _up(self) -> Array:
        """World up in the axes of the base."""
        inverse, up = np.empty(4), np.empty(3)
        mujoco.mju_negQuat(inverse, self.data.qpos[3:7])
        mujoco.mju_rotVecQuat(up, np.array([0.0, 0.0, 1.0]), inverse)
        return up

    def _lowest(self) -> float:
        """Height of the lowest corner of the soles [m]."""
        length, width = ZEROTH01.sole_half_size
        heights = []
        for foot in ZEROTH01.feet:
            site = int(self._sensor[f"feet_position/{foot}"].objid[0])
            down = np.abs(self.data.site_xmat[site][6:8]) @ [length, width]
            heights.append(self.data.site_xpos[site][2] - down)
        return float(min(heights))

    def _columns(self, names: Any) -> Array:
        sensors = [self._sensor[name] for name in names]
        return np.concatenate([np.arange(s.adr[0], s.adr[0] + s.dim[0]) for s in sensors])
