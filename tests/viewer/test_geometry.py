"""Robots in the browser are where MuJoCo has them."""

import mujoco
import numpy as np
import pytest

pytest.importorskip("trimesh")

from zfall.robots import ZEROTH01
from zfall.simulation.model import compile_model
from zfall.viewer.geometry import Poses, along, arrow, body_meshes


def model_and_state():
    model = compile_model(ZEROTH01, physics_dt=0.004)
    data = mujoco.MjData(model)
    data.qpos[:] = model.qpos0 + np.random.default_rng(0).normal(0, 0.3, model.nq)
    mujoco.mj_forward(model, data)
    return model, data


def test_vertices_lie_on_the_geoms_that_mujoco_places():
    """A box's eight corners from its own pose and size, whatever bodies are welded together."""
    model, data = model_and_state()
    meshes = body_meshes(model)
    where = dict(zip(meshes, zip(*Poses(model, list(meshes))(data.qpos), strict=True), strict=True))
    boxes = 0
    for geom in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_BOX):
        body = model.body_weldid[model.geom_bodyid[geom]]
        position, quaternion = where[body]
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.xquat[body])
        assert np.allclose(position, data.xpos[body])
        assert np.allclose(quaternion, data.xquat[body])
        shown = meshes[body].vertices @ turn.reshape(3, 3).T + position
        signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T
        corners = signs * model.geom_size[geom] @ data.geom_xmat[geom].reshape(3, 3).T
        for corner in corners + data.geom_xpos[geom]:
            assert np.linalg.norm(shown - corner, axis=1).min() < 1e-9
        boxes += 1
    assert boxes == 13


def test_every_colliding_geom_but_the_floor_is_shown():
    model, _ = model_and_state()
    bodies = {int(model.body_weldid[b]) for b in model.geom_bodyid} - {0}
    assert body_meshes(model).keys() == bodies


def test_a_capsule_is_as_long_as_in_the_model():
    """2 (half length + radius) along its own axis; the left forearm is 62 mm and twice 22 mm."""
    xml = '<mujoco><worldbody><body name="a"><freejoint/><geom type="capsule" size="0.022 0.031"/></body></worldbody></mujoco>'
    (mesh,) = body_meshes(mujoco.MjModel.from_xml_string(xml)).values()
    assert np.allclose(mesh.bounds, [[-0.022, -0.022, -0.053], [0.022, 0.022, 0.053]], atol=1e-3)


def test_an_arrow_ends_where_the_force_acts_and_comes_from_behind_it():
    """The tip is the origin; a force along x comes from negative x."""
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, along(np.array([1.0, 0.0, 0.0])))
    points = arrow(0.3).vertices @ turn.reshape(3, 3).T
    assert np.allclose([points[:, 0].min(), points[:, 0].max()], [-0.3, 0.0], atol=1e-9)
