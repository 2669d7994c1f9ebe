"""What tests of falling share."""

import pytest
import torch

from zfall.falling.fall_network import FallNetwork


@pytest.fixture
def network() -> FallNetwork:
    """A fall network of random weights that reads six numbers."""
    torch.manual_seed(0)
    network = FallNetwork(6, 8)
    network.normalizer.update(torch.randn(100, 6))
    return network
