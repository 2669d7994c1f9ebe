"""Policies that ship, and how any policy is loaded."""

from zfall.policies.load import Policy, load_policy

__all__ = ["Policy", "load_policy"]
