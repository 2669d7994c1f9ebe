"""The hardest shock so far against a list of all of them."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.windows import LargestSoFar
from zfall.falling.terms import harder_landing

KEYS = {"base_acceleration_peak": "base_acceleration_max"}


def test_largest_is_that_of_a_list_with_resets_in_between(make_base, play):
    """A reset is no shock; and what each step adds to the largest sums up to it."""
    torch.manual_seed(2)
    peak = 300.0 * torch.rand(40, 3)
    resets = {k: torch.rand(3) < 0.5 for k in (4, 5, 20, 31)}
    frames = [{"base_acceleration_peak": p[:, None]} for p in peak]
    out = play(LargestSoFar(make_base(num_envs=3), keys=KEYS), frames, resets)
    found = torch.stack([td["base_acceleration_max"] for td in out])[..., 0]
    begin, cost = torch.zeros(3, dtype=torch.long), torch.zeros(3)
    for k in range(1, 40):
        again = resets.get(k, torch.zeros(3, dtype=torch.bool))
        begin[again], cost[again] = k, 0.0
        # The step into a reset ends the episode before it.
        paid = harder_landing(out[k - 1], out[k], free=80.0)[:, 0]
        cost += torch.where(again, 0.0, paid)
        for world in range(3):
            seen = peak[begin[world] + 1 : k + 1, world]
            assert found[k, world] == (seen.max() if len(seen) else 0.0)
        assert torch.allclose(cost, (found[k] - 80.0).clamp_min(0.0), atol=1e-3)


def test_what_is_not_a_number_leaves_it(make_base, play):
    frames = [{"base_acceleration_peak": torch.tensor([[x]])} for x in (9.8, 50.0, torch.nan, 40.0)]
    out = play(LargestSoFar(make_base(num_envs=1), keys=KEYS), frames)
    assert [td["base_acceleration_max"].item() for td in out] == [0.0, 50.0, 50.0, 50.0]


def test_specs_hold(make_task):
    env = make_task(
        {"action": (JointPositionTarget, {"scale": 0.6}), "shock": (LargestSoFar, {"keys": KEYS})}
    )
    check_env_specs(env)


def test_keys_that_nobody_measures_are_refused(make_base):
    with pytest.raises(ValueError, match="at least one quantity"):
        LargestSoFar(make_base(), keys={})
    with pytest.raises(ValueError, match="of the base env, got shock"):
        LargestSoFar(make_base(), keys={"shock": "largest_shock"})
    with pytest.raises(ValueError, match="a row, got feet_corner_force"):
        LargestSoFar(make_base(), keys={"feet_corner_force": "corner_force_max"})
    for keys in (
        {"contact_force_peak": "base_position"},
        {"contact_force_peak": "peak", "base_acceleration_peak": "peak"},
    ):
        with pytest.raises(ValueError, match="names of their own, (base_position|peak) is taken"):
            LargestSoFar(make_base(), keys=keys)
