"""Hulls against SciPy's, the support polygon of a standing robot, and hand-worked cases."""

import numpy as np
import pytest
import torch
from scipy.spatial import ConvexHull
from torch.testing import assert_close

from zfall.envs.terms.support import (
    com_in_support,
    convex_hull,
    distance_inside,
    edge_distance,
    hull_center,
    sole_corners,
    support_hull,
)
from zfall.robots import ZEROTH01

ALL = torch.ones(8, dtype=torch.bool)


def settled(make_base):
    base = make_base(num_envs=2)
    td = base.reset()
    for _ in range(50):
        td["target"] = base.stand_position.expand(2, 20)
        td = base.step(td)["next"]
    return td


@pytest.mark.parametrize("count", [3, 5, 8])
def test_vertices_area_and_depth_agree_with_scipy(count):
    """500 random sets of points, of which ``count`` are used."""
    points = 0.1 * torch.rand(500, 8, 2) + torch.randn(500, 1, 2)
    used = torch.zeros(500, 8, dtype=torch.bool)
    used[:, :count] = True
    hull = convex_hull(points, used)
    query = points[:, :count].mean(1) + 0.05 * torch.randn(500, 2)
    depth, center = distance_inside(hull, query), hull_center(hull)
    shrink = edge_distance(hull, query)
    for world in range(500):
        theirs = ConvexHull(points[world, :count].double().numpy())
        ours = hull.edges[world].any(1).nonzero()[:, 0].tolist()
        assert sorted(theirs.vertices.tolist()) == ours
        # Each row of equations is an outward unit normal and an offset: n x + d <= 0 inside.
        signed = -(theirs.equations[:, :2] @ query[world].double().numpy() + theirs.equations[:, 2])
        assert shrink[world].item() == pytest.approx(signed.min(), abs=1e-5)
        if signed.min() >= 0:
            assert depth[world].item() == pytest.approx(signed.min(), abs=1e-5)
        else:
            assert depth[world] < 1e-6
        corners = theirs.points[theirs.vertices]
        following = np.roll(corners, -1, axis=0)
        cross = corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0]
        expected = ((corners + following) * cross[:, None]).sum(0) / (3 * cross.sum())
        np.testing.assert_allclose(center[world].numpy(), expected, atol=2e-4)


def test_square_with_points_on_its_edges_and_one_in_the_middle():
    points = torch.tensor([[0, 0], [2, 0], [2, 2], [0, 2], [1, 0], [2, 1], [1, 1], [0.5, 2]])
    hull = convex_hull(points, ALL)
    assert hull.edges.nonzero().tolist() == [[0, 1], [1, 2], [2, 3], [3, 0]]
    assert_close(hull_center(hull), torch.tensor([1.0, 1.0]))
    queries = torch.tensor([[1.0, 0.5], [1.0, -0.5], [3.0, 3.0], [2.0, 1.0]])
    many = convex_hull(points.expand(4, 8, 2), ALL.expand(4, 8))
    expected = torch.tensor([0.5, -0.5, -(2**0.5), 0.0])
    assert_close(distance_inside(many, queries), expected, atol=1e-6, rtol=0)


def test_points_on_a_line_a_single_one_and_none():
    line = torch.tensor([[0.0, 0], [1, 0], [3, 0], [2, 0], [0, 9], [0, 9], [0, 9], [0, 9]])
    counts = torch.tensor([4, 2, 1, 0])
    used = torch.arange(8) < counts[:, None]
    hull = convex_hull(line.expand(4, 8, 2), used)
    depth = distance_inside(hull, torch.tensor([[2.0, -0.5], [2, 0], [3, 4], [0, 0]]))
    assert_close(depth, torch.tensor([-0.5, -1.0, -5.0, -torch.inf]))
    beside = edge_distance(hull, torch.tensor([[2.0, -0.5], [2, 0.25], [3, 4], [0, 0]]))
    assert_close(beside, torch.tensor([-0.5, -0.25, -torch.inf, -torch.inf]))
    center = torch.tensor([[1.5, 0.0], [0.5, 0], [0, 0], [0, 0]])
    assert_close(hull_center(hull), center)


def test_corners_of_a_turned_sole():
    """Turned by 90 degrees about z, a corner in front (x) comes to lie to the left (y)."""
    half = 0.5**0.5
    feet = torch.tensor([[[0.0, 0.1, 0.0], [0.0, -0.1, 0.0]]])
    turned = torch.tensor([[[1.0, 0, 0, 0], [half, 0, 0, half]]])
    corners = sole_corners({"feet_position": feet, "feet_orientation": turned}, ZEROTH01)
    length, width = ZEROTH01.sole_half_size
    assert_close(corners[0, 0, 0], torch.tensor([length, 0.1 + width, 0.0]))
    assert_close(corners[0, 1, 0], torch.tensor([-width, -0.1 + length, 0.0]))


def test_standing_robot_has_its_center_of_mass_over_all_eight_corners(make_base):
    td = settled(make_base)
    hull = support_hull(td, ZEROTH01)
    assert hull.used.all()
    depth = distance_inside(hull, td["com_position"][:, :2])
    assert (depth > 0.02).all()
    inside = com_in_support(td, td, robot=ZEROTH01, margin=0.01)
    assert inside.tolist() == [[1.0], [1.0]]
    too_far = com_in_support(td, td, robot=ZEROTH01, margin=float(depth.max()) + 0.001)
    assert too_far.tolist() == [[0.0], [0.0]]


def test_no_double_support_no_reward(make_base):
    td = settled(make_base)
    td["feet_contact"] = torch.tensor([[True, True], [True, False]])
    assert com_in_support(td, td, robot=ZEROTH01, margin=0.01).tolist() == [[1.0], [0.0]]


@pytest.mark.parametrize("in_place", [True, False])
def test_the_polygon_is_that_of_now_also_when_asked_for_again(make_base, in_place):
    """The left foot of one world loses its load: the right sole is left, in place or anew."""
    td = settled(make_base)
    before = support_hull(td, ZEROTH01)
    assert support_hull(td, ZEROTH01) is before
    load = td["feet_corner_force"] if in_place else td["feet_corner_force"].clone()
    load[0, 0] = 0.0
    td["feet_corner_force"] = load
    after = support_hull(td, ZEROTH01)
    assert after.used.sum(-1).tolist() == [4, 8]
    assert torch.equal(after.points, before.points)
    with torch.inference_mode():
        assert support_hull(td.clone(), ZEROTH01).used.sum(-1).tolist() == [4, 8]
