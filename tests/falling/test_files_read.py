"""What a world's files hold counts, not how they are named."""

import dataclasses
import os
import shutil
from pathlib import Path

import pytest
import torch
from omegaconf import DictConfig, OmegaConf

from zfall import checkpoint
from zfall.envs import tables
from zfall.envs.tables import contents_of
from zfall.falling import fall_network, files
from zfall.fingerprints import file_digest
from zfall.meaning import meaning
from zfall.robots import ZEROTH01

NODES = {  # what reads a file, the key that may name another one, the robot's own
    "zfall.falling.kneel_reference.KneelReference": ("catches", "catches.npz"),
    "zfall.falling.falling_start.FallingStart": ("bank", "falls.npz"),
    "zfall.envs.transforms.starts.ReferenceStart": (None, "motions.npz"),
    "zfall.falling.fall_network.load_fall_network": ("path", "fall_network.pt"),
}
NAMED = [path for path, (key, _) in NODES.items() if key]


def world(target: str, **values: str) -> DictConfig:
    """With the node within a list within another one, which nothing can import."""
    outer = {"_target_": "some.Other", "parts": [None, {"_target_": target} | values]}
    return OmegaConf.create({"base_env": {"num_envs": 1}, "transforms": {"one": outer}})


def contents(cfg: DictConfig) -> dict[str, str]:
    return contents_of({"env": OmegaConf.to_container(cfg)})


@pytest.fixture
def assets(tmp_path, monkeypatch) -> Path:
    """A copy of the files that ship, which the digest takes for the robot's own."""
    folder = shutil.copytree(files.ASSETS, tmp_path / "assets")
    shutil.copytree(Path(ZEROTH01.mjcf).parent, folder, dirs_exist_ok=True)
    robot = dataclasses.replace(ZEROTH01, mjcf=str(folder / Path(ZEROTH01.mjcf).name))
    monkeypatch.setattr(tables, "robot_of", lambda cfg: robot)
    for module in (files, fall_network):
        monkeypatch.setattr(module, "ASSETS", folder)
    return folder


@pytest.mark.parametrize("path", NODES)
def test_the_robots_own_file_counts_by_its_content(path, assets):
    before = contents(world(path))
    file = assets / f"zeroth01_{NODES[path][1]}"
    file.write_bytes(b"made anew")
    assert contents(world(path)) != before


@pytest.mark.parametrize("path", NAMED)
def test_a_file_that_is_named_counts_by_its_content_and_the_robots_own_does_not(
    path, assets, tmp_path
):
    key, ending = NODES[path]
    file = tmp_path / "recorded.npz"
    file.write_bytes(b"some")
    cfg = world(path, **{key: str(file)})
    before = contents(cfg)
    (assets / f"zeroth01_{ending}").write_bytes(b"unread")
    assert contents(cfg) == before
    file.write_bytes(b"recorded anew")
    assert contents(cfg) != before


def test_a_world_that_reads_none_of_them_does_not_depend_on_them(assets):
    cfg = OmegaConf.create({"base_env": {}, "transforms": {"one": {"_target_": "a.B", "x": [1]}}})
    before = contents(cfg)
    for _, ending in NODES.values():
        (assets / f"zeroth01_{ending}").write_bytes(b"other")
    assert contents(cfg) == before


def test_a_network_that_ships_counts_by_its_content_when_it_is_named(assets):
    name = "zeroth01_fall_network_com_velocity.pt"
    cfg = world("zfall.falling.fall_network.load_fall_network", path=name)
    before = contents(cfg)
    (assets / name).write_bytes(b"trained anew")
    assert contents(cfg) != before


def test_a_file_at_another_path_is_the_same(assets, tmp_path):
    target, name = "zfall.falling.fall_network.load_fall_network", "zeroth01_fall_network.pt"
    copied = shutil.copy(assets / name, tmp_path / "copied.pt")
    texts = [{}, {"path": name}, {"path": str(copied)}]
    configs = [{"env": OmegaConf.to_container(world(target, **text))} for text in texts]
    meanings = [meaning(config, contents_of(config)) for config in configs]
    assert meanings[0] == meanings[1] == meanings[2]
    other = world(target, path="zeroth01_fall_network_com_velocity.pt")
    config = {"env": OmegaConf.to_container(other)}
    assert meaning(config, contents_of(config)) != meanings[0]


def test_a_checkpoint_counts_by_its_tensors(tmp_path):
    """Not by what else is written in it, such as the version that wrote it."""
    path, tensors = tmp_path / "network.pt", {"weight": torch.ones(2), "bias": torch.tensor(1.0)}
    digests = []
    for content in ({"network": tensors}, {"network": tensors, "by": "0.2"}):
        checkpoint.save(path, content)
        os.utime(path, ns=(0, len(digests)))
        digests.append(file_digest(path))
    checkpoint.save(path, {"network": tensors | {"weight": torch.tensor([1.0, 2.0])}})
    assert digests[0] == digests[1] != file_digest(path)
