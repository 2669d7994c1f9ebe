"""Configs that say the same in other words are the same, and those that do not are not."""

import sys
from copy import deepcopy

import pytest

from zfall import migrations
from zfall.meaning import differences, meaning

ADAM = {"_target_": "torch.optim.Adam", "lr": 0.001}


def training(**changes):
    config = {
        "total_frames": 100,
        "seed": 0,
        "optimizer": dict(ADAM),
        "auxiliary_losses": {},
        "env": {
            "base_env": {"_target_": "zfall.envs.humanoid.HumanoidEnv", "control_dt": 0.04},
            "transforms": {
                "push": {"_target_": "zfall.envs.transforms.pushes.RandomPush", "size": [0.1, 0.7]},
                "noise": {"std": {"joint_position": 0.01}},
            },
        },
    }
    for key, value in changes.items():
        *tables, name = key.split("__")
        table = config
        for each in tables:
            table = table[each]
        table[name] = value
    return config


@pytest.mark.parametrize(
    "changes",
    [
        {"total_frames": 100.0},
        {"env__transforms__push__size": (0.1, 0.7)},
        {"alike": 1},
        {"name": "mine", "logger": [{"_target_": "some.Logger"}], "groups": 4},
        {"showcase": {"starts": 3}, "checkpoint_every": 7},
        {"optimizer": ADAM | {"fused": True, "foreach": None, "betas": [0.9, 0.999]}},
        {"augmentation": None, "some_table": {}, "some_list": []},
        {"env__transforms__later": None},
        {"env__transforms__push__interval": None},  # the default of the class
        {"optimizer": {"lr": 1e-3, "_target_": "torch.optim.Adam"}},
    ],
)
def test_other_words_are_the_same(changes):
    assert meaning(training(**changes)) == meaning(training())


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"total_frames": 101}, "total_frames"),
        ({"seed": True}, "seed"),  # no 1
        ({"alike": 2}, "alike"),
        ({"env__transforms__push__size": [0.7, 0.1]}, "env.transforms.push.size.0"),
        ({"env__transforms__push__size": [0.1]}, "env.transforms.push.size.1"),
        ({"env__transforms__push__point": "chest"}, "env.transforms.push.point"),
        ({"optimizer": ADAM | {"betas": [0.9, 0.99]}}, "optimizer.betas.0"),
        ({"optimizer": ADAM | {"lr": float("inf")}}, "optimizer.lr"),
        ({"env__transforms__noise": None}, "env.transforms.noise.std.joint_position"),
        ({"unknown": 3}, "unknown"),
        ({"env__transforms__push___target_": "mine.Push"}, "env.transforms.push._target_"),
    ],
)
def test_other_values_are_not_and_the_key_is_named(changes, key):
    found = differences(meaning(training()), meaning(training(**changes)))
    assert any(line.startswith(f"{key} (") for line in found)


def test_the_order_of_transforms_counts():
    config = training()
    config["env"]["transforms"] = dict(reversed(config["env"]["transforms"].items()))
    (found,) = differences(meaning(training()), meaning(config))
    assert found == "order of env.transforms (push noise stored, noise push wanted)"


def test_nothing_is_changed_in_what_is_given():
    config = training(name="mine", alike=1)
    before = deepcopy(config)
    meaning(config, {"env.base_env.identity": "some"})
    assert config == before


def test_a_key_with_a_line_in_the_table_orphans_nothing(monkeypatch):
    stored = meaning(training())
    assert meaning(training(horizon=3)) != stored
    monkeypatch.setitem(migrations.MISSING, "horizon", 3)
    assert meaning(training(horizon=3)) == meaning(training())
    assert meaning(training(horizon=4)) != meaning(training())


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("env.transforms.push.gap", 0.5),
        ("env.transforms.*.gap", 0.5),
        ("zfall.envs.transforms.pushes.RandomPush.gap", 0.5),
        ("env.transforms.push.gap", [0.5, None]),
    ],
)
def test_a_key_may_be_named_by_its_place_or_by_what_takes_it(monkeypatch, key, value):
    monkeypatch.setitem(migrations.MISSING, key, value)
    new = training(env__transforms__push__gap=value)
    if "*" in key:
        new["env"]["transforms"]["noise"]["gap"] = value
    assert meaning(new) == meaning(training())


def test_a_renamed_key_is_the_same_wherever_it_goes(monkeypatch):
    old = training(env__transforms__push__kick=[0.1, 0.2], spread=0.3)
    inside = training(env__transforms__push__jolt=[0.1, 0.2], env__spread=0.3)
    assert meaning(old) != meaning(inside)
    monkeypatch.setitem(migrations.RENAMED, "env.transforms.*.kick", "jolt")
    monkeypatch.setitem(migrations.RENAMED, "spread", "env.spread")
    assert meaning(old) == meaning(inside)


def test_a_renamed_transform_keeps_its_place(monkeypatch):
    monkeypatch.setitem(migrations.RENAMED, "env.transforms.push", "shove")
    transforms = training()["env"]["transforms"]
    new = training(env__transforms={"shove": transforms["push"], "noise": transforms["noise"]})
    assert meaning(new) == meaning(training())


def test_moved_classes_are_the_same_also_where_no_target_names_them():
    old = {"battery": {"kneel": {"kind": "zfall.envs.transforms.modes.ModeMachine"}}}
    new = {"battery": {"kneel": {"kind": "zfall.falling.modes.ModeMachine"}}}
    assert meaning(old) == meaning(new)


def test_what_names_a_file_counts_by_its_content(monkeypatch):
    places = [{"env.transforms.push.bank": digest} for digest in ("one", "other")]
    named = training(env__transforms__push__bank="a/bank.npz")
    assert meaning(named, places[0]) == meaning(training(), places[0])
    assert meaning(named, places[0]) != meaning(named, places[1])
    monkeypatch.setitem(migrations.SAME_CONTENT, "one", "other")
    assert meaning(named, places[0]) == meaning(named, places[1])


def test_what_is_stored_imports_nothing():
    """A module may do anything when it is imported."""
    sys.modules.pop("this", None)
    config = training(optimizer={"_target_": "this.Zen", "lr": 1})
    assert meaning(config) == meaning(deepcopy(config))
    assert "this" not in sys.modules
