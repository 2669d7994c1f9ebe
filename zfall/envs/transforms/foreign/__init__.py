"""What policies of other frameworks see and do: their observation, and their joint targets.

``zfall.policies.foreign`` makes these tables of the yaml that describes such a policy.
"""

from zfall.envs.transforms.foreign.observation import ForeignObservation
from zfall.envs.transforms.foreign.target import ForeignJointTarget

__all__ = ["ForeignJointTarget", "ForeignObservation"]
