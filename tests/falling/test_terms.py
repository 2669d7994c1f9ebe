"""Terms of kneeling by hand, and the keyframe that they aim at."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict

from zfall.envs.terms import bind
from zfall.falling import terms
from zfall.robots import ZEROTH01
from zfall.rotations import tilt

R = len(ZEROTH01.regions)


def contact(*regions: str) -> TensorDict:
    force = torch.zeros(1, R)
    for region in regions:
        force[0, ZEROTH01.regions.index(region)] = 3.0
    return TensorDict({"contact_force_peak": force}, batch_size=[1])


def test_regions_are_found_on_both_sides():
    names = [ZEROTH01.regions[i] for i in terms.regions_named(ZEROTH01, "knee", "shin")]
    assert sorted(names) == ["left_knee", "left_shin", "right_knee", "right_shin"]
    assert terms.touching(contact("right_shin"), ZEROTH01, "shin").item()
    assert not terms.touching(contact("right_foot"), ZEROTH01, "shin").item()


def test_lowering_is_the_share_of_a_third_of_the_height():
    h0 = ZEROTH01.com_height
    for height, value in ((1.1 * h0, 0.0), (h0, 0.0), (5 / 6 * h0, 0.5), (0.5 * h0, 1.0)):
        td = TensorDict({"com_position": torch.tensor([[0.0, 0.0, height]])}, batch_size=[1])
        term = terms.com_lowering(td, td, robot=ZEROTH01)
        assert term.item() == pytest.approx(value, abs=1e-5)


def test_shocks_count_from_rest_on():
    for peak, value in ((9.81, 1.0), (29.81, 0.367879), (0.0, 0.786)):
        td = TensorDict({"base_acceleration_peak": torch.tensor([[peak]])}, batch_size=[1])
        term = terms.controlled_descent(td, td, sigma=20.0)
        assert term.item() == pytest.approx(value, abs=1e-3)


def test_a_landing_is_harder_by_what_it_adds_to_the_hardest_shock():
    before, after = (
        TensorDict({"base_acceleration_max": torch.tensor(x)[:, None]}, [4])
        for x in ([9.81, 60.0, 95.0, 215.0], [75.0, 130.0, 140.0, 215.0])
    )
    term = terms.harder_landing(before, after, free=80.0)
    assert term.flatten().tolist() == [0.0, 50.0, 45.0, 0.0]


def test_a_blow_is_harder_by_what_it_adds_to_the_hardest_on_those_regions():
    torso, head, hand = (ZEROTH01.regions.index(name) for name in ("torso", "head", "left_hand"))
    force = torch.zeros(2, 3, R)  # before and after a step, three worlds
    force[0, :, torso] = torch.tensor([0.0, 50.0, 50.0])
    force[1, :, torso] = torch.tensor([0.0, 50.0, 50.0])
    force[1, :, head] = torch.tensor([0.0, 30.0, 80.0])
    force[1, :, hand] = 900.0
    before, after = (TensorDict({"contact_force_max": f}, [3]) for f in force)
    term = terms.harder_blow(before, after, robot=ZEROTH01, names=["torso", "head"])
    assert term.flatten().tolist() == [0.0, 0.0, 30.0]
    # The head touches after the torso did: no first touch. The hand does not count.
    first = terms.first_touch(before, after, robot=ZEROTH01, names=["torso", "head"])
    assert first.flatten().tolist() == [0.0, 0.0, 0.0]
    of_head = terms.first_touch(before, after, robot=ZEROTH01, names=["head"])
    assert of_head.flatten().tolist() == [0.0, 1.0, 1.0]


def test_a_kneel_is_clean_if_torso_and_head_never_touched():
    """Four worlds: on a knee, so after the head touched, on the torso as well, on no knee."""
    size = [4, R]
    now, ever = torch.zeros(size), torch.zeros(size)
    now[:3, ZEROTH01.regions.index("left_knee")] = 9.0
    now[2, ZEROTH01.regions.index("torso")] = 9.0
    ever[1, ZEROTH01.regions.index("head")] = 9.0
    ever = torch.maximum(ever, now)
    td = TensorDict(
        {
            "contact_force_peak": now,
            "contact_force_max": ever,
            "base_orientation": torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(4, 4),
            "base_linear_velocity": torch.full((4, 3), 0.5),
            "base_angular_velocity": torch.zeros(4, 3),
            "joint_velocity": torch.full((4, 20), 5.0),
        },
        [4],
    )
    bounds = {"robot": ZEROTH01, "speed": 2.0, "joint_speed": torch.inf}
    assert terms.kneeling(td, td, **bounds).flatten().tolist() == [1.0, 1.0, 0.0, 0.0]
    assert terms.kneeling(td, td, clean=True, **bounds).flatten().tolist() == [1.0, 0.0, 0.0, 0.0]
    assert not terms.kneeling(td, td, **(bounds | {"speed": 0.5})).any()  # 0.87 m/s
    assert not terms.kneeling(td, td, **(bounds | {"joint_speed": 4.0})).any()


def test_turning_counts_in_all_axes():
    td = TensorDict({"base_angular_velocity": torch.tensor([[0.0, 1.2, -1.6]])}, batch_size=[1])
    term = terms.low_angular_rate(td, td, sigma=2.0)
    assert term.item() == pytest.approx(0.367879, abs=1e-5)


def test_a_kneel_may_be_on_either_side():
    pose = torch.tensor([ZEROTH01.posture("kneel")])
    other = pose[:, list(ZEROTH01.mirror_index)] * torch.tensor(ZEROTH01.mirror_sign)
    stand = torch.tensor([ZEROTH01.stand_position])
    near = [
        terms.kneel_pose(td, td, robot=ZEROTH01, sigma=1.4).item()
        for td in (TensorDict({"joint_position": q}, batch_size=[1]) for q in (pose, other, stand))
    ]
    assert near[0] == near[1] == 1.0
    assert near[2] < 0.3
    assert not torch.allclose(pose, other)


def test_a_term_counts_in_its_mode_alone():
    def one(td, next_td):
        return torch.ones(3, 1)

    td = TensorDict({"mode": torch.eye(3)}, batch_size=[3])
    value = terms.in_mode(td, td, mode=1, term=one)
    assert value[:, 0].tolist() == [0.0, 1.0, 0.0]
    touched = partial(terms.region_contact_ends, names=["hand"])
    hands = TensorDict(
        {"mode": torch.eye(3), "contact_force_peak": torch.ones(3, R)}, batch_size=[3]
    )
    ends = bind(partial(terms.in_mode, mode=1, term=touched), robot=ZEROTH01)(hands, hands)
    assert ends.dtype == torch.bool
    assert ends[:, 0].tolist() == [False, True, False]


def test_a_mode_that_the_machine_has_not_is_refused():
    td = TensorDict({"mode": torch.eye(3)}, batch_size=[3])
    for term in (
        partial(terms.in_mode, term=lambda td, after: torch.ones(3, 1)),
        terms.entered_mode,
    ):
        with pytest.raises(ValueError, match="mode must be below 3 without rise, got 3"):
            term(td, td, mode=3)


def test_a_term_counts_in_slow_falls_alone():
    td = TensorDict(
        {
            "falling_speed": torch.tensor([[2.3], [2.4], [5.0]]),
            "contact_force_max": torch.zeros(3, R),
        },
        batch_size=[3],
    )
    after = td.clone().set("contact_force_max", torch.ones(3, R))
    touch = partial(terms.first_touch, names=["torso", "head"])
    term = bind(partial(terms.in_slow_fall, below=2.4, term=touch), robot=ZEROTH01)
    assert term(td, after)[:, 0].tolist() == [1.0, 0.0, 0.0]
    assert term(td, after.exclude("falling_speed"))[:, 0].tolist() == [1.0, 1.0, 1.0]


def test_entering_a_mode_counts_once():
    before = TensorDict({"mode": torch.eye(3)[[1, 2, 0]]}, batch_size=[3])
    after = TensorDict({"mode": torch.eye(3)[[2, 2, 1]]}, batch_size=[3])
    assert terms.entered_mode(before, after, mode=2)[:, 0].tolist() == [1.0, 0.0, 0.0]
    assert terms.entered_mode_ends(before, after, mode=2)[:, 0].tolist() == [True, False, False]


def test_the_servos_hold_the_keyframe_for_ten_seconds_under_noise(make_base):
    """31 copies with 1 degree of noise on all targets, and one without."""
    env = make_base(num_envs=32)
    key = env.simulation.model.key("kneel")
    pose = torch.tensor(ZEROTH01.posture("kneel"))
    generator = torch.Generator().manual_seed(0)
    noise = 0.0175 * torch.randn(32, 20, generator=generator)
    noise[0] = 0.0
    target = (pose + noise).clamp(*env.joint_range.unbind(-1))
    start = {
        "joint_position": target,
        "base_position": torch.tensor(key.qpos[:3]).float().expand(32, -1),
        "base_orientation": torch.tensor(key.qpos[3:7]).float().expand(32, -1),
    }
    env.reset(TensorDict({("start", k): v for k, v in start.items()}, batch_size=[32]))
    for _ in range(round(10.0 / env.control_dt)):
        td = env.step(TensorDict({"target": target}, batch_size=[32]))["next"]
    rests = terms.resting_kneel(td, td, robot=ZEROTH01)
    free = ~terms.touching(td, ZEROTH01, "hand", "arm", "thigh")
    upright = tilt(td["base_orientation"])[:, None] < 0.35
    held = rests & free & upright
    assert held[0].item()
    assert held.float().mean() > 0.9
    assert td["com_position"][0, 2] == pytest.approx(0.140, abs=0.005)
    drift = (torch.tensor(key.qpos[2:7]).float() - env.simulation.qpos[0, 2:7].float()).abs().max()
    assert drift < 0.02  # the keyframe is where it rests
    low, high = env.joint_range.unbind(-1)
    assert ((pose >= low) & (pose <= high)).all()
