"""Where the yaml of the recipes is found."""

from hydra import compose, initialize_config_dir

from tests.conftest import RECIPES
from zfall.configs import compose_config, config_folder, options_of


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
