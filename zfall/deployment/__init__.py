"""Driving a robot by an exported policy: the loop, its bus, and a simulated bus that is the twin.

No hardware was at hand: what is here has driven the simulated bus alone.
"""

from zfall.deployment.bus import Bus
from zfall.deployment.loop import Settings, drive
from zfall.deployment.simulated import SimulatedBus

__all__ = ["Bus", "Settings", "SimulatedBus", "drive"]
