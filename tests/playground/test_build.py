"""What the playground is built of, without a browser."""

import re

import mujoco
import numpy as np
import pytest

from recipes.playground import SOURCES
from tests.shell import run
from zfall.envs.humanoid import HumanoidEnv
from zfall.policies.webpage import (
    MEASURABLE,
    check_measurable,
    describe_look,
    describe_robot,
    robot_mjcf,
)
from zfall.robots.servos import SERVOS


def servos(base: HumanoidEnv) -> dict:
    """Those of the sheets, on all joints."""
    return dict.fromkeys(base.robot.joints, SERVOS["STS3250"])


def test_the_mjcf_with_its_fields_is_the_model_of_the_env(make_base):
    """Loaded from text it moves as the env's, to 1e-9, over half a second of falling."""
    env = make_base(servos=servos(make_base()))
    model = mujoco.MjModel.from_xml_string(robot_mjcf(env))
    for name, values in describe_robot(env)["fields"].items():
        getattr(model, name).flat = values
    own, there = mujoco.MjData(env.simulation.model), mujoco.MjData(model)
    mujoco.mj_setConst(model, there)
    for each, data in ((env.simulation.model, own), (model, there)):
        mujoco.mj_resetDataKeyframe(each, data, 0)
        data.xfrc_applied[each.body("push_point/torso").id, :3] = [9.0, 4.0, 0.0]
        for _ in range(125):
            mujoco.mj_step(each, data)
    np.testing.assert_allclose(there.qpos, own.qpos, atol=1e-9)
    assert abs(own.qpos[0]) > 0.01


def test_the_look_lies_on_the_bodies_that_the_page_moves(make_base):
    """In a bent pose each geom is where the model of pictures has it, to a hundredth of a mm."""
    env = make_base()
    look, physics, pictures = describe_look(env), env.simulation.model, env.camera.model
    here, there = mujoco.MjData(physics), mujoco.MjData(pictures)
    here.qpos[:] = physics.qpos0 + np.random.default_rng(0).normal(0, 0.3, physics.nq)
    there.qpos[:] = here.qpos
    mujoco.mj_kinematics(physics, here)
    mujoco.mj_kinematics(pictures, there)
    shown = [g for g in range(1, pictures.ngeom) if pictures.geom_group[g] < 3]
    assert len(look["geoms"]) == len(shown) > 50
    for each, geom in zip(look["geoms"], shown, strict=True):
        body = here.body(each["body"])
        turn = body.xmat.reshape(3, 3)
        np.testing.assert_allclose(
            body.xpos + turn @ each["place"], there.geom_xpos[geom], atol=2e-5
        )
        np.testing.assert_allclose(
            turn @ np.reshape(each["turn"], (3, 3)), there.geom_xmat[geom].reshape(3, 3), atol=5e-5
        )
        if "mesh" in each:
            mesh = look["meshes"][each["mesh"]]
            assert max(mesh["faces"]) < len(mesh["vertices"]) / 3


def test_a_fall_is_a_force_on_any_region_but_the_feet(make_base):
    falls = describe_robot(make_base())["falls"]
    assert "contact_force_peak/head" in falls
    assert "contact_force_peak/left_shin/ankle_servo" in falls
    assert not [name for name in falls if "foot" in name]


def test_the_script_of_the_page_reads_every_sensor_that_a_policy_may_read():
    text = (SOURCES / "js" / "world.js").read_text()
    assert sorted(re.findall(r'case "(\w+)":', text)) == sorted(MEASURABLE)


def test_what_the_page_cannot_measure_is_refused_by_name():
    check_measurable({"sensors": [{"name": "joint_position"}]})
    with pytest.raises(ValueError, match=r"^run must read .* got joint_torque\.$"):
        check_measurable({"sensors": [{"name": "joint_torque"}]})


def test_servos_that_feel_load_are_refused_with_the_repair(make_base):
    env = make_base(servos=servos(make_base()), servo_dynamics=True)
    with pytest.raises(
        ValueError, match=r"servo_dynamics .*change=\[base_env.servo_dynamics=false\]"
    ):
        robot_mjcf(env)  # fmt: skip


def test_a_folder_with_other_files_is_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    done = run("playground", f"out={tmp_path}", f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 1
    assert "out must be a new or empty folder" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_the_lock_names_versions_and_no_hosts():
    lock = (SOURCES / "package-lock.json").read_text()
    assert '"integrity"' in lock
    assert "resolved" not in lock
    assert "://" not in re.sub(r'"funding": \{[^}]*\}', "", lock)
