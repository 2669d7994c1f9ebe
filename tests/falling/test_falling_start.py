"""Episodes that begin in the midst of recorded falls."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close

from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.make import make_env
from zfall.envs.terms.support import sole_corners
from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget
from zfall.envs.transforms.estimation import JointVelocityKalmanFilter, MahonyFilter
from zfall.envs.transforms.observations import ObservationVector
from zfall.envs.transforms.starts import NoisyStart
from zfall.falling.falling_start import FallingStart
from zfall.falling.files import own_file
from zfall.robots import ZEROTH01

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}
SEEN = {
    "target": np.linspace(-0.1, 0.1, 40, dtype="f4").reshape(2, 20),
    "feet_force": np.arange(12, dtype="f4").reshape(2, 6),
    "com_velocity": np.array([[0.7, 0.0, 0.0], [0.8, 0.0, 0.0]], "f4"),
}


def test_falls_begin_as_recorded_and_the_others_stand(make_task):
    noisy, falling = (NoisyStart, {"joint_position": 0.02}), (FallingStart, {"share": 0.7})
    env = make_task({**ACTION, "start": noisy, "falling": falling}, num_envs=400)
    env.set_seed(0)
    td = env.reset()
    fallen = td["base_linear_velocity"].norm(dim=-1) > 0
    assert 0.6 < fallen.float().mean() < 0.8
    with np.load(own_file(ZEROTH01, "falls.npz")) as bank:
        recorded = torch.from_numpy(bank["joint_velocity"])
        assert bank["base_orientation"].shape[0] > 1000
    distance = torch.cdist(
        td["joint_velocity"][fallen],
        recorded,
        compute_mode="donot_use_mm_for_euclid_dist",
    ).amin(1)
    assert distance.max() < 1e-4
    corners = sole_corners(td[~fallen], ZEROTH01)[..., 2].flatten(1).amin(1)
    assert corners.abs().max() < 1e-3  # the others stand on the floor, whatever their noise


def test_worlds_in_a_row_begin_alike(make_task):
    """Ten worlds in threes: 0-2, 3-5, 6-8 and 9 alone; world 4, reset by itself, begins elsewhere."""
    env = make_task({**ACTION, "falling": (FallingStart, {"alike": 3})}, num_envs=10)
    env.set_seed(1)
    td = env.reset()
    joints = td["joint_velocity"].clone()
    same = (joints[:, None] == joints).all(-1)
    group = torch.arange(10) // 3
    assert torch.equal(same, group[:, None] == group)
    td["_reset"] = torch.arange(10)[:, None] == 4
    again = env.reset(td)["joint_velocity"]
    assert (again != joints).any(1).nonzero().tolist() == [[4]]


def test_each_world_may_have_its_own_share_of_falls(make_base):
    falling = FallingStart(make_base(num_envs=40))
    falling.share = torch.arange(40) % 2  # as a curriculum would set it
    start = falling._reset_env_preprocess(TensorDict(batch_size=[40]))["start"]
    fallen = start["base_linear_velocity"].norm(dim=-1) > 0
    assert torch.equal(fallen, falling.share > 0)


@pytest.fixture
def pushed_falls(make_task, tmp_path):
    """Worlds in the air, so that the push alone moves them; a third are not pushed any more."""
    bank = tmp_path / "falls.npz"
    with np.load(own_file(ZEROTH01, "falls.npz")) as file:
        states = {key: file[key][:1].repeat(3, 0) for key in STATE_KEYS}
    states["base_position"] += [0.0, 0.0, 1.0]
    force = np.array([[30.0, -10.0, 0.0], [0.0, 20.0, 0.0], [0.0] * 3], "f4")
    states["target"] = np.tile(np.array(ZEROTH01.stand_position, "f4"), (3, 1))
    states |= {"feet_force": np.zeros((3, 6), "f4"), "com_velocity": np.zeros((3, 3), "f4")}
    np.savez(bank, push_force=force, push_left=np.array([[0.052], [0.052], [0.0]], "f4"), **states)
    env = make_task(
        {**ACTION, "falling": (FallingStart, {"bank": str(bank), "pushed": True})}, num_envs=64
    )
    env.set_seed(0)
    return env, next(t for t in env.transform if isinstance(t, FallingStart))


def test_what_is_left_of_a_push_goes_on_and_moves_the_robot_by_its_impulse(pushed_falls):
    """0.052 s are 13 physics steps, ten of them in the first control step."""
    env, falling = pushed_falls
    td, force = env.reset(), falling.force.clone()
    still = force.norm(dim=-1) == 0
    assert 10 < still.sum() < 54
    for seconds, to_come in ((0.036, 0.052), (0.052, 0.012), (0.052, 0.0)):
        # Sensors are a physics step older.
        assert_close(td["falling_impulse"], force * to_come)
        td = env.step(td.set("action", torch.zeros(64, 20)))["next"]
        momentum = td["linear_momentum"]
        gained = momentum - momentum[still].mean(0)
        assert_close(gained, force * seconds, atol=0.06, rtol=0)  # a physics step of 30 N: 0.12
        if seconds == 0.036:  # what acted in the first control step: all of it at the torso
            impulse = 0.004 * env.base_env.simulation.wrench.float().sum(1)
            torso = impulse[:, env.base_env.push_targets["torso"], :3]
            assert_close(torso, force * 0.04)
            assert_close(impulse.abs().sum((1, 2)), torso.abs().sum(1))
    ground = td["linear_momentum"][:, :2].norm(dim=-1, keepdim=True) / env.base_env.mass
    assert_close(td["falling_speed"], ground, atol=0.02, rtol=0)  # as said in the beginning
    assert ground.std() > 0.1


def test_a_partial_reset_leaves_the_pushes_of_the_others(pushed_falls):
    env, falling = pushed_falls
    td = env.reset()
    td = env.step(td.set("action", torch.zeros(64, 20)))["next"]
    force, left = falling.force.clone(), falling.left.clone()
    speed = td["falling_speed"].clone()
    assert_close(left[left > 0], torch.full_like(left[left > 0], 0.012))
    new = torch.arange(64) % 2 == 0
    saved = falling.state_dict()
    after = env.reset(td.set("_reset", new[:, None]))
    assert torch.equal(after["falling_speed"][~new], speed[~new])
    assert not torch.equal(after["falling_speed"][new], speed[new])
    assert torch.equal(falling.speed[~new], speed[~new])  # what later steps will say
    assert torch.equal(falling.force[~new], force[~new])
    assert torch.equal(falling.left[~new], left[~new])
    assert {round(x, 3) for x in falling.left[new, 0].tolist()} == {0.0, 0.052}
    assert (falling.left[new & (left[:, 0] > 0)] == 0).any()
    assert sorted(saved) == ["force", "left", "speed"]  # a resumed run goes on pushing


@pytest.fixture
def seen_falls(tmp_path):
    """Writes two falls and what was seen in them, some of it replaced."""

    def write(**values):
        with np.load(own_file(ZEROTH01, "falls.npz")) as file:
            states = {key: file[key][:2] for key in STATE_KEYS}
        np.savez(tmp_path / "seen.npz", **{**states, **SEEN, **values})
        return str(tmp_path / "seen.npz")

    return write


@pytest.mark.parametrize("share", [1.0, 0.5])
def test_what_was_seen_in_a_fall_is_seen_again(make_task, seen_falls, share):
    """Target, force and velocity are of the bank in falls, of the reset in worlds that stand."""
    falling = (FallingStart, {"bank": seen_falls(), "share": share})
    env = make_task({**ACTION, "falling": falling}, num_envs=64)
    env.set_seed(0)

    def check(td, rows):
        fallen = rows & (td["base_linear_velocity"].norm(dim=-1) > 0)
        row = (td["com_velocity"][:, 0] > 0.75).long()
        assert 0 < row[fallen].sum() < fallen.sum()
        for key, values in SEEN.items():
            was = torch.from_numpy(values)[row].view_as(td[key])
            assert torch.equal(td[key][fallen], was[fallen])
        stand = torch.tensor(ZEROTH01.stand_position)
        stands = rows & ~fallen
        assert_close(td["target"][stands], stand.expand(int(stands.sum()), -1))
        assert (td["com_velocity"][stands].abs() < 1e-6).all()
        return fallen

    td = env.reset().clone()
    fallen = check(td, torch.ones(64, dtype=torch.bool))
    assert fallen.all() if share == 1.0 else 16 < fallen.sum() < 48
    new = torch.arange(64) % 2 == 0
    for key in SEEN:
        td[key][:] = 3.0
    after = env.reset(td.set("_reset", new[:, None]))
    check(after, new)
    for key in SEEN:
        assert (after[key][~new] == 3.0).all()


def test_estimators_begin_with_what_they_had_made_of_the_fall(make_base, seen_falls):
    """Gravity as it was 0.1 rad before, joints that seem to rest; elsewhere the truth."""
    late = np.array([[0.0, 0.0998334, -0.9950042]] * 2, "f4")
    rest = np.zeros((2, 20), "f4")
    bank = seen_falls(measured_gravity=late, measured_joint_velocity=rest)
    base = make_base(num_envs=40)
    table = {
        "falling": FallingStart(base, bank=bank, share=0.5),
        "action": JointPositionTarget(base, scale=1.0),
        "tilt": MahonyFilter(base, also=["projected_gravity"]),
        "speed": JointVelocityKalmanFilter(base),
    }
    env = make_env(base, table)
    env.set_seed(0)
    td = env.reset()
    falls = (td["com_velocity"][:, :1] > 0.5).expand(-1, 3)
    assert 0 < falls[:, 0].sum() < 40
    wanted = torch.where(falls, torch.from_numpy(late[:1]), td["projected_gravity"])
    assert_close(td["measured", "projected_gravity"], wanted, atol=1e-5, rtol=0)
    wanted = torch.where(falls[:, :1], 0.0, td["joint_velocity"])
    assert_close(td["measured", "joint_velocity"], wanted)
    td["action"] = torch.zeros(40, 20)
    after = env.step(td)["next"]  # and goes on from there: the gyro turns both alike
    behind = (after["measured", "projected_gravity"] - after["projected_gravity"]).norm(dim=-1)
    assert (behind[falls[:, 0]] > 0.05).all()
    assert (behind[~falls[:, 0]] < 0.02).all()


def test_servos_follow_the_recorded_target_until_commands_arrive(make_task, seen_falls):
    """Commands 8 ms late reach the servos in the third physics step of the first control step."""
    env = make_task(
        {
            "falling": (FallingStart, {"bank": seen_falls()}),
            **ACTION,
            "delay": (ActuatorDelay, {"delay": (0.008, 0.008)}),
        },
        num_envs=8,
    )
    env.set_seed(0)
    recorded = env.reset()["target"]
    assert recorded.unique(dim=0).shape[0] == 2
    delay = next(t for t in env.transform if isinstance(t, ActuatorDelay))
    control = delay._inv_call(TensorDict({"target": torch.full((8, 20), 0.5)}, [8]))["control"]
    assert torch.equal(control[:, :2], recorded[:, None].expand(-1, 2, -1))
    assert (control[:, 2:] == 0.5).all()


def test_what_reads_what_was_seen_comes_after_it(make_base, seen_falls):
    sees = ObservationVector(keys=["com_velocity"], out_key="observation", measured=True)
    base = make_base()
    falling = FallingStart(base, bank=seen_falls())
    with pytest.raises(ValueError, match="falling must come before sees, which reads com_velocity"):
        make_env(base, {"sees": sees, "falling": falling})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"feet_force": np.zeros((3, 6), "f4")}, "2 rows of numbers under every key.* feet_force"),
        ({"target": np.full((2, 20), np.nan, "f4")}, "2 rows of numbers under every key.* target"),
        ({"target": np.zeros((2, 19), "f4")}, "has other joints"),
    ],
)
def test_a_bank_that_does_not_fit_together_is_refused(make_base, seen_falls, values, message):
    with pytest.raises(ValueError, match=message):
        FallingStart(make_base(), bank=seen_falls(**values))


def test_a_bank_without_pushes_cannot_have_them_go_on(make_base, tmp_path):
    bank = tmp_path / "falls.npz"
    with np.load(own_file(ZEROTH01, "falls.npz")) as file:
        np.savez(bank, **{key: file[key] for key in STATE_KEYS})
    FallingStart(make_base(), bank=str(bank))
    with pytest.raises(ValueError, match="lacks push_force"):
        FallingStart(make_base(), bank=str(bank), pushed=True)
    with pytest.raises(ValueError, match="for pushed=true, got null"):
        FallingStart(make_base(), pushed=True)


def test_a_missing_bank_of_falls_is_refused(make_base):
    with pytest.raises(ValueError, match="bank must be a file that recipes.falling.falls wrote"):
        FallingStart(make_base(), bank="nowhere.npz")
    with pytest.raises(ValueError, match="share must lie in"):
        FallingStart(make_base(), share=0.0)
    with pytest.raises(ValueError, match="alike must be a whole number, at least 1, got 0"):
        FallingStart(make_base(), alike=0)
