"""Cores of this process, on systems that say and on those that do not."""

import os

import pytest

from zfall.cores import usable_cores


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="this system binds no processes")
def test_a_process_bound_to_one_core_has_one():
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert usable_cores() == 1
    finally:
        os.sched_setaffinity(0, before)


@pytest.mark.parametrize(("machine", "cores"), [(6, 6), (None, 1)])
def test_a_system_that_binds_no_processes_gives_all_cores(monkeypatch, machine, cores):
    """As on macOS, where os has no sched_getaffinity."""
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.setattr(os, "cpu_count", lambda: machine)
    assert usable_cores() == cores
