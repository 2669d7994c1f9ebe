"""Clips, scales and histories in the orders of other frameworks."""

from collections import deque

import pytest
import torch
from torch.testing import assert_close
from torchrl.envs import step_mdp

from zfall.envs.make import make_env
from zfall.envs.transforms.foreign import ForeignJointTarget, ForeignObservation
from zfall.envs.transforms.foreign.terms import JointVelocity, PreviousAction, ProjectedGravity

JOINTS = ["left_knee_pitch", "right_hip_pitch"]
STEPS = 3


@pytest.fixture
def frames(make_base):
    """Runs an env with two terms; the terms of each step, and each observation."""

    def run(num_envs=2, again=None, **values):
        base = make_base(num_envs=num_envs)
        entries = [{"of": ProjectedGravity()}, {"of": JointVelocity(), "scale": 0.5}]
        see = ForeignObservation(base, joints=JOINTS, terms=values.pop("terms", entries), **values)
        env = make_env(
            base, {"action": ForeignJointTarget(base, joints=JOINTS, scale=0.3), "observation": see}
        )
        torch.manual_seed(0)
        td = env.reset()
        seen, out = [], []
        places = [base.robot.joints.index(name) for name in JOINTS]
        for step in range(6):
            if step == again:
                td["_reset"] = torch.tensor([True, False])[:, None]
                td = env.reset(td)
            seen.append((td["projected_gravity"], 0.5 * td["joint_velocity"][:, places]))
            out.append(td["observation"])
            td = step_mdp(env.step(td.set("action", torch.randn(num_envs, 2))))
        return seen, out

    return run


def stacked(seen, world, fill):
    """By a deque, as its frameworks keep it: terms of the last steps, the oldest first."""
    kept = deque([fill(seen[0], world)] * STEPS, maxlen=STEPS)
    for terms in seen:
        kept.append([term[world] for term in terms])
        yield list(kept)


def repeat(terms, world):
    return [term[world] for term in terms]


def zeros(terms, world):
    return [torch.zeros_like(term[world]) for term in terms]


def test_isaac_lab_and_mjlab_line_up_the_history_of_each_term(frames):
    seen, out = frames(history=STEPS)
    for step, kept in enumerate(stacked(seen, 0, repeat)):
        by_term = [torch.cat(list(history)) for history in zip(*kept, strict=True)]
        assert_close(out[step][0], torch.cat(by_term))


def test_legged_gym_lines_up_whole_frames_after_zeros(frames):
    seen, out = frames(history=STEPS, stack="frames", start="zeros")
    for step, kept in enumerate(stacked(seen, 0, zeros)):
        assert_close(out[step][0], torch.cat([torch.cat(frame) for frame in kept]))


def test_playground_rolls_the_newest_frame_to_the_front(frames):
    seen, out = frames(history=STEPS, stack="frames", oldest="last", start="zeros")
    size = 5
    history = torch.zeros(STEPS * size)
    for step, terms in enumerate(seen):
        history = torch.roll(history, size)
        history[:size] = torch.cat([term[0] for term in terms])
        assert_close(out[step][0], history)


def test_a_world_that_begins_again_forgets_and_the_others_do_not(frames):
    seen, out = frames(history=STEPS, again=3)
    begun = [[term[0] for term in terms] for terms in seen[3:4]] * STEPS
    assert_close(out[3][0], torch.cat([torch.cat(list(h)) for h in zip(*begun, strict=True)]))
    *_, kept = stacked(seen[:4], 1, repeat)
    assert_close(out[3][1], torch.cat([torch.cat(list(h)) for h in zip(*kept, strict=True)]))


def test_a_term_is_clipped_before_it_is_scaled_and_the_vector_after(frames):
    seen, out = frames(
        terms=[{"of": JointVelocity(), "scale": [2.0, 4.0], "clip": [-0.1, 0.1]}], clip=[-0.3, 0.3]
    )
    speeds = 2.0 * seen[3][1]  # undo the scale of the fixture
    expected = (speeds.clamp(-0.1, 0.1) * torch.tensor([2.0, 4.0])).clamp(-0.3, 0.3)
    assert (speeds.abs() > 0.1).any()
    assert_close(out[3], expected)


def test_terms_may_have_histories_of_their_own(frames):
    terms = [{"of": ProjectedGravity(), "history": 2}, {"of": PreviousAction()}]
    _, out = frames(terms=terms)
    assert out[0].shape == (2, 8)
    with pytest.raises(ValueError, match=r"stack.*\[2, 1\]"):
        frames(terms=terms, stack="frames")


def test_the_action_is_that_which_the_policy_gave(frames):
    _, out = frames(terms=[{"of": PreviousAction()}, {"of": PreviousAction(steps=2)}])
    torch.manual_seed(0)
    actions = [torch.randn(2, 2) for _ in range(6)]
    assert not out[0].any()
    assert_close(out[1], torch.cat([actions[0], torch.zeros(2, 2)], -1))
    assert_close(out[2], torch.cat([actions[1], actions[0]], -1))


def test_scales_of_another_number_are_refused(frames):
    with pytest.raises(ValueError, match=r"terms\.0.*scale.*3.*got 2"):
        frames(terms=[{"of": ProjectedGravity(), "scale": [1.0, 2.0]}])


def test_a_joint_that_the_robot_lacks_is_refused_with_the_nearest(make_base):
    with pytest.raises(ValueError, match=r"joints.*left_knee_pich.*did you mean left_knee_pitch"):
        ForeignObservation(
            make_base(), joints=["left_knee_pich"], terms=[{"of": ProjectedGravity()}]
        )
