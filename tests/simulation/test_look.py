"""What a robot looks like touches nothing that is stepped."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from zfall.robots import ZEROTH01, Ball
from zfall.simulation.look import HIDDEN
from zfall.simulation.model import compile_model

PLAIN = compile_model(ZEROTH01, physics_dt=0.004)
DRESSED = compile_model(ZEROTH01, physics_dt=0.004, look=True)


def _rolled(model: mujoco.MjModel) -> list[np.ndarray]:
    """States and contacts of a second in which the robot is thrown and falls."""
    data, out = mujoco.MjData(model), []
    mujoco.mj_resetDataKeyframe(model, data, model.key("stand").id)
    data.qvel[:3] = 1.2, 0.7, 0.1
    for step in range(250):
        data.ctrl[:] = model.key("stand").ctrl + 0.3 * np.sin(0.1 * step + np.arange(model.nu))
        mujoco.mj_step(model, data)
        out += [data.qpos.copy(), data.qvel.copy(), data.sensordata.copy(), np.array([data.ncon])]
    return out


def test_a_fall_with_the_look_has_the_same_bits():
    assert max(each[0] for each in _rolled(PLAIN)[3::4]) > 8  # more than two feet touch
    for plain, dressed in zip(_rolled(PLAIN), _rolled(DRESSED), strict=True):
        assert plain.tobytes() == dressed.tobytes()


def test_the_look_weighs_nothing_and_touches_nothing():
    assert PLAIN.body_mass.sum() == DRESSED.body_mass.sum()
    for body in range(PLAIN.nbody):
        there = DRESSED.body(PLAIN.body(body).name).id
        for field in ("body_mass", "body_inertia", "body_ipos", "body_iquat"):
            assert (getattr(PLAIN, field)[body] == getattr(DRESSED, field)[there]).all()
    colliding = (DRESSED.geom_contype | DRESSED.geom_conaffinity) != 0
    assert colliding.sum() == ((PLAIN.geom_contype | PLAIN.geom_conaffinity) != 0).sum()
    assert DRESSED.ngeom > PLAIN.ngeom + 60


def test_shells_lie_on_what_collides():
    """Every link that touches the floor shows a geom no further from it than 4 cm."""
    data = mujoco.MjData(DRESSED)
    data.qpos[:] = DRESSED.key("kneel").qpos
    mujoco.mj_kinematics(DRESSED, data)
    shown = np.flatnonzero(DRESSED.geom_group == 2)
    for geom in np.flatnonzero(DRESSED.geom_group == HIDDEN):
        if DRESSED.geom(geom).name == "imu":
            continue
        mine = shown[DRESSED.body_weldid[DRESSED.geom_bodyid[shown]]
                     == DRESSED.body_weldid[DRESSED.geom_bodyid[geom]]]  # fmt: skip
        away = np.linalg.norm(data.geom_xpos[mine] - data.geom_xpos[geom], axis=1)
        assert away.min() < 0.04, DRESSED.geom(geom).name


def test_the_look_is_the_same_on_both_sides():
    data = mujoco.MjData(DRESSED)
    mujoco.mj_kinematics(DRESSED, data)  # at zero: the links lie where the look was drawn
    places = data.geom_xpos[DRESSED.geom_group == 2]
    for place in places:
        other = np.linalg.norm(places - place * [1, -1, 1], axis=1)
        assert other.min() < 1e-6


def test_a_robot_without_a_look_shows_what_collides():
    model = compile_model(replace(ZEROTH01, look=None), physics_dt=0.004, look=True)
    assert model.ngeom == PLAIN.ngeom
    assert (model.geom_group == PLAIN.geom_group).all()


def test_a_ball_is_shown_beside_the_look():
    model = compile_model(ZEROTH01, physics_dt=0.004, ball=Ball(mass=0.1, radius=0.05), look=True)
    assert model.geom("ball").group[0] < HIDDEN
    assert model.nq == PLAIN.nq + 7


def test_a_look_of_a_link_that_is_not_there_is_refused(tmp_path):
    look = tmp_path / "look.xml"
    look.write_text("<mujoco><worldbody><body name='Tail'/></worldbody></mujoco>")
    with pytest.raises(ValueError, match="look must have bodies .* Tail"):
        compile_model(replace(ZEROTH01, look=str(look)), physics_dt=0.004, look=True)
