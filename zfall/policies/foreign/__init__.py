"""Policies of other frameworks: a network in a file, and a yaml that says what its numbers mean."""

from zfall.policies.foreign.read import read_foreign

__all__ = ["read_foreign"]
