"""The kernel at its two defining points."""

import torch
from torch.testing import assert_close

from zfall.envs.terms.kernels import rbf


def test_one_on_the_target_and_epsilon_at_the_cutoff():
    target = torch.tensor([1.0, -2.0, 0.5])
    assert rbf(target, target, cutoff=0.3).item() == 1.0
    direction = torch.nn.functional.normalize(torch.randn(50, 3), dim=-1)
    for epsilon in (0.01, 0.1):
        edge = rbf(target + 0.3 * direction, target, cutoff=0.3, epsilon=epsilon)
        assert_close(edge, torch.full((50, 1), epsilon))
