"""What is declared of a toy and cannot be, refused in one line; and what can be, is taken."""

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from tests.toy import toy_mjcf
from zfall.robots import ZEROTH01, Robot, bare_model
from zfall.robots.declared import check_declared

REGIONS = {
    "torso": ("trunk",),
    "legs": ("left_thigh", "right_thigh", "left_shank", "right_shank"),
    "left_foot": ("left_sole",),
    "right_foot": ("right_sole",),
}


@pytest.fixture(scope="module")
def mjcf(tmp_path_factory) -> str:
    return str(toy_mjcf(tmp_path_factory.mktemp("toy")))


def refused(**declared: object) -> str:
    with pytest.raises(ValueError) as error:  # noqa: PT011 - the caller reads it
        Robot(name="toy", **declared)
    assert "\n" not in str(error.value)
    return str(error.value)


@pytest.mark.parametrize(
    ("declared", "says"),
    [
        ({"stiffness": {"left_hip": 50.0, "left_kne": 50.0}}, ("stiffness", "left_kne:")),
        ({"stiffness": {"left_hip": 0.0}}, ("stiffness.left_hip must be positive", "got 0.0")),
        ({"stiffness": -3.0}, ("stiffness must be positive", "got -3.0")),
        ({"postures": {"kneel": {"left_kne": 0.4}}}, ("postures.kneel", "left_kne:", "left_knee")),
        ({"stand": {"left_kne": 0.4}}, ("stand must name joints", "left_kne")),
    ],
)
def test_a_misspelt_joint_or_a_stiffness_that_holds_nothing_is_refused(mjcf, declared, says):
    text = refused(mjcf=mjcf, **declared)
    assert all(part in text for part in says), text


@pytest.mark.parametrize(
    ("links", "says"),
    [
        (("right_sole", "left_sole"), "right_sole lies right of left_sole: exchange"),
        (("left_sole", "left_sole"), "none carries the other, got left_sole and left_sole"),
        (("left_sole", "left_thigh"), "none carries the other, got left_sole and left_thigh"),
        (("left_sole",), "got 1 links"),
        (("left_sole", "right_sol"), "there is no right_sol"),
    ],
)
def test_feet_that_cannot_be_the_left_and_the_right_one_are_refused(mjcf, links, says):
    assert says in refused(mjcf=mjcf, foot_links=links)


def test_a_foot_that_cannot_meet_the_floor_is_refused(tmp_path):
    foot = '<geom type="box" size="0.06 0.03 0.01" mass="0.1" contype="0" conaffinity="0"/>'
    path = str(toy_mjcf(tmp_path, foot=foot))
    assert "left_sole has no geom that does" in refused(
        mjcf=path, foot_links=("left_sole", "right_sole")
    )


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"legs": ("left_thigh", "right_thigh")}, "left_shank, right_shank are missing"),
        ({"torso": ()}, "trunk is missing"),
        ({"left_foot": ("right_sole",), "right_foot": ("left_sole",)}, "it lacks left_sole"),
        ({"torso": ("trunk", "tail")}, "region_links.torso must be links, there is no tail"),
    ],
)
def test_regions_that_do_not_see_each_fall_are_refused(mjcf, changes, says):
    text = refused(mjcf=mjcf, region_links=REGIONS | changes)
    assert "region_links" in text
    assert says in text


def test_what_is_declared_rightly_is_taken(mjcf):
    plain = Robot(name="toy", mjcf=mjcf)
    robot = Robot(
        name="toy",
        mjcf=mjcf,
        foot_links=["left_sole", "right_sole"],
        region_links={region: list(links) for region, links in REGIONS.items()},
        stiffness={"left_hip": 60.0, "right_hip": 60.0},
        postures={"kneel": {"left_knee": 0.4}},
    )
    assert robot.regions == tuple(REGIONS)
    assert robot.additions.soles[0].link == plain.additions.soles[0].link == "left_sole"
    assert robot.posture("kneel") == (0.0, 0.4, 0.0, 0.0, 0.0, 0.0)


def test_a_stand_in_degrees_is_refused(tmp_path):
    text = refused(mjcf=str(toy_mjcf(tmp_path)), stand={"left_knee": 23.0})
    assert "stand.left_knee must lie in its range" in text
    assert "got 23" in text


def test_regions_may_be_the_feet_alone_if_nothing_else_meets_the_floor(tmp_path):
    path = toy_mjcf(tmp_path)
    bare = path.read_text().replace('mass="1.3"', 'mass="1.3" contype="0" conaffinity="0"')
    for mass in ('mass="0.3"', 'mass="0.2"'):
        bare = bare.replace(mass, f'{mass} contype="0" conaffinity="0"')
    path.write_text(bare)
    feet = {region: REGIONS[region] for region in ("left_foot", "right_foot")}
    assert Robot(name="toy", mjcf=str(path), region_links=feet).regions == tuple(feet)


@pytest.mark.parametrize(
    ("option", "says"),
    [
        ('<option gravity="0 0 -1.62"/>', "the MJCF has 0 0 -1.62"),
        ('<option gravity="0 -9.81 0"/>', "the MJCF has 0 -9.81 0"),
        ('<option><flag gravity="disable"/></option>', "the MJCF has 0 0 0"),
    ],
)
def test_another_gravity_than_that_of_the_units_is_refused(tmp_path, option, says):
    text = refused(mjcf=str(toy_mjcf(tmp_path, more=option)))
    assert "gravity must be 0 0 -9.81" in text
    assert says in text
    whole = Path(ZEROTH01.mjcf).read_text().replace("</mujoco>", f"{option}</mujoco>")
    (tmp_path / "zeroth01.xml").write_text(whole)
    with pytest.raises(ValueError, match=says):
        check_declared(replace(ZEROTH01, mjcf=str(tmp_path / "zeroth01.xml")))


@pytest.mark.parametrize("yaw", [0.4, np.pi / 2, np.pi, -2.5])
def test_a_keyframe_that_faces_elsewhere_gives_the_same_robot(tmp_path, yaw):
    """Which way it faces is no property of a robot; how it leans is."""
    robots = []
    lean = np.array([np.cos(0.02), 0.0, np.sin(0.02), 0.0])  # forward by 0.04 rad
    for number, angle in enumerate((0.0, yaw)):
        base = np.zeros(4)
        mujoco.mju_mulQuat(base, np.array([np.cos(angle / 2), 0, 0, np.sin(angle / 2)]), lean)
        (folder := tmp_path / str(number)).mkdir()
        ankles = "0 0 -0.04 0 0 0.04"  # the soles are flat on the floor
        key = f'qpos="0 0 0.3 {" ".join(map(str, base))} {ankles}"'
        robots.append(Robot(name="toy", mjcf=str(toy_mjcf(folder, key=key))))
    first, other = robots
    np.testing.assert_allclose(bare_model(first).key("stand").qpos[3:7], lean, atol=1e-12)
    np.testing.assert_allclose(
        bare_model(other).key("stand").qpos, bare_model(first).key("stand").qpos, atol=1e-9
    )
    for mine, theirs in zip(other.additions.soles, first.additions.soles, strict=True):
        assert mine.link == theirs.link
        np.testing.assert_allclose(mine.position, theirs.position, atol=1e-9)
    assert other.regions == first.regions
    assert other.sole_half_size == pytest.approx(first.sole_half_size)
    assert other.com_height == pytest.approx(first.com_height, rel=1e-4)
