"""What a policy that falls well is made of, each as a stage of a training can make it.

| class | makes | recipe |
|---|---|---|
| ``TrainedTrigger`` | a network that predicts falls | ``recipes.falling.trigger`` |
| ``RecordedFalls`` | a bank of falls | ``recipes.falling.falls`` |
| ``SearchedCatches`` | movements that catch them | ``recipes.falling.catches`` |
| ``LyingStates`` | a bank of robots that lie and kneel | ``recipes.falling.lying`` |
| ``SearchedRises`` | movements that get up | ``recipes.falling.rises`` |
| ``SwitchedPolicy`` | two policies in one | ``recipes.falling.switch`` |

Each is a ``zfall.training.makers.Maker``.
"""

from zfall.falling.making.catches import SearchedCatches
from zfall.falling.making.falls import RecordedFalls
from zfall.falling.making.lying import LyingStates
from zfall.falling.making.rises import SearchedRises
from zfall.falling.making.switched import SwitchedPolicy
from zfall.falling.making.trigger import TrainedTrigger

__all__ = [
    "LyingStates",
    "RecordedFalls",
    "SearchedCatches",
    "SearchedRises",
    "SwitchedPolicy",
    "TrainedTrigger",
]
