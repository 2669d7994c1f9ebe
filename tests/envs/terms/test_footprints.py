"""Distance of footprints against a quadratic program and by hand."""

import numpy as np
import pytest
import torch
from scipy.optimize import nnls
from scipy.spatial.transform import Rotation
from torch.testing import assert_close

from zfall.envs.terms.footprints import footprint_distance, footprints
from zfall.envs.terms.support import sole_corners
from zfall.robots import ZEROTH01


def feet(spread: float, tilt: float, num: int = 300) -> dict[str, torch.Tensor]:
    """Feet somewhere, turned at will and tilted by up to ``tilt`` rad."""
    rng = np.random.default_rng(0)
    angles = np.concatenate([rng.uniform(-np.pi, np.pi, (2 * num, 1)),
                             rng.uniform(-tilt, tilt, (2 * num, 2))], 1)  # fmt: skip
    quaternion = Rotation.from_euler("ZYX", angles).as_quat()[:, [3, 0, 1, 2]]
    position = spread * rng.standard_normal((num, 2, 3)) + [5.0, -3.0, 0.0]
    return {
        "feet_position": torch.tensor(position).float(),
        "feet_orientation": torch.tensor(quaternion).float().reshape(num, 2, 4),
    }


def program(one: np.ndarray, other: np.ndarray) -> float:
    """Smallest distance of two points, each a convex combination of corners, by SciPy's NNLS.

    min |A a - B b| with a, b >= 0 that sum to 1, the sums with a large weight.
    """
    weight = 1e3
    left = np.concatenate([one.T, -other.T], 1)
    sums = weight * np.kron(np.eye(2), np.ones((1, len(one))))
    solution, _ = nnls(np.concatenate([left, sums]), np.array([0.0, 0.0, weight, weight]))
    return float(np.linalg.norm(left @ solution))


@pytest.mark.parametrize("tilt", [0.0, 1.2])
@pytest.mark.parametrize("spread", [0.05, 0.15])
def test_distance_agrees_with_a_quadratic_program(spread, tilt):
    td = feet(spread, tilt)
    found = footprint_distance(*footprints(td, ZEROTH01))
    corners = sole_corners(td, ZEROTH01)[..., :2].double().numpy()
    middle = corners.mean((1, 2), keepdims=True)
    expected = [program(*pair) for pair in corners - middle]
    assert 20 < sum(d < 1e-6 for d in expected) < 280
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_corners_are_the_center_and_half_edges():
    td = feet(0.1, 1.0)
    center, half = footprints(td, ZEROTH01)
    corners = sole_corners(td, ZEROTH01)[..., :2]
    signs = torch.tensor([[1.0, 1], [1, -1], [-1, 1], [-1, -1]])  # front left, front right ...
    assert_close(corners, center[..., None, :] + signs @ half, atol=1e-6, rtol=0)


def place(*centers: tuple[float, float]) -> torch.Tensor:
    return torch.tensor([[(0.0, 0.0), center] for center in centers])


def test_parallel_feet_side_by_side_behind_each_other_and_corner_to_corner():
    """Half edges 0.05 and 0.03: gaps of 0.01 along x, 0.02 along y, and of 0.03, 0.04 at once."""
    half = torch.tensor([[0.05, 0.0], [0.0, 0.03]]).expand(2, 2, 2)
    center = place((0.11, 0.02), (0.04, -0.08), (-0.13, 0.10), (0.1, 0.05), (0.1, 0.06))
    expected = torch.tensor([0.01, 0.02, 0.05, 0.0, 0.0])
    assert_close(footprint_distance(center, half.expand(5, 2, 2, 2)), expected, atol=1e-6, rtol=0)
    # The other foot the other way round: each half edge points against its partner.
    turned = torch.stack([half[0], -half[0]]).expand(5, 2, 2, 2)
    assert_close(footprint_distance(center, turned), expected, atol=1e-6, rtol=0)


def test_corner_next_to_an_edge():
    """A square on its tip, its half diagonal of 0.05 along x, 0.08 + 0.05 + 0.01 away."""
    half = torch.tensor([[[0.08, 0.0], [0.0, 0.04]], [[0.025, 0.025], [-0.025, 0.025]]])
    assert_close(footprint_distance(place((0.14, 0.02)), half[None]), torch.tensor([0.01]))


def test_feet_seen_edge_on_are_segments():
    """Two segments of half length 0.05 on one line, then at right angles."""
    line = torch.tensor([[0.05, 0.0], [0.0, 0.0]])
    across = torch.tensor([[0.0, 0.05], [0.0, 0.0]])
    half = torch.stack([torch.stack([line, line]), torch.stack([line, across])])
    far = footprint_distance(place((0.13, 0.0), (0.08, 0.09)), half)
    assert_close(far, torch.tensor([0.03, 0.05]), atol=1e-6, rtol=0)  # 0.03 and 0.04 away
    near = footprint_distance(place((0.09, 0.0), (0.04, 0.04)), half)
    assert_close(near, torch.zeros(2))
