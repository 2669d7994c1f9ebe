"""Where the yaml of the recipes is found."""

from hydra import compose, initialize_config_dir

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
