"""The trigger from the shell."""

import pandas as pd
import pytest

from tests.shell import run


@pytest.mark.parametrize("name", ["atalante"])  # noise, and no delay
def test_a_trigger_is_trained_on_what_there_is_of_noise_and_delay(name, tmp_path):
    few = ["starts=1", "impulses=[0.2,1.5]", "epochs=1"]
    done = run("trigger", f"run={name}", *few, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "fall_network.pt").exists()
    assert {"network", "rule"} == set(pd.read_csv(tmp_path / "trigger.csv")["trigger"])
