"""Lost messages."""

import pytest
import torch

from zfall.envs.transforms.observations import ObservationDropout

KEYS = ["joint_position", "base_angular_velocity"]


def values(step: int) -> dict[str, torch.Tensor]:
    """All components tell the step."""
    return {
        "joint_position": torch.full((512, 20), float(step)),
        "base_angular_velocity": torch.full((512, 3), float(step)),
    }


def test_lost_messages_have_their_rate_and_hold_the_last_one_of_the_whole_group(make_base, measure):
    dropout = ObservationDropout(make_base(num_envs=512), probability=0.3, keys=KEYS)
    held = measure(dropout, reset=True, **values(0))
    assert (held == 0).all()
    lost = 0
    for step in range(1, 21):
        got = measure(dropout, **values(step))
        arrived = got[:, 0] == step
        assert torch.equal(got, torch.where(arrived[:, None], float(step), held))
        gyro = dropout.held_base_angular_velocity
        assert torch.equal(gyro, got[:, :1].expand(-1, 3))  # the group shares its fate
        lost += int((~arrived).sum())
        held = got
    assert lost / 10240 == pytest.approx(0.3, abs=5 * (0.3 * 0.7 / 10240) ** 0.5)


def test_measurement_of_a_reset_always_arrives_and_others_are_held(make_base, measure):
    dropout = ObservationDropout(make_base(num_envs=512), probability=0.99, keys=KEYS)
    measure(dropout, reset=True, **values(1))
    rows = torch.arange(512)[:, None] % 2 == 0
    after = measure(dropout, reset=True, rows=rows, **values(2))
    assert (after[::2] == 2).all()
    assert (after[1::2] == 1).all()


@pytest.mark.parametrize(
    ("probability", "keys", "message"),
    [
        (1.0, KEYS, r"probability must lie in \[0, 1\), got 1.0"),
        (-0.1, KEYS, r"probability must lie in \[0, 1\), got -0.1"),
        (0.1, [], r"keys must name at least one quantity, got none"),
        (0.1, ["gyro"], r"keys must name quantities of the base env \(.*\), got gyro"),
    ],
)
def test_bad_value_is_refused_by_name_and_rule(make_base, probability, keys, message):
    with pytest.raises(ValueError, match=message):
        ObservationDropout(make_base(), probability=probability, keys=keys)
