"""What was measured before."""

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from zfall.envs.make import make_env
from zfall.envs.mirror import mirror_vector, mirrors_of
from zfall.envs.transforms.actions import JointPositionTarget
from zfall.envs.transforms.observations import (
    ObservationHistory,
    ObservationNoise,
    ObservationVector,
)
from zfall.envs.transforms.observations.vector import vector_spans

HISTORY = ["joint_position", "feet_position", "target"]
KEYS = ["joint_position", ("history", "joint_position"), ("history", "feet_position")]


def noisy(make_base, steps: int = 2):
    base = make_base(num_envs=3)
    return make_env(base, {
        "action": JointPositionTarget(base, scale=1.0),
        "noise": ObservationNoise(base, std={"joint_position": 0.1}),
        "history": ObservationHistory(base, keys=HISTORY, steps=steps),
        "observation": ObservationVector(keys=KEYS, out_key="observation", measured=True),
    })  # fmt: skip


def test_history_holds_what_was_measured_in_the_steps_before_the_newest_first(make_base):
    env = noisy(make_base)
    check_env_specs(env)
    td = env.reset()
    seen = [td["measured", "joint_position"]]
    feet, targets = [td["feet_position"]], [td["target"].clone()]
    for _ in range(4):
        td["action"] = 0.3 * torch.randn(3, 20)
        td = env.step(td)["next"]
        targets.append(td["target"].clone())
        seen.append(td["measured", "joint_position"])
        feet.append(td["feet_position"])
    assert not torch.equal(seen[-1], td["joint_position"])  # noise is on
    assert torch.equal(td["history", "joint_position"], torch.cat([seen[3], seen[2]], -1))
    assert torch.equal(td["history", "feet_position"], torch.cat([feet[3], feet[2]], -2).flatten(1))
    # A step writes its own target over that of the step before.
    assert torch.equal(td["history", "target"], torch.cat([targets[3], targets[2]], -1))
    expected = [seen[4], seen[3], seen[2], feet[3].flatten(1), feet[2].flatten(1)]
    assert torch.equal(td["observation"], torch.cat(expected, -1))


def test_history_begins_again_in_the_rows_of_a_reset_alone(make_base):
    env = noisy(make_base)
    td = env.reset()
    td["action"] = 0.3 * torch.randn(3, 20)
    td = env.step(td)["next"]
    before = td["history", "joint_position"].clone()
    td["_reset"] = torch.tensor([[True], [False], [False]])
    td = env.reset(td)
    start = td["measured", "joint_position"][0]
    assert torch.equal(td["history", "joint_position"][0], start.repeat(2))
    assert torch.equal(td["history", "joint_position"][1:], before[1:])
    seen = td["measured", "joint_position"].clone()
    td["action"] = torch.zeros(3, 20)
    after = env.step(td)["next"]["history", "joint_position"]
    assert torch.equal(after[0], start.repeat(2))
    assert torch.equal(after[1:], torch.cat([seen, before[:, :20]], -1)[1:])


def test_mirror_of_a_history_is_the_history_of_the_mirror(make_base):
    """The robot in the mirror, seen three steps long, must be the mirrored vector."""
    env = noisy(make_base, steps=3)
    base = env.base_env
    spans = vector_spans(env.observation_spec, KEYS)
    whole = mirror_vector(base.robot, spans, base.joint_range, declared=mirrors_of(env.transform))
    one = mirror_vector(base.robot, {"joint_position": slice(0, 20)}, base.joint_range)
    steps = 0.1 * torch.randn(3, 20)  # no joint at the end of its range
    vector = torch.zeros(1, spans["history/feet_position"].stop)
    vector[0, spans["history/joint_position"]] = steps.flatten()
    feet = torch.arange(18.0).reshape(3, 2, 3)
    vector[0, spans["history/feet_position"]] = feet.flatten()
    image = whole(vector)[0]
    assert torch.equal(image[spans["history/joint_position"]], one(steps).flatten())
    swapped = feet.flip(1) * torch.tensor([1.0, -1.0, 1.0])
    assert torch.equal(image[spans["history/feet_position"]], swapped.flatten())


def test_what_has_no_mirror_image_is_kept_and_not_mirrored(make_base):
    base = make_base(num_envs=1)
    history = ObservationHistory(base, keys=["joint_position", "wind"], steps=2)
    assert list(history.mirror_signs) == ["history/joint_position"]


def test_history_goes_on_from_its_state(make_base):
    env, other = noisy(make_base), noisy(make_base)
    td = env.reset()
    for action in (0.3 * torch.randn(3, 20), 0.3 * torch.randn(3, 20)):
        td = env.step(td.set("action", action))["next"]
    other.reset()
    state = env.transform.by_name["history"].state_dict()
    other.transform.by_name["history"].load_state_dict(state)
    td["action"] = torch.zeros(3, 20)
    expected = env.step(td.clone())["next"]["history", "joint_position"]
    assert torch.equal(other.step(td.clone())["next"]["history", "joint_position"], expected)


def test_bad_values_are_refused(make_base):
    base = make_base(num_envs=1)
    with pytest.raises(ValueError, match=r"keys must name quantities made before .*, got tilt"):
        make_env(base, {"history": ObservationHistory(base, keys=["tilt"], steps=2)})
