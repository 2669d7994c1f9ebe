"""Films, where OpenGL is to be had."""

import math
from types import SimpleNamespace

import imageio.v2 as imageio
import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from zfall.evaluation import video
from zfall.evaluation.captions import Mark, Pushed, PushLog, outcome_at, push_marks
from zfall.robots import ZEROTH01


def test_film_has_a_frame_per_step_and_shows_the_robot(tmp_path):
    model = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    states = np.tile(model.key("stand").qpos, (5, 2, 1))
    forces = np.zeros((5, 2, 3))
    forces[2:, 0] = [20.0, 0.0, 0.0]
    norms = np.linalg.norm(forces, axis=-1)
    pushed = Pushed(forces, norms, 0.12 * norms, norms / 100)
    path = tmp_path / "film.mp4"
    try:
        video.film(model, {"a": states}, ["one", "two"], pushed, path, dt=0.04, tile=(160, 120))
    except RuntimeError as error:
        assert "install" in str(error)
        pytest.skip("no OpenGL on this machine")
    frames = imageio.mimread(path)
    assert len(frames) == 5  # 25 each second
    assert frames[0].std() > 10
    assert np.abs(frames[4].astype(int) - frames[0]).max() > 50  # the arrow


def test_missing_opengl_says_what_to_install(monkeypatch):
    def broken(*args: object) -> None:
        raise OSError("no display")

    monkeypatch.setattr(mujoco, "Renderer", broken)
    with pytest.raises(RuntimeError, match="install: apt-get install libegl1"):
        video.make_renderer(mujoco.MjModel.from_xml_path(ZEROTH01.mjcf), 8, 8)


def test_slow_motion_goes_halfway_between_two_states():
    """A quarter turn about z in half of the time is an eighth of one."""
    model = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    states = np.tile(model.key("stand").qpos, (2, 1))
    states[1, 0] += 0.1
    states[1, 3:7] = math.cos(math.pi / 4), 0.0, 0.0, math.sin(math.pi / 4)
    half = video.between(model, states, 0, 0.5)
    assert half[0] == pytest.approx(states[0, 0] + 0.05)
    assert half[3:7] == pytest.approx([math.cos(math.pi / 8), 0, 0, math.sin(math.pi / 8)])


def steps_of_a_push(worlds=1):
    """20 N for 0.1 s from the right, I = 0.4: 8 mN s in the first step, 0.8 in two, and a rest."""
    log = PushLog(worlds)
    for share in [0.0] * 10 + [0.01, 1.0, 1.0, 0.49] + [0.0] * 36:
        acts = float(share > 0)
        step = {"force": [0.0, 20.0 * share, 0.0], "peak_force": [20.0 * acts]}
        step |= {"impulse": [2.0 * acts], "size": [0.4 * acts]}
        push = {key: torch.tensor([value] * worlds) for key, value in step.items()}
        log.add(TensorDict({"push": push}, []))
    return log


def test_a_push_is_named_by_its_plan_and_side_and_marked_for_a_second():
    """A push along +y comes from the right, of who faces there from behind."""
    pushed = steps_of_a_push().frames(range(1, 51))
    marks = push_marks(pushed, 0, np.zeros(50), 0.04)
    assert [t for t, mark in enumerate(marks) if mark] == list(range(10, 35))
    assert marks[10].label == "I = 0.40: 20 N for 0.1 s from the right"
    turned = push_marks(pushed, 0, np.full(50, math.pi / 2), 0.04)
    assert turned[10].label == "I = 0.40: 20 N for 0.1 s from behind"


def test_frames_longer_than_the_push_show_its_size_and_not_their_mean():
    """Over ten steps 20 N for 0.1 s are 5 N in the mean; the arrow is that of 20 N."""
    pushed = steps_of_a_push().frames([10, 20, 30, 40, 50])
    assert pushed.force[1, 0] == pytest.approx([0.0, 5.0, 0.0])
    mark = push_marks(pushed, 0, np.zeros(5), 0.4)[1]
    assert mark.label == "I = 0.40: 20 N for 0.1 s from the right"
    assert mark.force == pytest.approx([0.0, 20.0, 0.0])


def test_an_env_without_pushes_has_no_marks():
    log = PushLog(2)
    log.add(TensorDict({}, []))
    assert push_marks(log.frames([1]), 1, np.zeros(1), 0.04) == [None]


def test_a_film_tells_times_since_the_last_push_before():
    fell = [(2.9, "fell {when}", False)]
    assert outcome_at(fell, 3.0, None, [0.8, 2.4]) == ("fell 0.5 s after the push", False)
    assert outcome_at(fell, 3.0, None, [0.8, 2.86]) == ("fell 0.04 s after the push", False)
    assert outcome_at(fell, 3.0, None, [0.8, 2.95]) == ("fell 2.1 s after the push", False)
    assert outcome_at(fell, 3.0, None, []) == ("fell after 2.9 s", False)


def filmed(monkeypatch, tmp_path, rows=("a",), **given):
    """Clocks, pushes and outcomes of the tiles of a film without OpenGL, and arrows' pictures."""
    texts, arrows, count = [], [], 50
    model = mujoco.MjModel.from_xml_path(ZEROTH01.mjcf)
    states = np.tile(model.key("stand").qpos, (count, 1, 1))
    picture = np.zeros((120, 160, 3), np.uint8)
    renderer = SimpleNamespace(
        update_scene=lambda *_, **__: None,
        scene=SimpleNamespace(flags=np.zeros(20)),
        render=lambda: picture,
        close=lambda: None,
    )
    monkeypatch.setattr(video, "make_renderer", lambda *_: renderer)
    monkeypatch.setattr(video, "draw_arrow", lambda *_: arrows.append(len(texts)))
    monkeypatch.setattr(video, "write_on", lambda picture, **said: texts.append(said) or picture)
    pushed = steps_of_a_push().frames(range(1, count + 1))
    path = tmp_path / "film.mp4"
    states = dict.fromkeys(rows, states)
    video.film(model, states, ["one"], pushed, path, dt=0.04, tile=(160, 120), **given)
    return texts, arrows


def test_the_clock_shows_the_time_of_the_state_in_the_picture(monkeypatch, tmp_path):
    """States follow their control steps, so that the first one is that of 0.04 s."""
    texts, _ = filmed(monkeypatch, tmp_path)
    assert [text["clock"] for text in texts[:2]] == ["0.04 s", "0.08 s"]
    assert texts[-1]["clock"] == "2.00 s"
    assert filmed(monkeypatch, tmp_path, start=0.01)[0][1]["clock"] == "0.05 s"
    slow, _ = filmed(monkeypatch, tmp_path, cut=video.Cut(0.5))
    assert [text["clock"] for text in slow[:3]] == ["0.04 s  x0.5", "0.06 s  x0.5", "0.08 s  x0.5"]
    assert slow[-1]["clock"] == "2.00 s  x0.5"  # the last state stays


def test_only_a_while_from_the_push_on_is_slow_and_only_a_part_is_shown(monkeypatch, tmp_path):
    """The push acts from 0.4 s on, in the step that ends at 0.44 s."""
    texts, _ = filmed(monkeypatch, tmp_path, cut=video.Cut(0.5, slow_for=0.08, shown=[0.32, 0.6]))
    assert [text["clock"] for text in texts] == [
        *("0.32 s", "0.36 s", "0.40 s  x0.5", "0.42 s  x0.5", "0.44 s  x0.5", "0.46 s  x0.5"),
        *("0.48 s", "0.52 s", "0.56 s"),
    ]
    with pytest.raises(ValueError, match=r"from 0.04 to 2.04 s, got \[3, 4\]"):
        filmed(monkeypatch, tmp_path, cut=video.Cut(shown=[3.0, 4.0]))


def test_a_push_is_named_once_and_no_arrow_points_at_who_lies(monkeypatch, tmp_path):
    """The push begins at 0.4 s; b falls at 0.6 s, 0.2 s after it, a stays up."""
    said = {"a": [[]], "b": [[(0.6, "fell {when}", False)]]}
    names = []
    monkeypatch.setattr(video, "write_push", lambda picture, name: names.append(name) or picture)
    texts, arrows = filmed(monkeypatch, tmp_path, ("a", "b"), outcomes=said)
    assert {text["push"] for text in texts} == {""}  # over both, as they stand abreast
    assert set(names) == {"I = 0.40: 20 N for 0.1 s from the right"}
    assert [number for number in arrows if number % 2 == 0] == list(range(20, 70, 2))
    assert [number for number in arrows if number % 2] == list(range(21, 29, 2))  # until 0.56 s
    assert texts[-1]["outcome"] == ("fell 0.2 s after the push", False)


def test_an_outcome_is_said_from_its_time_on():
    said = [(1.0, "fell", False)]
    assert outcome_at(said, 0.9) is None
    assert outcome_at(said, 1.0) == ("fell", False)


def test_a_robot_that_lies_faces_where_it_did_before():
    """Upright it faces left, 90 degrees; then it lies on its back, pitched by 100 degrees."""
    yaw, pitch = math.pi / 4, math.radians(50)  # halves of the angles
    upright = [math.cos(yaw), 0.0, 0.0, math.sin(yaw)]
    lying = [math.cos(pitch), 0.0, math.sin(pitch), 0.0]  # of a yaw of 180 degrees by its formula
    states = np.zeros((3, 27))
    states[:, 3:7] = [upright, lying, upright]
    np.testing.assert_allclose(video._headings(states), math.pi / 2, atol=1e-12)


def test_a_film_says_that_all_is_well_only_when_the_push_is_half_a_second_old():
    """The last push of a film may come after the time at which it tells the outcome."""
    good, bad = [(1.0, "stays up", True)], [(1.0, "fell", False)]
    fresh, old = Mark(np.zeros(3), "", 0.3), Mark(np.zeros(3), "", 0.6)
    assert outcome_at(good, 1.2, fresh) is None
    assert outcome_at(good, 1.5, old) == ("stays up", True)
    assert outcome_at(bad, 1.2, fresh) == ("fell", False)


def test_what_no_film_can_show_is_refused_before_it_is_played():
    with pytest.raises(ValueError, match="slow must be below 1 with slow_for=2, got 1"):
        video.Cut(slow_for=2.0)
    with pytest.raises(ValueError, match="shown must begin before the end, 7 s, got 8"):
        video.Cut(shown=[8.0, 9.0]).check(7.0)
    video.Cut(shown=[6.0, 9.0]).check(7.0)
