"""Running statistics against NumPy's."""

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from zfall.modules.normalization import ObservationNormalizer


def test_statistics_of_batches_are_those_of_all_data():
    data = torch.randn(1000, 5) * torch.tensor([1.0, 2, 3, 4, 5]) + torch.arange(5.0)
    normalizer = ObservationNormalizer(5)
    for part in data.split([1, 99, 500, 400]):
        normalizer.update(part.reshape(-1, 1, 5))
    np.testing.assert_allclose(normalizer.mean, data.numpy().mean(0), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(normalizer.variance, data.numpy().var(0), rtol=1e-4)
    assert_close(normalizer(data).std(0), torch.ones(5), rtol=1e-2, atol=0)


def test_forward_does_not_move_the_statistics():
    normalizer = ObservationNormalizer(3)
    normalizer.update(torch.randn(10, 3))
    before = {key: value.clone() for key, value in normalizer.state_dict().items()}
    normalizer(torch.randn(10, 3))
    assert all(torch.equal(before[k], v) for k, v in normalizer.state_dict().items())


def test_values_are_clipped():
    assert ObservationNormalizer(1, clip=2.0)(torch.tensor([[100.0]])).item() == 2.0


def test_an_observation_of_another_size_is_refused():
    with pytest.raises(ValueError, match="observation must have 3 numbers, got 6"):
        ObservationNormalizer(3).update(torch.zeros(4, 6))
