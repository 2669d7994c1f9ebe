"""Forces of the coming step, in a buffer that is used again."""

import torch
from torch.testing import assert_close

from zfall.envs.forces import StepForces


def test_forces_add_up_and_the_next_step_has_only_its_own():
    wrench, forces = torch.zeros(4, 2, 3, 6), StepForces(4)
    forces.take(wrench, None)
    forces.add(wrench, 1, torch.ones(4, 2, 3))
    forces.add(wrench, torch.tensor([1, 2]), torch.ones(2, 2, 3), torch.tensor([0, 3]))
    assert wrench[..., :3].sum((1, 3)).tolist() == [[0, 12, 0], [0, 6, 0], [0, 6, 0], [0, 6, 6]]
    forces.take(wrench, wrench)  # what the step's TensorDict holds: all is there already
    assert wrench.count_nonzero() == 30
    forces.take(wrench, None)
    assert wrench.count_nonzero() == 0


def test_a_wrench_of_the_caller_is_copied_added_to_and_then_gone():
    wrench, forces, own = torch.zeros(2, 1, 3, 6), StepForces(2), torch.randn(2, 1, 3, 6)
    given = own.clone()
    forces.take(wrench, own)
    forces.add(wrench, 0, torch.ones(2, 1, 3))
    expected = given.clone()
    expected[:, :, 0, :3] += 1.0
    assert_close(wrench, expected)
    assert torch.equal(own, given)
    forces.take(wrench, None)
    assert wrench.count_nonzero() == 0
