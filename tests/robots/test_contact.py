"""Contacts as hard as real parts."""

import math

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from zfall.robots import ZEROTH01, Contact
from zfall.robots.contact import pad
from zfall.simulation.model import compile_model

SPEED, STEP = 1.0, 2e-5  # of what arrives [m/s], and of the physics [s]


def ball_on_floor(solref: tuple[float, float], mass: float) -> tuple[float, float]:
    """Largest acceleration [m/s2] and speed away from the floor [m/s] of a ball, in MuJoCo."""
    spec = mujoco.MjSpec()
    spec.option.timestep, spec.option.gravity = STEP, [0.0, 0.0, 0.0]
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], solref=solref)
    body = spec.worldbody.add_body(pos=[0.0, 0.0, 0.051])
    body.add_freejoint()
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.05, 0.0, 0.0], mass=mass, solref=solref, condim=1
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[2] = -SPEED
    largest = 0.0
    while data.qvel[2] < 0.0 or data.ncon:
        mujoco.mj_step(model, data)
        largest = max(largest, data.qacc[2])
        assert data.time < 1.0
    return largest, data.qvel[2]


def spring_and_damper(frequency: float, damping_ratio: float) -> tuple[float, float]:
    """The same of a mass on a spring and a damper that do not pull, by SciPy."""
    pulse = 2.0 * math.pi * frequency

    def push(x: float, v: float) -> float:
        return max(-(pulse**2) * x - 2.0 * damping_ratio * pulse * v, 0.0)

    solved = solve_ivp(
        lambda t, y: [y[1], push(*y)], (0.0, 1.0 / frequency), [0.0, -SPEED], max_step=1e-5
    )
    return max(push(x, v) for x, v in solved.y.T), solved.y[1, -1]


@pytest.mark.parametrize("mass", [0.1, 3.0])
@pytest.mark.parametrize("damping_ratio", [0.05, 0.2, 0.4])
def test_an_impact_is_that_of_a_spring_and_a_damper_whatever_the_mass(damping_ratio, mass):
    """To 8 %: in its first millimeter a contact of MuJoCo's is that much softer."""
    solref = Contact(frequency=20.0, damping_ratio=damping_ratio).solref(STEP)
    here, there = ball_on_floor(solref, mass), spring_and_damper(20.0, damping_ratio)
    assert here == pytest.approx(there, rel=0.08)


def test_a_pad_is_a_spring_that_stops_a_mass():
    """k = 4e7 * 4e-4 / 4e-3 = 4e6 N/m, so for 1 kg 2000 rad/s; of e = exp(-pi) zeta is 1/sqrt(2)."""
    contact = pad(modulus=4e7, area=4e-4, thickness=4e-3, mass=1.0, restitution=math.exp(-math.pi))
    assert contact.frequency == pytest.approx(2000.0 / (2.0 * math.pi))
    assert contact.damping_ratio == pytest.approx(1.0 / math.sqrt(2.0))


def test_a_step_that_cannot_follow_an_impact_is_refused():
    """At 20 Hz a radian lasts 8 ms: 1.3 ms; with much damping half a time constant, 0.8 ms."""
    with pytest.raises(ValueError, match="physics_dt must be at most 0.0013 for contacts of 20 Hz"):
        Contact(frequency=20.0, damping_ratio=0.2).solref(0.004)
    with pytest.raises(ValueError, match="at most 0.0008"):
        Contact(frequency=20.0, damping_ratio=5.0).solref(0.001)


def test_all_parts_of_the_robot_have_it_and_none_without():
    contact = Contact(frequency=20.0, damping_ratio=0.2)
    plain, hard = (
        compile_model(ZEROTH01, physics_dt=0.001, contact=each) for each in (None, contact)
    )
    np.testing.assert_allclose(plain.geom_solref, [[0.02, 1.0]] * plain.ngeom)
    np.testing.assert_allclose(hard.geom_solref, [contact.solref(0.001)] * hard.ngeom)
