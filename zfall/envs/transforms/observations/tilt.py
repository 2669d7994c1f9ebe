"""Roll and pitch as an IMU gives them."""

from tensordict import TensorDictBase
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from zfall.envs.on_robot import Derived, OnRobot
from zfall.envs.transforms.base_env import on_data
from zfall.envs.transforms.observations.measured import measured_key, read_measured
from zfall.rotations import roll_and_pitch


class TiltAngles(Transform):
    """Gives roll and pitch, for an IMU that works them out itself.

    Intrinsic rotations about z, y, x, positive to the right and forward. Noise of the angles
    stands after it; ``TiltKalmanFilter``, which estimates the same, is there for an IMU that
    gives rates and accelerations only.

    Keys: reads ``projected_gravity`` ``(N, 3)``, true and, if it is, measured; writes ``tilt``
    and ``("measured", "tilt")`` ``(N, 2)`` [rad].

    Raises:
        ValueError: when the specs are built, if an earlier transform has measured ``tilt``.
    """

    hardware = "sensors"
    measured = True  # sensing must come before it
    forward = on_data

    def __init__(self) -> None:
        super().__init__(in_keys=["projected_gravity"], out_keys=["tilt", measured_key("tilt")])

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        next_tensordict["tilt"] = roll_and_pitch(-next_tensordict["projected_gravity"])
        measured = read_measured(next_tensordict, "projected_gravity")
        return next_tensordict.set(measured_key("tilt"), roll_and_pitch(-measured))

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def on_robot(self) -> OnRobot:
        """The same on a robot whose IMU gives the direction of gravity."""
        return Derived(self.in_keys, {"tilt": lambda gravity: roll_and_pitch(-gravity)})

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        if measured_key("tilt") in observation_spec.keys(True):
            raise ValueError("TiltAngles must be the only transform that measures tilt; one has.")
        for key in self.out_keys:
            observation_spec[key] = Unbounded((*observation_spec.shape, 2))
        return observation_spec
