"""What the robot measures, and what policy and critic get to see.

Sensing transforms form a chain: each takes a quantity from ``("measured", key)`` if an earlier one
left it there, else the true ``key``, and writes ``("measured", key)``. True values stay where they
are, for rewards and the critic; ``ObservationVector(measured=True)`` reads the measured ones.
``ObservationDelay`` comes first in the chain, as it needs the values between control steps; what
follows stands in the order of the hardware: bias and noise of the sensor, its resolution, messages
that get lost, then the estimators of ``estimation`` and the quantities of ``derived``.

``ObservationHistory`` lets a policy without a memory look back at some quantities. TorchRL's
``CatFrames(N=4, dim=-1, in_keys=["observation"], out_keys=["observation"])`` after the vector
stacks whole observations; it starts again in the rows of a partial reset.
"""

from zfall.envs.transforms.observations.bias import ObservationBias, ObservationRandomWalk
from zfall.envs.transforms.observations.delay import ObservationDelay
from zfall.envs.transforms.observations.derived import (
    BasePose,
    FeetInBase,
    ImuOrientation,
    OrientationToHeading,
)
from zfall.envs.transforms.observations.dropout import ObservationDropout
from zfall.envs.transforms.observations.history import ObservationHistory
from zfall.envs.transforms.observations.neighbours import CAPSNeighbours
from zfall.envs.transforms.observations.noise import ObservationNoise
from zfall.envs.transforms.observations.normalized import NormalizedVector
from zfall.envs.transforms.observations.quantization import Quantization
from zfall.envs.transforms.observations.tilt import TiltAngles
from zfall.envs.transforms.observations.vector import ObservationVector

__all__ = [
    "BasePose",
    "CAPSNeighbours",
    "FeetInBase",
    "ImuOrientation",
    "NormalizedVector",
    "ObservationBias",
    "ObservationDelay",
    "ObservationDropout",
    "ObservationHistory",
    "ObservationNoise",
    "ObservationRandomWalk",
    "ObservationVector",
    "OrientationToHeading",
    "Quantization",
    "TiltAngles",
]
