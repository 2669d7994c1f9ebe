"""The batch of worlds against single MuJoCo worlds."""

import mujoco
import numpy as np
import pytest
import torch

from zfall.robots import ZEROTH01
from zfall.simulation.compiled import BOUND, sound
from zfall.simulation.cpu import Simulation
from zfall.simulation.model import compile_model

S = 10


@pytest.fixture
def model() -> mujoco.MjModel:
    return compile_model(ZEROTH01, physics_dt=0.004)


def make(model: mujoco.MjModel, worlds: int, threads: int = 2) -> tuple[Simulation, torch.Tensor]:
    simulation = Simulation(model, worlds, S, threads)
    generator = torch.Generator().manual_seed(0)
    qpos = torch.tensor(model.key_qpos[0]).repeat(worlds, 1)
    qpos[:, 7:] += 0.05 * torch.randn(worlds, 20, generator=generator)
    target = torch.tensor(model.key_ctrl[0]).repeat(worlds, 1)
    everyone = torch.ones(worlds, dtype=torch.bool)
    simulation.reset(everyone, qpos, torch.zeros(worlds, 26), target)
    control = target[:, None] + 0.2 * torch.randn(worlds, S, 20, generator=generator)
    return simulation, control


def test_step_is_s_times_mj_step_with_the_control_of_each(model):
    simulation, control = make(model, 3)
    start = simulation.qpos.clone()
    wrench = torch.zeros(3, S, model.nbody - 1, 6)
    wrench[1, 2:5, 1, 0] = 20.0
    simulation.wrench.copy_(wrench)
    simulation.step(control)
    for world in range(3):
        data = mujoco.MjData(model)
        data.qpos[:] = start[world]
        for step in range(S):
            data.ctrl[:] = control[world, step]
            data.xfrc_applied[1:] = wrench[world, step]
            mujoco.mj_step(model, data)
        np.testing.assert_allclose(simulation.qpos[world], data.qpos, atol=1e-10)
        np.testing.assert_allclose(simulation.qvel[world], data.qvel, atol=1e-8)


def test_threads_and_company_do_not_change_a_world(model):
    ends = []
    for threads, worlds in ((1, 8), (2, 8), (2, 3)):
        simulation, control = make(model, 8, threads)
        qpos = simulation.qpos[:worlds].clone()
        simulation = Simulation(model, worlds, S, threads)
        everyone = torch.ones(worlds, dtype=torch.bool)
        simulation.reset(everyone, qpos, torch.zeros(worlds, 26), control[:worlds, 0])
        for _ in range(5):
            simulation.step(control[:worlds])
        ends.append(simulation.qpos[:3].clone())
    assert torch.equal(ends[0], ends[1])
    assert torch.equal(ends[0], ends[2])


def test_reset_touches_only_its_rows_and_gives_the_new_sensors(model):
    simulation, control = make(model, 4)
    simulation.step(control)
    before = simulation.qpos.clone()
    rows = torch.tensor([False, True, False, False])
    qpos = torch.tensor(model.key_qpos[0]).repeat(1, 1)
    qpos[:, 0] = 5.0
    sensors = simulation.reset(rows, qpos, torch.zeros(1, 26), control[:1, 0])
    assert torch.equal(simulation.qpos[~rows], before[~rows])
    place = model.sensor("com_position").adr[0]
    assert sensors[1, -1, place].item() == pytest.approx(5.0, abs=0.02)


def test_saved_state_goes_on_bit_for_bit(model):
    simulation, control = make(model, 4)
    for _ in range(10):  # until feet bear load: the solver has something to begin with
        simulation.step(control)
    saved = simulation.state_dict()
    simulation.step(control)
    expected = simulation.qpos.clone()
    other, _ = make(model, 4)
    other.load_state_dict(saved)
    other.step(control)
    assert torch.equal(other.qpos, expected)


def test_diverged_world_is_reported_and_leaves_the_others_alone(model):
    simulation, control = make(model, 4)
    reference, _ = make(model, 4)
    simulation.qvel[2] = 1e30
    simulation.step(control)
    reference.step(control)
    assert simulation.diverged.tolist() == [False, False, True, False]
    others = torch.tensor([0, 1, 3])
    assert torch.equal(simulation.qpos[others], reference.qpos[others])


def test_a_world_given_up_on_has_diverged_though_its_values_are_sound(model):
    """MuJoCo takes a control that is not a number for zero, with a warning that ends the steps."""
    simulation, control = make(model, 3)
    control[1, 4, 0] = torch.nan
    simulation.step(control)
    assert (simulation.qvel.abs() < BOUND).all()
    assert simulation.diverged.tolist() == [False, True, False]


@pytest.mark.parametrize(("value", "good"), [
    (0.0, True), (0.99 * BOUND, True), (-0.99 * BOUND, True), (-1.01 * BOUND, False),
    (1e200, False), (np.inf, False), (-np.inf, False), (np.nan, False),
])  # fmt: skip
def test_a_world_is_sound_if_no_value_is_beyond_the_bound(value, good):
    """Several just below it are sound, although the root of their squares is not."""
    values = np.full((3, 5), 0.9 * BOUND)
    values[0], values[1, 2] = 1.0, value
    assert sound(values).tolist() == [True, good, True]


def test_worlds_that_do_not_step_stay_and_change_no_other(model):
    whole, control = make(model, 5)
    part, _ = make(model, 5)
    part.step_only(torch.tensor([True, False, True, True, False]))
    before = part.qpos.clone()
    whole.step(control)
    part.step(control)
    assert torch.equal(part.qpos[[0, 2, 3]], whole.qpos[[0, 2, 3]])
    assert torch.equal(part.qpos[[1, 4]], before[[1, 4]])
    assert not part.diverged.any()  # a world that stands still has not failed
    part.step_only(None)
    part.step(control)
    assert not torch.equal(part.qpos[1], before[1])


def test_worlds_that_do_not_step_keep_a_state_that_was_loaded(model):
    moved, control = make(model, 3)
    for _ in range(5):
        moved.step(control)
    other, _ = make(model, 3)
    other.load_state_dict(moved.state_dict())
    other.step_only(torch.tensor([True, False, False]))
    other.step(control)
    assert torch.equal(other.qpos[1:], moved.qpos[1:])
    assert not torch.equal(other.qpos[0], moved.qpos[0])
