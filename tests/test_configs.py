"""Where the yaml of the recipes is found."""

import math

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf
from omegaconf.errors import InterpolationResolutionError

from tests.conftest import RECIPES
from zfall.configs import compose_config, config_folder, nodes_of, options_of


def test_the_folder_is_that_of_the_recipes():
    assert config_folder() == RECIPES
    assert "push_recovery" in options_of("env")


def test_a_config_is_composed_as_the_shell_does(compose_config):
    ours = globals()["compose_config"](["seed=3", "actor=gru_mog"])
    assert ours == compose_config("seed=3", "actor=gru_mog")
    assert ours.seed == 3


def test_the_hydra_of_another_program_is_left_as_it_was(tmp_path):
    (tmp_path / "other.yaml").write_text("colour: green\n")
    with initialize_config_dir(str(tmp_path), version_base=None):
        assert compose_config(["seed=1"]).seed == 1
        assert compose("other").colour == "green"


def test_nodes_are_found_wherever_they_stand():
    config = {
        "env": {"_target_": "a", "ball": {"_target_": "b", "mass": 1}},
        "terms": {"upright": [0.5, {"_target_": "c"}]},
        "seed": 3,
    }
    found = [(place, node["_target_"]) for place, node in nodes_of(config)]
    assert found == [("env", "a"), ("env.ball", "b"), ("terms.upright.1", "c")]


@pytest.mark.parametrize("place", ["next to the env", "inside of it", "in an env by itself"])
def test_times_are_counted_in_the_steps_of_the_env(place):
    """At 50 Hz 1.2 s are 60 steps, 5 a second is 0.1 a step, and of e**-t exp(-0.02 / 1.3) stays."""
    values = {"steps": "${decisions:1.2}", "left": "${decay:1.3}", "each": "${per_decision:5.0}"}
    env = {"base_env": {"control_dt": 0.02}}
    if place == "next to the env":
        found = OmegaConf.create({"env": env, "loss": values}).loss
    else:
        env["transforms"] = {"reward": values}
        within = OmegaConf.create(env if place == "in an env by itself" else {"env": env})
        found = within.get("env", within).transforms.reward
    assert found.steps == 60
    assert found.left == pytest.approx(math.exp(-0.02 / 1.3))
    assert found.each == pytest.approx(0.1)


def test_a_value_of_a_policy_is_read_from_its_file():
    cfg = OmegaConf.create(
        {"recover": "twin_25hz", "dt": "${policy:${recover},env.base_env.control_dt}"}
    )
    assert cfg.dt == 0.04
    cfg.recover = "twin"
    assert cfg.dt == 0.02
    for run, key, rule in (
        ("nobody", "env", "policy must be a run folder, or one of .*; there is no folder nobody"),
        ("twin", "env.colour", "the policy must have env.colour in its config, twin has none"),
    ):
        with pytest.raises(InterpolationResolutionError, match=rule):
            OmegaConf.to_container(
                OmegaConf.create({"value": f"${{policy:{run},{key}}}"}), resolve=True
            )
