"""A digest changes with whatever changes a world."""

import dataclasses
import shutil
from pathlib import Path

import pytest
from omegaconf import DictConfig, OmegaConf

from recipes import digests
from zfall.fingerprints import ASSETS, READ_BY, env_digest
from zfall.robots import ZEROTH01

NODES = {
    "KneelReference": {"_target_": "zfall.falling.kneel_reference.KneelReference"},
    "FallingStart": {"_target_": "zfall.falling.falling_start.FallingStart"},
    "ReferenceStart": {"_target_": "zfall.envs.transforms.starts.ReferenceStart"},
    "load_fall_network": {"_target_": "zfall.falling.fall_network.load_fall_network"},
}
NAMED = [name for name, (key, _) in READ_BY.items() if key]


def world(name: str, **values: str) -> DictConfig:
    """With the node within a list within another one."""
    outer = {"_target_": "some.Other", "parts": [None, NODES[name] | values]}
    return OmegaConf.create({"base_env": {"num_envs": 1}, "transforms": {"one": outer}})


@pytest.fixture
def assets(tmp_path, monkeypatch) -> Path:
    """A copy of the robot's files, which the digest takes for its own."""
    folder = shutil.copytree(ASSETS, tmp_path / "assets")
    robot = dataclasses.replace(ZEROTH01, mjcf=str(folder / Path(ZEROTH01.mjcf).name))
    monkeypatch.setattr(digests, "robot_of", lambda cfg: robot)
    return folder


@pytest.mark.parametrize("name", NODES)
def test_the_robots_own_file_counts_by_its_content(name, assets):
    before = env_digest(world(name))
    file = assets / f"zeroth01_{READ_BY[name][1]}"
    file.write_bytes(file.read_bytes() + b"more")
    assert env_digest(world(name)) != before


@pytest.mark.parametrize("name", NAMED)
def test_a_file_that_is_named_counts_by_its_content_and_the_robots_own_does_not(
    name, assets, tmp_path
):
    key, ending = READ_BY[name]
    file = tmp_path / "recorded.npz"
    file.write_bytes(b"some")
    cfg = world(name, **{key: str(file)})
    before = env_digest(cfg)
    (assets / f"zeroth01_{ending}").write_bytes(b"unread")
    assert env_digest(cfg) == before
    file.write_bytes(b"recorded anew")
    assert env_digest(cfg) != before


def test_a_world_that_reads_none_of_them_does_not_depend_on_them(assets):
    cfg = OmegaConf.create({"base_env": {}, "transforms": {"one": {"_target_": "a.B", "x": [1]}}})
    before = env_digest(cfg)
    for _, ending in READ_BY.values():
        (assets / f"zeroth01_{ending}").write_bytes(b"other")
    assert env_digest(cfg) == before


def test_a_network_that_ships_counts_by_its_content_when_it_is_named(assets):
    name = "zeroth01_fall_network_com_velocity.pt"
    cfg = world("load_fall_network", path=name)
    before = env_digest(cfg)
    (assets / name).write_bytes(b"trained anew")
    assert env_digest(cfg) != before
