"""Plans of studies: what would fail after training fails before."""

import re
from pathlib import Path

import pytest
from hydra.utils import instantiate
from omegaconf import OmegaConf

from zfall.configs import config_folder
from zfall.evaluation.battery import battery_env
from zfall.studies import Study
from zfall.studies.plan import battery_of, in_test


@pytest.mark.parametrize(
    ("change", "key", "value"),
    [
        ({"training_size": "0.45"}, "study.training_size", "0.45"),
        ({"training_size": "abc"}, "study.training_size", "abc"),
        ({"training_size": None}, "study.training_size", "None"),
        ({"battery": {"name": "planar", "start": 1}}, "study.battery", "start"),
        ({"battery": {"name": "plane"}}, "study.battery", "plane"),
        ({"seeds": [0, 0]}, "study.seeds", "[0, 0]"),
        ({"rows": {"a": [], "b": ["symmetry=none"]}}, "b (seed 0)", "a (seed 0)"),
        ({"tests": {"a": None, "b": None}}, "none (seed 0, b)", "none (seed 0, a)"),
        ({"rows": {"a": ["+minibatch=7"]}}, "study.rows.a: minibatch", "minibatches"),
        ({"rows": {"a": ["+loss.clip=1"]}}, "study.rows.a: loss.clip", "clip_epsilon"),
        ({"rows": {"a": ["num_envs=0"]}}, "study.rows.a: num_envs", "0"),
        ({"rows": {"a": ["seed=5"]}}, "study.rows.a: seed", "5"),
        ({"rows": {"a": ["resume=x"]}}, "study.rows.a: resume", "x"),
        ({"rows": {"a": ["warm_start=nope"]}}, "study.rows.a: warm_start", "nope"),
        ({"rows": {"a": ["+auxiliary_losses.x=3"]}}, "study.rows.a: auxiliary_losses.x", "3"),
        ({"rows": {"a": ["augmentation=3"]}}, "study.rows.a: augmentation", "3"),
        ({"rows": {"a": ["+loss._target_=no.X"]}}, "study.rows.a: loss._target_", "no.X"),
        ({"rows": {"a": ["scheduler.min_lr=x"]}}, "study.rows.a: scheduler.min_lr", "x"),
        ({"rows": {"a": ["env.base_env=3"]}}, "study.rows.a: env.base_env", "3"),
        ({"tests": {"n": ["+minibatch=7"]}}, "study.tests.n: minibatch", "minibatches"),
        ({"tests": {"n": ["env.transforms.nois=null"]}}, "study.tests.n", "nois"),
        (
            {"tested_with": {"none": {"_target_": "zfall.robots.Ball", "radius": 1, "mass": 1}}},
            "study.tested_with.none",
            "zfall.robots.Ball",
        ),
        (
            {"tested_with": {"none": {"_target_": "zfall.no.Where"}}},
            "study.tested_with.none",
            "zfall.no",
        ),
    ],
)
def test_what_would_fail_after_training_is_refused_before(tiny, change, key, value):
    with pytest.raises(ValueError, match=f"{re.escape(key)}.*{re.escape(value)}"):
        _ = tiny(**change).plan


@pytest.mark.parametrize("missing", ["name", "rows", "battery"])
def test_a_yaml_without_what_a_study_needs_is_refused(missing):
    config = OmegaConf.load(config_folder() / "study" / "symmetry.yaml")
    config[missing] = None
    with pytest.raises(ValueError, match=f"study.{missing} "):
        Study.from_config(config)


def test_a_key_that_nothing_reads_is_refused():
    config = OmegaConf.load(config_folder() / "study" / "symmetry.yaml")
    with pytest.raises(ValueError, match=r"study.row_seed .*row_seeds\?"):
        Study.from_config(OmegaConf.merge(config, {"row_seed": 1}))


def test_a_world_takes_what_the_policy_sees_and_does_and_nothing_else(tiny):
    """Twice as many control steps, another range of the action; noise as in the test."""
    own = [
        "env.base_env.control_dt=0.02",
        "env.transforms.action.scale=0.3",
        "env.transforms.noise.std.joint_position=0.5",
    ]
    noisy = {"noisy": ["env.training_only.noise=false"]}
    one, _ = tiny(rows={"own": own}, tests=noisy).plan
    env_cfg = in_test(one.tests[0], one.cfg.env)
    assert env_cfg.base_env.control_dt == 0.02
    assert env_cfg.transforms.action.scale == 0.3
    assert env_cfg.transforms.noise.std.joint_position == 0.01
    assert env_cfg.training_only.noise is False


def test_rows_may_have_their_own_seeds_and_frames(tiny):
    rows = {"short": [], "long": ["total_frames=512"]}
    plan = tiny(rows=rows, row_seeds={"long": [7]}).plan
    assert [(run.row, run.seed, run.cfg.total_frames) for run in plan] == [
        ("short", 0, 256),
        ("short", 1, 256),
        ("long", 7, 512),
    ]


@pytest.mark.long
@pytest.mark.parametrize(
    "name", sorted(path.stem for path in Path(config_folder() / "study").glob("*.yaml"))
)
def test_every_row_of_the_studies_that_ship_can_be_built(name):
    study = Study.from_config(OmegaConf.load(config_folder() / "study" / f"{name}.yaml"))
    built = set()  # rows that differ in their learning share an env
    for planned in {one.row: one for one in study.plan}.values():
        own = OmegaConf.to_yaml(planned.cfg.env)
        if own not in built:
            built.add(own)
            env = instantiate(planned.cfg.env, base_env={"num_envs": 2})
            assert env.reset()["observation"].shape[0] == 2
        for test in planned.tests:
            world = in_test(test, planned.cfg.env)
            if (tested := "test " + OmegaConf.to_yaml(world)) not in built:
                built.add(tested)
                env, _, _ = battery_env(battery_of(study), world, 2)
                assert env.reset()["observation"].shape[0] == 2
