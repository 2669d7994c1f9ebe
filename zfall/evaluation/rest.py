"""What the robot feels while nobody pushes it: loads, heat, and how much it fidgets."""

from typing import Any, ClassVar

import pandas as pd
import torch
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.evaluation.effort import at_their_limit
from zfall.evaluation.followers import Ended, Moment
from zfall.evaluation.metrics import spectral_smoothness
from zfall.evaluation.strategies import Footsteps
from zfall.robots.servos import Servo

SETTLED = 3.0  # length of the end of a trial, by which a robot stands in its own pose [s]
STOOD = 600.0  # time for which the load lasts, for the temperature [s]
_THERMAL = ("thermal_resistance", "thermal_time_constant", "stall_current", "friction")
FIGURES = (
    *("rest_steps", "rest_torque_rms", "rest_load", "rest_at_limit", "rest_joint_speed"),
    *("rest_target_smoothness", "peak_servo_temperature"),
    *("settled_steps", "settled_load"),
)


class Rest:
    """Follows trials without a push, from the first step to the end or the fall.

    ``rest_steps``: times that a foot comes down at least 2 cm from where it had left the floor.
    ``rest_torque_rms`` [N m]: root mean square over time and joints, and of each joint,
    ``rest_torque_rms/JOINT``. ``rest_load/JOINT``: the same over the continuous rating of the
    joint's servo, where one is published; ``rest_load``: the largest of these. ``rest_at_limit``:
    share of torques ``at_their_limit``.
    ``rest_joint_speed`` [rad/s]: root mean square. ``rest_target_smoothness`` [rad]:
    ``spectral_smoothness`` of the joint targets; NaN if the robot fell.
    ``settled_steps``, ``settled_load`` and ``settled_load/JOINT``: the same over the last
    ``SETTLED`` seconds alone. A trial begins in the robot's reference pose, and going from there to
    another one takes more torque than standing in it; NaN if the robot fell.
    ``peak_servo_temperature`` [degree Celsius]: of the warmest winding after ten minutes of this
    load, from 25 degrees; NaN where a servo's thermal constants are not published.

    All are NaN in a trial that a push began in.

    Args:
        env: the base env.
    """

    outcomes: ClassVar[tuple[str, ...]] = ()

    def __init__(self, env: HumanoidEnv):
        n, self.joints = env.num_envs, env.robot.joints
        self.servos: list[Servo | None] = [(env.servos or {}).get(name) for name in self.joints]
        self.env, self.dt = env, env.control_dt
        self.time, self.limited, self.steps = torch.zeros(n), torch.zeros(n), torch.zeros(n)
        self.torque, self.speed = torch.zeros(n, len(self.joints)), torch.zeros(n)
        self.pushed = torch.zeros(n, dtype=torch.bool)
        self._feet = Footsteps(env)
        self._targets: list[Tensor] = []
        self._torques: list[Tensor] = []  # squares
        self._steps: list[Tensor] = []

    def before(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step."""
        self.update(td, now)

    def update(self, td: TensorDictBase, now: Moment) -> None:
        """Takes in a control step, of trials up to their fall."""
        share, torque = now.upto_fall.float(), td["joint_torque"]
        self.pushed |= (td["push", "force"] != 0).any(-1) & now.counted
        self.time += share
        square, steps = share[:, None] * torque.square(), share * self._feet.update(td).sum(-1)
        self.torque += square
        self.limited += share * at_their_limit(self.env, torque).float().mean(-1)
        self.speed += share * td["joint_velocity"].square().mean(-1)
        self.steps += steps
        self._targets.append(td["target"].clone())
        self._torques.append(square)
        self._steps.append(steps)

    def table(self, ended: Ended) -> dict[str, Tensor]:
        """Columns ``(N,)``."""
        torque = (self.torque / self.time[:, None]).sqrt()
        smooth = spectral_smoothness(torch.stack(self._targets, 1), self.dt)
        last = round(SETTLED / self.dt)
        loads = self._loads(torque)
        late = self._loads(torch.stack(self._torques[-last:]).mean(0).sqrt())
        settled = {
            "settled_steps": torch.stack(self._steps[-last:]).sum(0),
            "settled_load": self._largest(late),
            **{f"settled_load/{joint}": load for joint, load in late.items()},
        }
        columns = {
            "rest_steps": self.steps,
            "rest_torque_rms": torque.square().mean(-1).sqrt(),
            "rest_load": self._largest(loads),
            "rest_at_limit": self.limited / self.time,
            "rest_joint_speed": (self.speed / self.time).sqrt(),
            "rest_target_smoothness": torch.where(ended.fell, torch.nan, smooth),
            "peak_servo_temperature": self._warmest(torque),
            **{f"rest_torque_rms/{joint}": torque[:, i] for i, joint in enumerate(self.joints)},
            **{f"rest_load/{joint}": load for joint, load in loads.items()},
            **{name: torch.where(ended.fell, torch.nan, x) for name, x in settled.items()},
        }
        return {name: torch.where(self.pushed, torch.nan, x) for name, x in columns.items()}

    def _loads(self, torque: Tensor) -> dict[str, Tensor]:
        """Torques ``(N, J)`` over the ratings of the servos that have one, by joint."""
        return {
            joint: torque[:, place] / servo.continuous_torque
            for place, (joint, servo) in enumerate(zip(self.joints, self.servos, strict=True))
            if servo is not None and servo.continuous_torque
        }

    def _largest(self, loads: dict[str, Tensor]) -> Tensor:
        """The largest load of each trial ``(N,)``, NaN without any."""
        if not loads:
            return torch.full_like(self.time, torch.nan)
        return torch.stack(list(loads.values())).amax(0)

    def _warmest(self, torque: Tensor) -> Tensor:
        """Largest temperature of a winding ``(N,)`` under torques ``(N, J)``, NaN if unknown."""
        hottest = torch.full_like(self.time, -torch.inf)
        for place, servo in enumerate(self.servos):
            if servo is None or any(getattr(servo, name) is None for name in _THERMAL):
                return torch.full_like(self.time, torch.nan)
            warm = [servo.temperature(float(each), STOOD) for each in torque[:, place]]
            hottest = torch.maximum(hottest, torch.tensor(warm))
        return hottest

    @staticmethod
    def summary(trials: pd.DataFrame) -> dict[str, Any]:
        """Means over the control arm; ``rest``, their spread over draws; ``rest_servos``."""
        control = trials[trials["impulse"] == 0]
        rows = [
            {
                "figure": name,
                "mean": float(control[name].mean()),
                **{
                    f"{share} %": float(control[name].quantile(share / 100))
                    for share in (10, 50, 90)
                },
                "largest": float(control[name].max()),
            }
            for name in FIGURES
            if name in control or not name.startswith("settled")  # which older trials lack
        ]
        means = {str(row["figure"]): row["mean"] for row in rows}
        return {**means, "rest": pd.DataFrame(rows), "rest_servos": _of_servos(control)}


def _of_servos(control: pd.DataFrame) -> pd.DataFrame:
    """One row per joint: root mean square torque [N m]; over the rating; that of the last 3 s."""
    prefix = "rest_torque_rms/"
    names = [str(name).removeprefix(prefix) for name in control if str(name).startswith(prefix)]

    def over_trials(column: str) -> float:
        if column not in control:
            return float("nan")
        return float(control[column].pow(2).mean() ** 0.5)

    return pd.DataFrame(
        {
            "joint": names,
            "torque_rms": [over_trials(prefix + name) for name in names],
            "load": [over_trials(f"rest_load/{name}") for name in names],
            "settled_load": [over_trials(f"settled_load/{name}") for name in names],
        }
    )
