"""A bus that is the twin: the same servos, latencies and noise, in the place of a robot."""

import math
import time as clock
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import torch
import yaml
from numpy.typing import NDArray
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDict
from torchrl.envs import step_mdp

from zfall.deployment import bus as registers
from zfall.deployment.bus import Register, to_angle, to_steps
from zfall.envs.tables import robot_of
from zfall.envs.transforms.observations.measured import read_measured
from zfall.evaluation.battery import arrange, battery_env, begin_streams, trial_parameters
from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.metrics import Outcomes
from zfall.evaluation.plans import Pushes, plan_pushes, plan_trials
from zfall.policies.exported import ExportedPolicy
from zfall.trust import config_of_file

WORLDS = {"twin": "twin", "nominal": "planar"}  # names of buses, and of the batteries of theirs
IMU = ("base_angular_velocity", "base_acceleration")
TEMPERATURE = 25  # of all servos [degree Celsius]: no thermal constants are published


class SimulatedBus:
    """A robot in the world of a battery, with the start and the push of one of its trials.

    Registers act as on the robot: kp and torque limit of each servo, torque on and off, goals of
    the 12 bit encoder. A ramp is refused, as the world's servos have none.

    Args:
        battery: whose world it is; without one the servos are the policy's own and all quantities
            of the simulation are measured, exactly.
        env_cfg: config of the policy's env.
        realtime: whether its clock is that of the wall; else it runs as fast as it can.

    Attributes:
        cut: the cable is cut: nothing that is read or written arrives.
        outcomes: of the trial, as batteries have them.
    """

    def __init__(self, battery: Battery, env_cfg: DictConfig, *, realtime: bool):
        own = {"_recursive_": False, "base_env": env_cfg.base_env, "transforms": {}}
        bare = OmegaConf.create(own)
        self.battery = battery.of_size(robot_of(env_cfg))
        self.realtime, self.cut = realtime, False
        self.env, self._start, self._push = battery_env(battery, bare, 1)
        self.base = self.env.base_env
        self.robot = self.base.robot.name
        self.joints: Sequence[str] = list(self.base.robot.joints)
        there = [key for key in self.base.observation_spec if isinstance(key, str)]
        self.quantities: Sequence[str] = IMU if battery.world is not None else there

    def begin(self, trial: pd.DataFrame, pushes: Pushes, seed: int) -> None:
        """Puts the robot at the start of a trial, a table of one row, switched on.

        Args:
            trial: as ``plan_trials`` has it.
            pushes: those of the trial.
            seed: of the battery.
        """
        base, joints = self.base, len(self.joints)
        arrange(self.battery, trial, pushes, base, self._start, self._push)
        begin_streams(base, seed, trial["trial"])
        nominal = {"servo_stiffness": torch.ones(1, joints)}
        nominal |= {"servo_torque_limit": torch.ones(1, joints)}
        parameters = trial_parameters(self.battery, trial, base)
        base.set_physics_params(TensorDict(nominal | parameters, [1]))
        self._td = self.env.reset()
        self.outcomes = Outcomes(base, self.battery)
        self.memory: dict[Register, dict[str, int]] = {
            registers.TORQUE_ENABLE: dict.fromkeys(self.joints, 1),
            registers.TORQUE_LIMIT: dict.fromkeys(self.joints, 1000),
            registers.GOAL_POSITION: {
                joint: to_steps(float(x))
                for joint, x in zip(self.joints, base.stand_position, strict=True)
            },
        }
        self._control = torch.zeros(1, base.substeps, joints)
        self._done = 0  # physics steps
        self._cut_at = math.inf
        self._opened = clock.perf_counter()
        self.cut = False

    def cut_at(self, time: float) -> None:
        """Cuts the cable at a time of the trial [s]."""
        self._cut_at = time

    def now(self) -> float:
        """Time since the begin of the trial [s]."""
        simulated = self._done * self.base.physics_dt
        return max(clock.perf_counter() - self._opened, simulated) if self.realtime else simulated

    def wait_until(self, time: float) -> None:
        """Lets the world go on until a time [s], with the goals that its servos have."""
        goals = self.memory[registers.GOAL_POSITION]
        goal = torch.tensor([to_angle(goals[joint]) for joint in self.joints])
        for _ in range(self._done, round(time / self.base.physics_dt)):
            self._control[0, self._done % self.base.substeps] = goal
            self._done += 1
            self.cut = self.cut or self._done * self.base.physics_dt >= self._cut_at
            if self._done % self.base.substeps == 0:
                self._advance(goal)
        if self.realtime:
            clock.sleep(max(0.0, time - (clock.perf_counter() - self._opened)))

    def _advance(self, goal: torch.Tensor) -> None:
        with torch.no_grad():
            td = self.env.step(self._td.set("control", self._control.clone()))
        td["next", "target"] = goal[None]
        self.outcomes.update(td["next"])
        self._td = step_mdp(td)

    def write(self, register: Register, values: Mapping[str, int]) -> None:
        """Writes a register of some servos.

        Raises:
            ValueError: on a value that the register does not take, or a ramp.
        """
        for joint, value in values.items():
            if not 0 <= value <= register.largest:
                raise ValueError(
                    f"register 0x{register.address:02x} of {joint} must be 0 to "
                    f"{register.largest}, got {value}."
                )
        if register is registers.ACCELERATION and any(values.values()):
            raise ValueError(
                "settings.acceleration must be 0 on a simulated bus, got "
                f"{max(values.values())}: recipes.evaluate battery=twin_ramp39 has a ramp."
            )
        if self.cut:
            return
        self.memory.setdefault(register, {}).update(values)
        if register in (registers.KP, registers.TORQUE_LIMIT, registers.TORQUE_ENABLE):
            self._set_servos()

    def _set_servos(self) -> None:
        on, limit = (
            np.array([self.memory[register][joint] for joint in self.joints])
            for register in (registers.TORQUE_ENABLE, registers.TORQUE_LIMIT)
        )
        params = {"servo_torque_limit": torch.tensor(on * limit / 1000.0).float()[None]}
        gains = self.memory.get(registers.KP)
        if gains and self.base.servos:
            share = [gains[joint] / self.base.servos[joint].kp for joint in self.joints]
            params["servo_stiffness"] = torch.tensor([share])
        self.base.set_physics_params(TensorDict(params, [1]))

    def read(self, register: Register, joints: Sequence[str]) -> dict[str, int]:
        """Reads a register of some servos; none answers when the cable is cut."""
        if self.cut:
            return {}
        if register is registers.PRESENT_POSITION:
            angles = read_measured(self._td, "joint_position")[0].tolist()
            there = {joint: to_steps(x) for joint, x in zip(self.joints, angles, strict=True)}
        elif register is registers.PRESENT_TEMPERATURE:
            there = dict.fromkeys(self.joints, TEMPERATURE)
        else:
            there = self.memory.get(register, {})
        return {joint: there[joint] for joint in joints if joint in there}

    def sense(self) -> dict[str, NDArray[Any]]:
        """What is measured besides the servos."""
        return {key: read_measured(self._td, key)[0].numpy() for key in self.quantities}

    def over(self) -> bool:
        """Whether it is known how the trial ends."""
        return bool(self.outcomes.settled.all())

    def close(self) -> None:
        """There is no hardware."""


def simulated(name: str, policy: ExportedPolicy, *, realtime: bool, **options: Any) -> SimulatedBus:
    """A simulated robot by name, of the robot that a policy was exported for.

    Args:
        name: ``twin``, or ``nominal``.
        policy: what was exported.
        realtime: as of the bus.
        options: numbers of the battery to replace.

    Raises:
        ValueError: on a bus that there is not.
    """
    if name not in WORLDS:
        known = ", ".join(WORLDS)
        raise ValueError(
            f"bus must be one of {known}, or a table with the _target_ of yours, got {name}."
        )
    described = yaml.safe_dump(policy.about["config"])
    env_cfg = config_of_file(described, policy.folder / "policy.json")
    return SimulatedBus(load_battery(WORLDS[name], **options), env_cfg, realtime=realtime)


def pushed(
    bus: SimulatedBus, *, force: tuple[float, float], seed: int, cut: float | None
) -> SimulatedBus:
    """The bus at the start of a drive with one push.

    Args:
        bus: any.
        force: forward and to the left, on the battery's first push point [N].
        seed: of the start and the world.
        cut: when the cable is cut [s]; ``None``: never.
    """
    battery = bus.battery
    trial = plan_trials(battery, bus.base.robot.impulse_unit, seed).iloc[:1]
    pushes = plan_pushes(battery, trial)
    vector = torch.zeros_like(pushes.force)
    vector[:, 0, :2] = torch.tensor(force)
    time = torch.full_like(pushes.time, battery.push_time)
    bus.begin(trial, replace(pushes, force=vector, time=time), seed)
    if cut is not None:
        bus.cut_at(cut)
    return bus
