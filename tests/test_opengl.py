"""Which OpenGL MuJoCo is told to use, by system."""

import os
import sys

import pytest

import zfall


@pytest.fixture
def choose(monkeypatch):
    """Runs the choice on a system with a value of MUJOCO_GL; returns what it then is."""

    def on(system: str, given: str | None) -> str | None:
        monkeypatch.setattr(os, "environ", {} if given is None else {"MUJOCO_GL": given})
        monkeypatch.setattr(sys, "platform", system)
        monkeypatch.setattr(zfall, "find_library", lambda name: name)
        zfall._choose_gl()
        return os.environ.get("MUJOCO_GL")

    return on


@pytest.mark.parametrize(
    ("system", "given", "chosen"),
    [
        ("linux", None, "egl"),
        ("linux", "osmesa", "osmesa"),
        ("linux", "nonsense", "disable"),
        ("darwin", None, None),
        ("darwin", "egl", None),
        ("darwin", "glfw", "glfw"),
        ("win32", "OSMesa ", None),
    ],
)
def test_opengl_of_linux_is_asked_for_on_linux_alone(choose, system, given, chosen):
    assert choose(system, given) == chosen
