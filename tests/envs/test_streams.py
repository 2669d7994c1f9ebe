"""Random numbers of each world, whatever else is drawn."""

import copy
import pickle

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torchrl.envs import Compose, TransformedEnv

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.streams import Streams
from zfall.envs.transforms.base_env import streams_of
from zfall.envs.transforms.observations import ObservationNoise

DRAWS = st.lists(  # of some kind and size, in some worlds, for some purpose
    st.tuples(
        st.sampled_from(["uniform", "normal", "integers"]),
        st.integers(1, 9),
        st.lists(st.booleans(), min_size=4, max_size=4),
        st.sampled_from(["noise", "delay"]),
    ),
    min_size=1,
    max_size=12,
)


def draw(streams: Streams, kind: str, size: int, rows, purpose: str) -> torch.Tensor:
    args = (37,) if kind == "integers" else ()
    mask = None if rows is None else torch.tensor(rows)
    return getattr(streams.of(purpose), kind)(*args, (size,), mask)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(DRAWS, st.integers(0, 3))
def test_a_world_draws_the_same_alone(draws, world):
    together, alone = Streams(4), Streams(1)
    together.begin(3)
    alone.begin(3, [world])
    for kind, size, rows, purpose in draws:
        numbers = draw(together, kind, size, rows, purpose)[world]
        if rows[world]:
            assert torch.equal(numbers, draw(alone, kind, size, None, purpose)[0])
        else:
            assert not numbers.any()


@settings(max_examples=30, deadline=None, derandomize=True)
@given(DRAWS)
def test_a_purpose_draws_the_same_without_the_others(draws):
    both, one = Streams(4), Streams(4)
    for kind, size, rows, purpose in draws:
        numbers = draw(both, kind, size, rows, purpose)
        if purpose == "noise":
            assert torch.equal(numbers, draw(one, kind, size, rows, purpose))


@settings(max_examples=30, deadline=None, derandomize=True)
@given(DRAWS, DRAWS)
def test_restored_streams_go_on(before, after):
    streams, other = Streams(4), Streams(4)
    streams.begin(2**63 + 1, [7, 1, 0, 3])
    for args in before:
        draw(streams, *args)
    other.load_state_dict(copy.deepcopy(streams.state_dict()))
    others = other, copy.deepcopy(streams), pickle.loads(pickle.dumps(streams))
    for args in after:
        numbers = draw(streams, *args)
        assert all(torch.equal(draw(each, *args), numbers) for each in others)


def test_seeds_worlds_purposes_and_steps_differ():
    streams = Streams(3)
    noise, delay = streams.of("noise"), streams.of("delay")
    drawn = [noise.uniform((4,)), noise.uniform((4,)), delay.uniform((4,))]
    for seed in (1, 2**32, -1):
        streams.begin(seed)
        drawn.append(streams.of("noise").uniform((4,)))
    values = torch.stack(drawn).flatten().tolist()
    assert len(set(values)) == len(values)
    streams.begin(0)
    assert torch.equal(streams.of("noise").uniform((4,)), drawn[0])


def test_numbers_do_not_depend_on_the_threads():
    drawn = []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        stream = Streams(512).of("noise")
        drawn.append((stream.normal((60,)), stream.uniform((60,))))
    assert all(torch.equal(one, two) for one, two in zip(*drawn, strict=True))


def test_shapes_and_kinds():
    stream = Streams(3).of("noise")
    assert stream.uniform().shape == (3,)
    assert stream.normal((2, 5)).shape == (3, 2, 5)
    assert stream.integers(4, (2,)).dtype == torch.int64
    assert stream.uniform((0,)).shape == (3, 0)
    with pytest.raises(ValueError, match="high must be at least 1, got 0"):
        stream.integers(0)


@pytest.mark.parametrize("worlds", [[0, 1], [0, 1, -1], [[0, 1, 2]]])
def test_other_worlds_than_there_are_cannot_begin(worlds):
    with pytest.raises(ValueError, match="worlds must be 3 numbers from 0 on, got"):
        Streams(3).begin(0, worlds)


def test_streams_of_other_worlds_are_refused():
    with pytest.raises(ValueError, match="as many worlds, streams of 3, got 2"):
        Streams(3).load_state_dict(Streams(2).state_dict())


def noise(base: HumanoidEnv) -> ObservationNoise:
    return ObservationNoise(base, std={"joint_position": 0.01})


def test_a_transform_draws_by_its_name_in_the_table():
    """Two of a class differ, and one draws the same where the other is left out."""

    def measured(*names: str) -> dict[str, torch.Tensor]:
        base = HumanoidEnv(num_envs=2, control_dt=0.04)
        env = make_env(base, {name: noise(base) for name in names})
        env.reset()
        return {name: streams_of(t).uniform((3,)) for name, t in env.transform.by_name.items()}

    both = measured("noise", "more")
    assert not torch.equal(both["noise"], both["more"])
    assert torch.equal(both["more"], measured("more")["more"])


def test_a_transform_elsewhere_draws_by_its_class_and_one_within_another_by_its_place():
    base = HumanoidEnv(num_envs=2, control_dt=0.04)
    alone = TransformedEnv(base, noise(base))
    assert streams_of(alone.transform).purpose == "ObservationNoise"
    both = make_env(base, {"noises": Compose(noise(base), noise(base))})
    assert [streams_of(t).purpose for t in both.transform[0]] == [
        "noises.transforms.0",
        "noises.transforms.1",
    ]


def test_a_seed_begins_the_streams_of_an_env():
    env = HumanoidEnv(num_envs=2, control_dt=0.04)
    drawn = []
    for seed in (4, 5, 4):
        env.set_seed(seed)
        drawn.append(env.streams.of("noise").normal((2,)).numpy())
    assert (drawn[0] == drawn[2]).all()
    assert not np.isin(drawn[0], drawn[1]).any()
