"""A servo of one's own from the shell: logs in, a set of servos out."""

import pandas as pd
import pytest
import yaml
from hydra.utils import instantiate

from tests.servo_logs import drawn_servo, simulated_log
from tests.shell import run
from zfall.robots import ZEROTH01
from zfall.simulation.model import compile_model


@pytest.fixture(scope="module")
def pendulum(tmp_path_factory):
    """A csv file of a pendulum's log."""
    log = simulated_log(drawn_servo(7), "pendulum", 7)
    columns = {"time_s": log.time, "target_rad": log.target, "position_rad": log.position}
    path = tmp_path_factory.mktemp("logs") / "pendulum.csv"
    pd.DataFrame(columns | {"voltage_v": log.voltage}).to_csv(path, index=False)
    return path


def test_a_log_becomes_a_set_of_servos_that_the_robot_takes(pendulum, tmp_path):
    options = ["mass=1.0", "arm=0.15", "joints=[left_knee_pitch]", "physics_dt=0.004"]
    done = run("identify", f"log={pendulum}", *options, f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 0, done.stderr
    assert f"--config-dir {tmp_path}/out servo=identified" in done.stdout
    assert (tmp_path / "out" / "fit.png").stat().st_size > 10_000
    rows = pd.read_csv(tmp_path / "out" / "estimates.csv").set_index("name")
    true = drawn_servo(7).servo
    assert rows.value["stall_torque"] == pytest.approx(true.stall_torque, rel=0.03)
    text = (tmp_path / "out" / "servo" / "identified.yaml").read_text()
    servos = instantiate(yaml.safe_load(text)["servos"], _convert_="all")
    model = compile_model(ZEROTH01, physics_dt=0.004, servos=servos)
    knee, ankle = (servos[joint] for joint in ("left_knee_pitch", "left_ankle_pitch"))
    assert knee.stall_torque == pytest.approx(rows.value["stall_torque"], rel=1e-4)
    assert ankle.stall_torque == pytest.approx(50 * 0.0980665)  # the sheet's
    assert model.joint("left_knee_pitch").damping[0] == pytest.approx(knee.damping)
    config = run("train", "--config-dir", f"{tmp_path}/out", "servo=identified", "--cfg", "job")
    assert f"stall_torque: {knee.stall_torque:.5g}" in config.stdout


@pytest.mark.parametrize(("options", "message"), [
    (["log=absent.csv"], "log must be a csv file or a list of them, there is no absent.csv"),
    (["mass=[0,1]"], "mass must be one number or 1, as the logs, got [0, 1]"),
    (["mass=1"], "arm must be positive for a mass of 1 kg, got 0"),
    (["sheet.name=STS9"], "sheet: name must be one of STS3250, STS3215, XL330-M288, got 'STS9'"),
    (["sheet.kp=300"], "sheet: kp of the servo STS3250 must be a whole number within [0, 254]"),
    (["sheet.name=XL330-M288"], "joints must be given for a XL330-M288"),
    (["joints=[tail]"], "got tail"),
    (["+sheet.voltage_range=[6,11]", "+sheet.voltage=11"], "must be within its sheet's [6, 11] V"),
    (["physics_dt=0"], "physics_dt must be positive and finite, got 0"),
    (["mass=-1"], "mass must be finite and not negative, got -1"),
    (["arm=nan"], "arm must be"),
])  # fmt: skip
def test_what_is_wrong_is_said_in_one_line(options, message, pendulum, tmp_path):
    done = run("identify", f"log={pendulum}", *options, f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()
