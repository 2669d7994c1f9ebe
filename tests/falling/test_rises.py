"""Movements that get up: as a table, as a file, and as targets over time."""

import pytest
import torch
from torch.testing import assert_close

from zfall.falling.lying import POSTURES
from zfall.falling.making import SearchedRises
from zfall.falling.rises import Rises, load_rises, save_rises, written_rises
from zfall.robots import ZEROTH01

HIP, YAW, OTHER = (
    ZEROTH01.joints.index(name) for name in ("left_hip_pitch", "left_hip_yaw", "right_hip_yaw")
)
STAND = torch.tensor(ZEROTH01.stand_position)


def table(**changes) -> dict[str, dict[str, object]]:
    """A movement for each posture, of its name; values of one may be changed."""
    keyframes = [{"seconds": 1.0, "left_hip_pitch": -1.0}]
    movement = {"goal": "belly", "keyframes": keyframes}
    return {name: movement | {"posture": name} | changes.get(name, {}) for name in POSTURES}


def test_targets_go_from_keyframe_to_keyframe_in_straight_lines():
    """Of one joint: from 0 in 1 s to -1, in 0.5 s more to +1, where it stays."""
    angles = torch.zeros(1, 3, 20)
    angles[0, :, HIP] = torch.tensor([-1.0, 1.0, 1.0])
    none = torch.empty(0)
    rises = Rises(("one",), none, none, none, angles, torch.tensor([[1.0, 1.5, 1.5]]))
    for time, angle in (
        (0.0, 0.0),
        (0.25, -0.25),
        (1.0, -1.0),
        (1.25, 0.0),
        (1.5, 1.0),
        (9.0, 1.0),
    ):
        target = rises.target(torch.tensor([0]), torch.zeros(1, 20), torch.tensor([time]))
        assert target[0, HIP].item() == pytest.approx(angle, abs=1e-6)
        assert rises.over(torch.tensor([0]), torch.tensor([time])).item() == (time >= 1.5)


def test_a_keyframe_keeps_what_it_does_not_name_and_mirrors_a_joint_without_its_side():
    keyframes = [{"seconds": 0.4, "hip_yaw": 0.3}, {"seconds": 0.6, "left_hip_pitch": -1.2}]
    written = written_rises(ZEROTH01, table(belly={"keyframes": keyframes}))
    first, last = written.keyframes[POSTURES.index("belly")]
    assert (first[YAW].item(), first[OTHER].item()) == pytest.approx((0.3, -0.3))
    assert_close(last[[YAW, OTHER]], first[[YAW, OTHER]])
    assert last[HIP].item() == pytest.approx(-1.2)
    rest = [i for i in range(20) if i not in (HIP, YAW, OTHER)]
    assert_close(last[rest], STAND[rest])
    assert written.ends[POSTURES.index("belly")].tolist() == pytest.approx([0.4, 1.0])
    # A shorter movement stays at its last keyframe.
    assert written.ends[0].tolist() == pytest.approx([1.0, 1.0])
    assert torch.equal(written.keyframes[0, 0], written.keyframes[0, 1])


@pytest.mark.parametrize(
    ("belly", "message"),
    [
        ({"keyframes": []}, "movements.belly.keyframes must hold at least one"),
        ({"keyframes": [{"seconds": 0.0}]}, r"movements.belly.keyframes\[0\] must have positive"),
        ({"keyframes": [{"seconds": 1.0, "tail": 1.0}]}, r"must name joints of .* got tail"),
        ({"begins": {"tail": 1.0}}, r"movements.belly.begins must name joints of .* got tail"),
        ({"goal": "hover"}, "movements.belly.goal must be one of stand, belly, got hover"),
        ({"posture": "back"}, "movements must have one for each posture, got none for belly"),
    ],
)
def test_a_table_that_says_no_movement_is_refused(belly, message):
    with pytest.raises(ValueError, match=message):
        written_rises(ZEROTH01, table(belly=belly))


def test_of_the_movements_for_a_posture_the_one_that_begins_nearest_is_chosen():
    """Sitting, both hips at -1.4, and kneeling, both at 0.6: the middle is -0.4."""
    both = table(kneel={"begins": {"hip_pitch": 0.6}})
    both["sit"] = both["kneel"] | {"begins": {"hip_pitch": -1.4}}
    rises = written_rises(ZEROTH01, both)
    joints = STAND.repeat(4, 1)
    for world, angle in enumerate((-1.2, -0.5, -0.3, -1.2)):
        joints[world, [HIP, ZEROTH01.mirror_index[HIP]]] = angle
    postures = torch.tensor([POSTURES.index(name) for name in ("kneel", "kneel", "kneel", "belly")])
    chosen = [rises.names[i] for i in rises.choose(postures, joints)]
    assert chosen == ["sit", "sit", "kneel", "belly"]


def test_files_are_read_as_they_were_written_and_others_are_refused(tmp_path):
    rises = written_rises(ZEROTH01, table())
    save_rises(tmp_path / "rises.npz", rises)
    again = load_rises(ZEROTH01, tmp_path / "rises.npz")
    assert again.names == rises.names
    for one, other in zip(again[1:], rises[1:], strict=True):
        assert_close(one, other, equal_nan=True)
    for name, wrong, message in (
        ("short", rises._replace(keyframes=rises.keyframes[:4]), "other joints or movements"),
        ("fast", rises._replace(ends=-rises.ends), "finite angles at rising times"),
        ("poor", rises._replace(posture=rises.posture * 0), "a movement for each posture"),
    ):
        save_rises(tmp_path / f"{name}.npz", wrong)
        with pytest.raises(ValueError, match=message):
            load_rises(ZEROTH01, tmp_path / f"{name}.npz")
    with pytest.raises(ValueError, match="rises must be a file that recipes.falling.rises wrote"):
        load_rises(ZEROTH01, tmp_path / "none.npz")


def test_what_is_searched_may_be_faster_than_it_was_known():
    """One movement at 0.8 of its time; the others, and all keyframes, as they are."""
    known, faster = load_rises(ZEROTH01), SearchedRises(searched=["belly"], pace=0.8).known
    number = known.names.index("belly")
    assert_close(faster.ends[number], 0.8 * known.ends[number])
    others = [k for k in range(len(known.names)) if k != number]
    assert torch.equal(faster.ends[others], known.ends[others])
    assert torch.equal(faster.keyframes, known.keyframes)
    with pytest.raises(ValueError, match="pace must be positive, got 0"):
        SearchedRises(pace=0.0)
