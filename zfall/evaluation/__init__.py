"""Batteries of pushes: what a policy withstands, how it recovers, what that costs.

``evaluate(policy, "planar")`` gives the trials and their summary. A battery is a yaml in
``recipes/battery``; its ``kind`` is a class of ``kinds`` and its ``measures`` are followers.
"""

from zfall.evaluation.definitions import Battery, load_battery
from zfall.evaluation.results import Result
from zfall.evaluation.run import evaluate

__all__ = ["Battery", "Result", "evaluate", "load_battery"]
