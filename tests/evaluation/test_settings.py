"""What ``recipes.evaluate`` was given."""

from omegaconf import OmegaConf

from zfall.evaluation.definitions import load_battery
from zfall.evaluation.settings import names_of


def test_a_trial_may_be_run_alone_with_noise_kept_on():
    """It draws from its own streams, and is the same trial."""
    cfg = OmegaConf.create({"run": "best", "runs": None, "trial": 3, "keep": ["noise"]})
    assert names_of(cfg, load_battery("planar")) == ["best"]
