"""What a trial is judged by, measured on true quantities."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.terms.falls import body_contact
from zfall.evaluation.definitions import Battery
from zfall.evaluation.followers import Ended, Moment, followers_of
from zfall.rotations import tilt

MEASURES = 3  # version of what the columns mean: raise it when that changes
LYING = 0.3  # share of the height below which a robot has fallen whose body meets no floor
STANDING = 2.0  # time before the push in which smoothness is measured [s]


def spectral_smoothness(signal: Tensor, dt: float) -> Tensor:
    """How much of a signal changes how fast ``(N,)``, mean over its channels; 0 if it rests.

    ``2 / (n f_s) sum_i M_i f_i`` over the n frequencies f_i of a discrete Fourier transform above
    0, with M_i the amplitude at f_i and f_s the sampling frequency; in units of the signal. Over
    the same time it falls with the square of f_s: values at two rates do not compare.

    Args:
        signal: samples ``(N, T, J)``.
        dt: time between them [s].

    Source: Mysore et al., "Regularizing action policies for smooth control with reinforcement
    learning", ICRA 2021.
    """
    length = signal.shape[1]
    frequency = torch.fft.rfftfreq(length, dt)[1:]
    amplitude = 2.0 / length * torch.fft.rfft(signal, dim=1)[:, 1:].abs()
    if length % 2 == 0:
        amplitude[:, -1] *= 0.5  # half of the sampling frequency, which has no mirror image
    weighted = (frequency[:, None] * amplitude).mean(1)
    return (2.0 * dt * weighted).mean(-1)


class Outcomes:
    """Follows the trials of a chunk step by step.

    ``fell``: any region but the feet touched the floor (or the physics failed). ``recovered``:
    not fallen until the end, and then upright and high enough. Peaks are taken from the push on,
    over physics steps, until the trial ends or for the battery's ``aftermath`` after the first
    touch; then a trial is ``settled``: nothing that follows counts. ``target_smoothness`` is the
    ``spectral_smoothness`` of the joint targets [rad] in the last two seconds before the push.
    The battery's ``measures`` add their columns.

    Args:
        env: the base env.
        battery: gives the times and the bounds.
    """

    def __init__(self, env: HumanoidEnv, battery: Battery):
        n = env.num_envs
        self.battery, self.control_dt = battery, env.control_dt
        self.height = battery.min_height * env.robot.com_height
        self.lying = LYING * env.robot.com_height
        self.regions = env.regions
        self.time = 0.0
        self.fell = torch.zeros(n, dtype=torch.bool)
        self.diverged = torch.zeros(n, dtype=torch.bool)
        self.settled = torch.zeros(n, dtype=torch.bool)
        self.counted = torch.zeros(n, dtype=torch.bool)  # at least one step after the push
        self.time_to_fall = torch.full((n,), torch.nan)
        self.peak_base_acceleration = torch.zeros(n)
        self.peak_contact_force = torch.zeros(n, len(env.regions))
        self.peak_joint_torque = torch.zeros(n)
        self.peak_tilt = torch.zeros(n)
        self.upright = torch.zeros(n, dtype=torch.bool)
        self._targets: list[Tensor] = []
        self.followers = [follower(env) for follower in followers_of(battery)]

    def update(self, td: TensorDictBase) -> None:
        """Takes in what followed a control step."""
        self.time += self.control_dt
        self.diverged |= td["diverged"].squeeze(-1)
        height = td["com_position"][:, 2]
        touched = body_contact(td, td).squeeze(-1) | self.diverged | (height < self.lying)
        first = touched & ~self.fell
        self.fell |= touched
        since_push = self.time - self.battery.push_time
        self.time_to_fall = torch.where(first, since_push, self.time_to_fall)
        angle = tilt(td["base_orientation"])
        self.upright = (angle < self.battery.max_tilt) & (height > self.height)
        if self.battery.aftermath is not None:
            self.settled = self.fell & (since_push >= self.time_to_fall + self.battery.aftermath)
        if -STANDING + 1e-6 < since_push < 1e-6:
            self._targets.append(td["target"].clone())
        counted = ~self.settled
        now = Moment(since_push, counted, touched, first, counted & (~self.fell | first))
        if since_push < 1e-6:
            for follower in self.followers:
                follower.before(td, now)
        else:
            self.counted |= counted
            for follower in self.followers:
                follower.update(td, now)
            for name, value in (
                ("peak_base_acceleration", td["base_acceleration_peak"].squeeze(-1)),
                ("peak_contact_force", td["contact_force_peak"]),
                ("peak_joint_torque", td["joint_torque_peak"].squeeze(-1)),
                ("peak_tilt", angle),
            ):
                peak = getattr(self, name)
                mask = counted if value.ndim == 1 else counted[:, None]
                setattr(self, name, torch.where(mask, torch.maximum(peak, value), peak))

    @property
    def fall_time(self) -> Tensor:
        """When each trial fell ``(N,)`` [s since it began]; NaN if it did not."""
        return self.time_to_fall + self.battery.push_time

    def table(self) -> pd.DataFrame:
        """One row per trial."""
        before_push = self.fell & ~self.counted
        ended = Ended(self.fell, self.diverged, before_push)
        measured = {
            name: value.numpy()
            for follower in self.followers
            for name, value in follower.table(ended).items()
        }
        outcomes = [name for follower in self.followers for name in follower.outcomes]
        body = self.peak_contact_force[:, :-2]  # the feet come last; some models have nothing else
        peaks = {
            "peak_tilt": self.peak_tilt,
            "peak_base_acceleration": self.peak_base_acceleration,
            "peak_contact_force": body.amax(-1) if body.shape[-1] else body.sum(-1),
            "peak_joint_torque": self.peak_joint_torque,
        }
        by_region = {
            f"peak_contact_force/{region}": self.peak_contact_force[:, index]
            for index, region in enumerate(self.regions)
        }
        columns = {
            "recovered": (self.upright & ~self.fell).numpy(),
            "fell": self.fell.numpy(),
            **{name: measured.pop(name) for name in outcomes},
            "time_to_fall_s": self.time_to_fall.numpy(),
            **_unless(before_push, peaks),
            "target_smoothness": self._smoothness().numpy(),
            **measured,
            **_unless(before_push, by_region),
        }
        # In float64 a number read back from a file is the number that was written.
        return pd.DataFrame(
            {key: x.astype(float) if x.dtype == "float32" else x for key, x in columns.items()}
        )

    def _smoothness(self) -> Tensor:
        if not self._targets:
            return torch.full_like(self.time_to_fall, torch.nan)
        smoothness = spectral_smoothness(torch.stack(self._targets, 1), self.control_dt)
        # What lies on the floor before the push does not stand smoothly.
        return torch.where(self.time_to_fall < 1e-6, torch.nan, smoothness)


def _unless(before_push: Tensor, peaks: Mapping[str, Tensor]) -> dict[str, NDArray[np.generic]]:
    """Peaks ``(N,)``; NaN of trials that were over before the push."""
    return {name: torch.where(before_push, torch.nan, peak).numpy() for name, peak in peaks.items()}
