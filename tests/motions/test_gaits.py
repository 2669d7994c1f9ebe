"""The pendulum's walk against its differential equation and the known solution without double support."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from zfall.motions.gaits import Gait, center_of_mass, feet, footstep, line

OMEGA = (9.81 / 0.22) ** 0.5  # [1/s]
PLAIN = Gait(step_time=0.4, double_support=0.08, half_width=0.06, lift=0.02, com_height=0.22)
WALKS = {
    "forward": replace(PLAIN, speed=0.2),
    "backward": replace(PLAIN, speed=-0.1),
    "spot": replace(PLAIN, turn_rate=0.8),
    "circle": replace(PLAIN, speed=0.15, turn_rate=-0.7),
}
walks = pytest.mark.parametrize("gait", WALKS.values(), ids=WALKS)


def test_straight_footsteps_lie_on_two_lines():
    places, heading = footstep(WALKS["forward"], np.arange(4))
    # Every 0.4 s x 0.2 m/s, the first after half a step, 6 cm to the left or right.
    np.testing.assert_allclose(places, [0.04 + 0.06j, 0.12 - 0.06j, 0.2 + 0.06j, 0.28 - 0.06j])
    np.testing.assert_allclose(heading, 0)


def test_footsteps_of_a_circle_lie_on_two_circles():
    """To the right at 0.15 m/s and 0.7 rad/s: the center lies 0.15 / 0.7 m to the right."""
    radius = 0.15 / 0.7
    places, heading = footstep(WALKS["circle"], np.arange(6))
    distance = np.abs(places + 1j * radius)
    np.testing.assert_allclose(distance[0::2], radius + 0.06)
    np.testing.assert_allclose(distance[1::2], radius - 0.06)
    np.testing.assert_allclose(np.diff(heading), -0.7 * 0.4)


@walks
def test_center_of_mass_obeys_the_equation_of_the_pendulum(gait):
    """Integrated from its beginning, the zero-moment point drawn by hand through the footsteps."""
    corners = [0.04, 0.36, 0.44, 0.76, 0.84]  # ends of single supports [s]
    places, _ = footstep(gait, np.array([0, 0, 1, 1, 2]))

    def rate(t, state):
        x, y = (np.interp(t, corners, part) for part in (places.real, places.imag))
        return [state[2], state[3], OMEGA**2 * (state[0] - x), OMEGA**2 * (state[1] - y)]

    time = np.linspace(0.04, 0.84, 41)
    com = center_of_mass(gait, time)
    start = [part[0] for c in (com.position, com.velocity) for part in (c.real, c.imag)]
    states = solve_ivp(
        rate, (0.04, 0.84), start, t_eval=time, rtol=1e-10, atol=1e-12, max_step=0.01
    ).y
    np.testing.assert_allclose(com.position, states[0] + 1j * states[1], atol=1e-6)
    np.testing.assert_allclose(com.velocity, states[2] + 1j * states[3], atol=1e-5)


@walks
def test_a_stride_ends_as_it_began_but_for_the_way_made_good(gait):
    com = center_of_mass(gait, np.array(gait.stride))
    way, turn = line(gait, np.array([0.8]))[0], np.exp(0.8j * gait.turn_rate)
    assert com.position[1] == pytest.approx(way + turn * com.position[0])
    assert com.velocity[1] == pytest.approx(turn * com.velocity[0])
    if gait.turn_rate == 0:
        assert way == pytest.approx(0.8 * gait.speed)


def test_without_double_support_it_is_the_known_gait():
    """x' = w L / 2 coth(w T / 2) when feet change, y = d / cosh(w T / 2) between (Kajita 2001)."""
    gait = replace(WALKS["forward"], double_support=1e-9)
    com = center_of_mass(gait, np.array([0.2, 0.4 - 1e-9]))
    half = OMEGA * 0.2
    assert com.velocity[1].real == pytest.approx(OMEGA * 0.08 / 2 / np.tanh(half), rel=1e-6)
    assert com.position[1].real == pytest.approx(0.08, rel=1e-6)
    assert com.position[0].imag == pytest.approx(0.06 - 0.06 / np.cosh(half), rel=1e-6)
    assert com.velocity[0].imag == pytest.approx(0, abs=1e-6)


@walks
def test_orbital_energy_is_kept_while_a_foot_stands_and_is_that_of_every_step(gait):
    energies = []
    for n, time in enumerate((np.linspace(0.04, 0.36, 20), np.linspace(0.44, 0.76, 20))):
        com = center_of_mass(gait, time)
        foot, _ = footstep(gait, np.array([n]))
        energy = np.abs(com.velocity) ** 2 - (OMEGA * np.abs(com.position - foot)) ** 2
        np.testing.assert_allclose(energy, energy[0], atol=1e-12)
        energies.append(energy[0])
    if gait.turn_rate == 0:  # on a circle the inner steps differ from the outer ones
        assert energies[0] == pytest.approx(energies[1])


@walks
def test_capture_point_leaves_the_standing_foot_exponentially(gait):
    time = np.array([0.05, 0.3])
    com = center_of_mass(gait, time)
    away = com.position + com.velocity / OMEGA - footstep(gait, np.array([0]))[0]
    assert away[1] == pytest.approx(np.exp(OMEGA * 0.25) * away[0])


@walks
def test_feet_move_at_the_speed_they_are_said_to_move(gait):
    time, h = np.linspace(0.045, 0.835, 60), 1e-6
    before, now, after = (feet(gait, time + shift) for shift in (-h, 0, h))
    speed = (after.position - before.position) / (2 * h)
    np.testing.assert_allclose(now.velocity, speed, atol=1e-6)
    turn = (after.heading - before.heading) / (2 * h)
    np.testing.assert_allclose(now.turn_rate, turn, atol=1e-6)


def test_swinging_foot_rises_to_its_height_in_the_middle_and_lands_where_it_stands_next():
    gait = WALKS["circle"]
    now = feet(gait, np.array([0.04, 0.2, 0.36, 0.4, 0.44]))
    np.testing.assert_allclose(now.position[:, 1, 2], [0, 0.02, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(now.position[:, 0], now.position[[0] * 5, 0])
    place, heading = footstep(gait, np.array([1]))
    np.testing.assert_allclose(now.position[2:, 1, 0] + 1j * now.position[2:, 1, 1], place[[0] * 3])
    np.testing.assert_allclose(now.heading[2:, 1], heading[0])
    np.testing.assert_allclose(now.velocity[[0, 2, 3, 4]], 0, atol=1e-12)


@pytest.mark.parametrize("value", [0.0, 0.4])
def test_double_support_without_time_to_swing_is_refused(value):
    with pytest.raises(ValueError, match=rf"double_support must lie between 0 .* got {value}"):
        replace(PLAIN, double_support=value)
