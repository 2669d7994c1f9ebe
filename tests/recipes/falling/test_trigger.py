"""The trigger from the shell."""

import re

import pandas as pd
import pytest

from tests.shell import run


@pytest.mark.parametrize("name", ["atalante"])  # noise, and no delay
def test_a_trigger_is_trained_on_what_there_is_of_noise_and_delay(name, tmp_path):
    few = ["starts=1", "impulses=[0.2,1.5]", "epochs=1"]
    done = run("falling.trigger", f"run={name}", *few, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "fall_network.pt").exists()
    assert {"network", "rule"} == set(pd.read_csv(tmp_path / "trigger.csv")["trigger"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("epochs=0", "epochs .*, got 0"),
        ("hidden_size=a", "hidden_size .*, got a"),
        ("starts=0", "starts .*, got 0"),
        ("impulses=[0.1]", "impulses and starts .* fell"),
        ("measured=[joint_angle]", "measured .*, got joint_angle"),
    ],
)
def test_what_no_network_can_learn_from_is_refused(given, message, tmp_path):
    done = run("falling.trigger", "run=best", "starts=1", given, f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 1
    assert re.search(f"^error: {message}", done.stderr)
    assert not (tmp_path / "out").exists()
