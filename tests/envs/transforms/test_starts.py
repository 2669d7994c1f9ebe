"""How episodes begin."""

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from zfall.envs.humanoid import STATE_KEYS
from zfall.envs.make import make_env
from zfall.envs.terms.falls import body_contact
from zfall.envs.terms.support import sole_corners
from zfall.envs.transforms.actions import ActuatorDelay, JointPositionTarget
from zfall.envs.transforms.observations import ObservationVector
from zfall.envs.transforms.starts import NoisyStart, ReferenceStart, ScriptedStart
from zfall.falling.falling_start import FallingStart
from zfall.falling.files import own_file
from zfall.motions.library import load_motions
from zfall.robots import ZEROTH01
from zfall.rotations import rotate_inverse, tilt

ACTION = {"action": (JointPositionTarget, {"scale": 1.0})}


def test_noise_has_its_deviations_around_the_standing_pose(make_task):
    values = {"joint_position": 0.05, "joint_velocity": 0.3}
    env = make_task({**ACTION, "start": (NoisyStart, values)}, num_envs=512)
    check_env_specs(env)
    td = env.reset()
    error = td["joint_position"] - env.base_env.stand_position
    assert error.std().item() == pytest.approx(0.05, rel=0.05)  # 10240 draws: 7 sigma
    assert td["joint_velocity"].std().item() == pytest.approx(0.3, rel=0.05)
    low, high = env.base_env.joint_range.unbind(-1)
    assert ((td["joint_position"] >= low) & (td["joint_position"] <= high)).all()


def test_partial_reset_draws_the_same_stream_whoever_fell(make_task):
    """Two envs of one seed; in one of them worlds 0 and 1 reset before world 2 does."""
    starts = []
    for fallen in ([2], [0, 1, 2]):
        env = make_task({**ACTION, "start": (NoisyStart, {"joint_position": 0.05})}, num_envs=3)
        env.set_seed(4)
        td = env.reset()
        rows = torch.zeros(3, 1, dtype=torch.bool)
        rows[fallen] = True
        td["_reset"] = rows
        starts.append(env.reset(td)["joint_position"][2])
    assert torch.equal(starts[0], starts[1])


def reference(make_task, num_envs: int = 256, **values: object):
    return make_task({**ACTION, "start": (ReferenceStart, values)}, num_envs=num_envs)


def heading(quaternion: torch.Tensor) -> torch.Tensor:
    """Of an upright body [rad]."""
    return 2 * torch.atan2(quaternion[:, 3], quaternion[:, 0])


@pytest.mark.parametrize("turned", [False, True])
def test_reference_starts_are_states_of_the_motions_with_a_foot_at_rest_on_the_floor(
    make_task, turned
):
    env = reference(make_task, heading=turned)
    check_env_specs(env)
    td = env.reset()
    library = load_motions(ZEROTH01)
    states = {
        key: torch.cat([torch.from_numpy(motion.states[key]) for motion in library.values()])
        for key in library["standing"].states
    }
    gap = torch.cdist(td["joint_position"], states["joint_position"], p=1)
    gap += torch.cdist(td["joint_velocity"], states["joint_velocity"], p=1)
    nearest = gap.min(1)
    assert nearest.values.max() < 1e-3
    row = nearest.indices
    assert_close(td["base_angular_velocity"], states["base_angular_velocity"][row])
    seen, velocity = (
        rotate_inverse(orientation, speed)
        for orientation, speed in (
            (td["base_orientation"], td["base_linear_velocity"]),
            (states["base_orientation"][row], states["base_linear_velocity"][row]),
        )
    )
    assert_close(seen, velocity, atol=1e-5, rtol=0)
    assert tilt(td["base_orientation"]).max() < 1e-3
    angle = heading(td["base_orientation"])
    if turned:  # the mean of 256 random directions is rarely longer than 3 / sqrt(256)
        assert torch.polar(torch.ones(256), angle).mean().abs() < 0.19
    else:
        assert angle.abs().max() < 1e-6
    # MuJoCo's own speed of the lower foot, in the world: frames and signs must all be right.
    height, lower = td["feet_position"][..., 2].min(-1)
    assert_close(height, torch.zeros(256), atol=3e-4, rtol=0)
    rows = torch.arange(256)
    assert_close(td["feet_velocity"][rows, lower], torch.zeros(256, 3), atol=1e-4, rtol=0)
    assert_close(td["base_position"][:, :2], torch.zeros(256, 2))


def test_reference_starts_are_uniform_over_motions_and_phases(make_task):
    """Half of the starts stand; the rest spread evenly over six parts of the stride."""
    env = reference(make_task, 1536, motions=["standing", "forward_0.10"])
    td = env.reset()
    motion = torch.from_numpy(load_motions(ZEROTH01)["forward_0.10"].states["joint_position"])
    phase = torch.cdist(td["joint_position"], motion).min(1)
    walking = phase.values < 1e-3
    assert walking.float().mean().item() == pytest.approx(0.5, abs=0.05)  # 4 sigma
    stand = env.base_env.stand_position.expand(1536, 20)
    assert_close(td["joint_position"][~walking], stand[~walking])
    parts = torch.bincount(phase.indices[walking] // 10, minlength=6)
    expected = walking.sum() / 6
    assert ((parts - expected).square() / expected).sum() < 20.5  # chi2, 5 degrees, p = 0.001


def test_reference_noise_has_its_deviations_and_keeps_a_sole_on_the_floor(make_task):
    noise = {"joint_position": 0.05, "joint_velocity": 0.3}
    td = reference(make_task, motions=["standing"], **noise).reset()
    error = td["joint_position"] - torch.tensor(ZEROTH01.stand_position)
    assert error.std().item() == pytest.approx(0.05, rel=0.07)
    assert td["joint_velocity"].std().item() == pytest.approx(0.3, rel=0.07)
    td = reference(make_task, **noise).reset()
    corner = torch.tensor(ZEROTH01.sole_half_size).sum() * 0.4  # of a sole that leans by 0.4 rad
    height = td["feet_position"][..., 2].amin(-1)
    assert (height > 0).all()
    assert (height < corner).all()


def test_reference_starts_draw_the_same_stream_whoever_fell(make_task):
    starts = []
    for fallen in ([2], [0, 1, 2]):
        env = reference(make_task, 3, joint_position=0.05, heading=True)
        env.set_seed(4)
        td = env.reset()
        before = td["joint_position"].clone()
        rows = torch.zeros(3, 1, dtype=torch.bool)
        rows[fallen] = True
        td["_reset"] = rows
        td = env.reset(td)
        assert torch.equal(td["joint_position"][~rows[:, 0]], before[~rows[:, 0]])
        starts.append(torch.cat([td["joint_position"][2], td["base_orientation"][2]]))
    assert torch.equal(starts[0], starts[1])


def test_servos_can_halt_every_motion_they_start_in(make_task):
    """Close to dynamic stability: the standing pose as target catches the robot."""
    env = reference(make_task, 128, joint_position=0.05, joint_velocity=0.2)
    td, fell = env.reset(), torch.zeros(128, dtype=torch.bool)
    for _ in range(15):  # 0.6 s, two steps of the gaits
        td["action"] = torch.zeros(128, 20)
        td = env.step(td)["next"]
        fell |= body_contact(td, td)[:, 0]
    assert fell.sum() <= 2


@pytest.mark.parametrize(("values", "message"), [
    ({"motions": ["forward_0.10", "crawl"]}, r"motions must be of standing, .*, got crawl"),
    ({"motions": []}, r"motions must be of standing, .*, got none"),
    ({"joint_velocity": -1.0}, "joint_velocity must not be negative, got -1"),
])  # fmt: skip
def test_bad_reference_starts_are_refused(make_base, values, message):
    with pytest.raises(ValueError, match=message):
        ReferenceStart(make_base(), **values)


def test_scripted_start_is_the_state_given(make_task):
    position = torch.rand(4, 20) * 0.1
    speed = torch.rand(4, 3)
    states = {"joint_position": position, "base_linear_velocity": speed}
    td = make_task({**ACTION, "start": (ScriptedStart, {"states": states})}).reset()
    assert_close(td["joint_position"], position)
    assert_close(td["base_linear_velocity"], speed)


def test_unknown_state_is_refused(make_base):
    with pytest.raises(ValueError, match=r"states must be of joint_position.*got base_speed"):
        ScriptedStart(make_base(), states={"base_speed": torch.zeros(4, 3)})


def test_negative_noise_is_refused(make_base):
    with pytest.raises(ValueError, match="joint_velocity must not be negative, got -1"):
        NoisyStart(make_base(), joint_velocity=-1)


def lowest_corner(env, td) -> torch.Tensor:
    """Height of the lowest corner of the soles, from MuJoCo's own kinematics ``(N,)`` [m]."""
    base = env.base_env
    model, out = base.simulation.model, []
    half = torch.tensor([*base.robot.sole_half_size, 0.0], dtype=torch.float64)
    signs = torch.tensor([[x, y, 0.0] for x in (-1, 1) for y in (-1, 1)], dtype=torch.float64)
    for qpos in base.simulation.qpos.numpy():
        data = mujoco.MjData(model)
        data.qpos[:] = qpos
        mujoco.mj_kinematics(model, data)
        sites = (data.site(f"{foot}_sole") for foot in base.robot.feet)
        heights = [s.xpos[2] + (signs * half).numpy() @ s.xmat.reshape(3, 3)[2] for s in sites]
        out.append(min(h.min() for h in heights))
    return torch.tensor(out)


@pytest.mark.parametrize("clearance", [None, [0.01, 0.03]])
def test_soles_begin_on_the_floor_or_hang_as_high_over_it_as_was_asked(make_task, clearance):
    values = {"joint_position": 0.17, "joint_velocity": 1.5, "clearance": clearance}
    env = make_task({**ACTION, "start": (NoisyStart, values)}, num_envs=64)
    check_env_specs(env)
    height = lowest_corner(env, env.reset())
    if clearance is None:
        assert_close(height, torch.zeros(64).double(), atol=1e-6, rtol=0)
        return
    assert ((height > 0.01 - 1e-6) & (height < 0.03 + 1e-6)).all()
    assert height.mean().item() == pytest.approx(0.02, abs=0.003)  # 0.0058 / 8, 4 sigma
    assert height.std().item() == pytest.approx(0.02 / 12**0.5, rel=0.25)


def test_clearance_below_the_floor_is_on_it(make_task):
    env = make_task({**ACTION, "start": (NoisyStart, {"clearance": [-0.02, 0.02]})}, num_envs=400)
    height = env.reset()["base_position"][:, 2]
    on_floor = height < height.min() + 1e-6
    assert 150 < on_floor.sum() < 250  # half of them, 5 sigma
    assert height.max() - height.min() == pytest.approx(0.02, abs=1e-3)


def test_bad_clearance_is_refused(make_base):
    with pytest.raises(ValueError, match=r"clearance must be \[smallest, largest\], got"):
        NoisyStart(make_base(), clearance=[0.02, 0.01])


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


SEEN = {
    "target": np.linspace(-0.1, 0.1, 40, dtype="f4").reshape(2, 20),
    "feet_force": np.arange(12, dtype="f4").reshape(2, 6),
    "com_velocity": np.array([[0.7, 0.0, 0.0], [0.8, 0.0, 0.0]], "f4"),
}


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
