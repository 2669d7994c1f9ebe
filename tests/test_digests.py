"""A digest changes with whatever changes a world."""

import pytest
from omegaconf import OmegaConf

from recipes import digests
from recipes.digests import env_digest

BASE = {"base_env": {"num_envs": 1}}
NODES = {
    "KneelReference": {"_target_": "zfall.envs.transforms.actions.KneelReference"},
    "FallingStart": {"_target_": "zfall.envs.transforms.starts.FallingStart"},
    "ReferenceStart": {"_target_": "zfall.envs.transforms.starts.ReferenceStart"},
    "load_fall_network": {
        "_target_": "zfall.envs.transforms.modes.FallPredictor",
        "network": {"_target_": "zfall.modules.fall_network.load_fall_network"},
    },
}


def world(name: str, **values: str):
    node = {**NODES[name], **values} if name != "load_fall_network" else NODES[name]
    if name == "load_fall_network":
        node = {**node, "network": {**node["network"], **values}}
    return OmegaConf.create({**BASE, "transforms": {"one": node}})


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "file.npz"
    path.write_bytes(b"some")
    return path


@pytest.mark.parametrize("name", NODES)
def test_the_file_that_ships_counts_by_its_content(name, file, monkeypatch):
    key, _ = digests.READ_BY[name]
    before = env_digest(world(name))
    monkeypatch.setitem(digests.READ_BY, name, (key, file))
    after = env_digest(world(name))
    assert after != before
    file.write_bytes(b"other")
    assert env_digest(world(name)) != after


@pytest.mark.parametrize("name", [name for name, (key, _) in digests.READ_BY.items() if key])
def test_a_file_of_ones_own_counts_by_its_content_and_the_one_that_ships_does_not(
    name, file, monkeypatch, tmp_path
):
    key, _ = digests.READ_BY[name]
    cfg = world(name, **{key: str(file)})
    before = env_digest(cfg)
    other = tmp_path / "ships.npz"
    other.write_bytes(b"unread")
    monkeypatch.setitem(digests.READ_BY, name, (key, other))
    assert env_digest(cfg) == before
    file.write_bytes(b"recorded anew")
    assert env_digest(cfg) != before


def test_a_world_that_reads_none_of_them_does_not_depend_on_them(file, monkeypatch):
    cfg = OmegaConf.create({**BASE, "transforms": {"one": {"_target_": "a.B", "list": [1, None]}}})
    before = env_digest(cfg)
    for name, (key, _) in list(digests.READ_BY.items()):
        monkeypatch.setitem(digests.READ_BY, name, (key, file))
    assert env_digest(cfg) == before
