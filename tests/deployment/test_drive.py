"""An exported policy drives the simulated robot, and a broken one stops it."""

import json
import sys

import numpy as np
import pandas as pd
import pytest

from tests.shell import run
from zfall.deployment import Settings, SimulatedBus, drive
from zfall.deployment.bus import PRESENT_TEMPERATURE, TORQUE_ENABLE, to_angle, to_steps
from zfall.deployment.dry_run import compare
from zfall.deployment.log import Log
from zfall.deployment.loop import Stopped
from zfall.deployment.simulated import pushed
from zfall.evaluation.candidate import load_candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.statistics import wilson
from zfall.policies.exported import ExportedPolicy

OWN = """
from zfall.deployment.bus import PRESENT_TEMPERATURE
from zfall.robots import ZEROTH01

class Frozen:
    robot, joints, quantities = "zeroth01", list(ZEROTH01.joints), ["base_angular_velocity", "base_acceleration"]

    def __init__(self, *, file):
        self.time, self.file = 0.0, open(file, "w")

    def now(self):
        return self.time

    def wait_until(self, time):
        self.time = max(self.time, time)

    def write(self, register, values):
        print(register.address, *values.values(), file=self.file)

    def read(self, register, joints):
        return dict.fromkeys(joints, 30 if register is PRESENT_TEMPERATURE else 2048)

    def sense(self):
        import numpy as np
        gyro, gravity = np.zeros(3, np.float32), np.array([0, 0, 9.81], np.float32)
        return {"base_angular_velocity": gyro, "base_acceleration": gravity}

    def close(self):
        print("closed", file=self.file)
        self.file.close()
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The policy ``twin``, exported."""
    pytest.importorskip("onnxruntime")
    path = tmp_path_factory.mktemp("twin")
    done = run("export", "run=twin", f"hydra.run.dir={path}")
    assert done.returncode == 0, done.stderr
    return path


@pytest.fixture
def bus():
    """The twin at rest, in simulated time."""
    own = load_candidate("twin")
    bus = SimulatedBus(load_battery("twin", starts=1), own.env_cfg, realtime=False)
    pushed(bus, force=(0.0, 0.0), seed=0, cut=None)
    return bus


@pytest.mark.long
def test_a_dry_run_passes_the_pushes_that_the_fast_path_passes(folder):
    """Six trials of battery twin, of which the fast path stands most: within its interval."""
    own = load_candidate("twin")
    battery = load_battery("twin", starts=1, directions=3, impulses=[0.2], end_time=5.0)
    bus = SimulatedBus(battery, own.env_cfg, realtime=False)
    table = compare(ExportedPolicy(folder), bus, own.env_cfg, own.actor)
    low, high = wilson(int(table["recovered_in_zfall"].sum()), len(table))
    assert low <= table["recovered"].mean() <= high
    assert table["recovered"].mean() >= 0.5


def test_a_cut_cable_stops_the_robot_within_the_watchdog(folder, tmp_path):
    """Cut after 1.5 s; 50 ms without answers, a step of 20 ms and a retry of 5 ms later it ends."""
    out = tmp_path / "out"
    done = run("drive", f"policy={folder}", "seconds=3", "cut=1.5", "realtime=false",
               f"hydra.run.dir={out}")  # fmt: skip
    assert done.returncode == 1
    assert done.stderr.startswith("error: stopped, servos hold: no answer of 20 of 20 servos")
    assert "jitter" in done.stdout
    table = pd.read_csv(out / "drive.csv")
    last = table.iloc[-1]
    assert last["event"].startswith("stopped, servos hold: no answer")
    assert 1.5 < last["time_s"] <= 1.5 + 0.05 + 0.02 + 0.005


def test_limp_switches_the_torque_off_and_hot_servos_stop(folder, bus):
    log = Log(None, bus.joints)
    settings = Settings(hottest=20.0, stop="limp", settle=0.04)
    with pytest.raises(Stopped, match="has 25 degrees Celsius, at most 20"):
        drive(ExportedPolicy(folder), bus, seconds=1.0, log=log, settings=settings)
    assert float(bus.base.parameters.values["servo_torque_limit"].abs().max()) == 0.0
    assert len(log.events) == 1


def test_a_limp_stop_that_fails_hides_nothing(folder, bus, monkeypatch):
    """The servos are too hot, and then the bus is gone: both are said, the first one first."""
    write = bus.write

    def gone(register, values):
        if register is TORQUE_ENABLE and 0 in values.values():
            raise OSError("no such device")
        write(register, values)

    monkeypatch.setattr(bus, "write", gone)
    log = Log(None, bus.joints)
    settings = Settings(hottest=20.0, stop="limp", settle=0.04)
    with pytest.raises(Stopped, match=r"at most 20; .* failed too: no such device"):
        drive(ExportedPolicy(folder), bus, seconds=1.0, log=log, settings=settings)
    assert log.events[0].startswith("stopped, servos not limp: ")


def test_a_temperature_that_nobody_tells_is_unknown_and_stops_the_robot(folder, bus, monkeypatch):
    """One servo is asked in each step, 20 in turn: the third silence of the first is question 41."""
    read = bus.read
    monkeypatch.setattr(
        bus, "read", lambda what, who: {} if what is PRESENT_TEMPERATURE else read(what, who)
    )
    log = Log(None, bus.joints)
    with pytest.raises(Stopped, match=f"no temperature of {bus.joints[0]} for 3 questions"):
        drive(ExportedPolicy(folder), bus, seconds=3.0, log=log, settings=Settings(settle=0.04))
    assert len(log.steps) == 41
    assert "no servo answered with its temperature" in log.report(0.02)[-1]
    pushed(bus, force=(0.0, 0.0), seed=0, cut=None)
    log, settings = Log(None, bus.joints), Settings(settle=0.04, hottest=None)
    drive(ExportedPolicy(folder), bus, seconds=2.0, log=log, settings=settings)
    assert len(log.steps) == 98


def test_a_robot_of_your_own_is_driven(folder, tmp_path, monkeypatch):
    """Its file has the gains first and the last target at the end, at most 4095 steps each."""
    (tmp_path / "my_robot.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    heard = tmp_path / "heard.txt"
    done = run("drive", f"policy={folder}", f"bus={{_target_: my_robot.Frozen, file: {heard}}}",
               "trust=[my_robot]", "seconds=0.4", "settings.settle=0.2",
               f"hydra.run.dir={tmp_path}/out")  # fmt: skip
    assert done.returncode == 0, done.stderr
    lines = heard.read_text().splitlines()
    assert lines[-1] == "closed"
    assert [line.split()[0] for line in lines[:4]] == ["21", "41", "85", "48"]  # 0x15, 0x29 ...
    goals = np.array([line.split()[1:] for line in lines[4:-1] if line.startswith("42 ")], int)
    assert goals.shape == (21, 20)  # as it stands, then twenty control steps of 20 ms
    assert (goals[0] == 2048).all()
    assert (goals[-1] != 2048).any()
    assert "hottest" in done.stdout
    assert "30 degrees Celsius" in done.stdout
    assert len(pd.read_csv(tmp_path / "out" / "drive.csv")) == 10


def test_the_nominal_robot_measures_everything_and_is_stood_up_by_the_policy(folder):
    own = load_candidate("twin")
    bus = SimulatedBus(load_battery("planar"), own.env_cfg, realtime=False)
    assert {"com_velocity", "feet_force"} <= {*bus.quantities}
    pushed(bus, force=(0.0, 0.0), seed=0, cut=None)
    drive(ExportedPolicy(folder), bus, seconds=3.0, log=Log(None, bus.joints))
    assert not bus.outcomes.table()["fell"].any()


def test_what_is_not_installed_is_named(folder, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    done = run("drive", f"policy={folder}", f"hydra.run.dir={tmp_path}/out")
    assert done.returncode == 1
    assert 'needs onnxruntime: .venv/bin/pip install -e ".[export]"' in done.stderr
    assert done.stderr.count("\n") == 1


def test_a_sensor_that_gives_no_number_stops_the_robot(folder, bus, monkeypatch):
    sense = bus.sense

    def broken():
        gyro = np.full(3, np.nan if bus.now() > 0.5 else 0.0, np.float32)
        return {**sense(), "base_angular_velocity": gyro}

    monkeypatch.setattr(bus, "sense", broken)
    log = Log(None, bus.joints)
    with pytest.raises(Stopped, match="base_angular_velocity"):
        drive(ExportedPolicy(folder), bus, seconds=1.0, log=log, settings=Settings(settle=0.04))
    assert bus.now() == pytest.approx(0.52)  # the first step of 20 ms after it


def test_control_steps_begin_where_the_simulated_robot_measures(folder, bus):
    """Opened 10 ms late, its first step of 20 ms begins at 20 ms, and each after it in time."""
    bus.wait_until(0.01)
    log = Log(None, bus.joints)
    drive(ExportedPolicy(folder), bus, seconds=0.4, log=log, settings=Settings(settle=0.04))
    times = np.array([row["time_s"] for row in log.steps])
    np.testing.assert_allclose(times / 0.02, np.round(times / 0.02), atol=1e-6)
    assert times[0] == pytest.approx(0.06)  # after the two steps that settle


def test_a_drive_that_is_over_before_the_policy_acts_is_refused(folder, bus):
    with pytest.raises(ValueError, match=r"seconds must be above settings\.settle"):
        drive(ExportedPolicy(folder), bus, seconds=1.0, log=Log(None, bus.joints))


def test_a_policy_is_not_run_without_what_it_reads(folder):
    with pytest.raises(ValueError, match="sensors must have"):
        ExportedPolicy(folder).step({"joint_position": np.zeros(20)})


def test_encoder_steps_and_angles_go_round():
    assert [to_steps(x) for x in (0.0, np.pi / 2, -np.pi / 2, 9.0, -9.0)] == [
        2048,
        3072,
        1024,
        4095,
        0,
    ]
    assert to_angle(3072) == pytest.approx(np.pi / 2)


def test_a_robot_that_is_another_is_refused_in_one_line(folder, tmp_path):
    other = json.loads((folder / "policy.json").read_text())
    (tmp_path / "policy.onnx").write_bytes((folder / "policy.onnx").read_bytes())
    for change, message in (
        ({"joints": other["joints"][:19]}, "must command 1 ticks of 19 joints"),
        ({"robot": "other"}, "policy must be of the robot on the bus"),
        ({"format": 1}, "must be what this zfall exports, format 2, got format 1"),
    ):
        (tmp_path / "policy.json").write_text(json.dumps(other | change))
        done = run(
            "drive",
            f"policy={tmp_path}",
            "seconds=2",
            "realtime=false",
            f"hydra.run.dir={tmp_path}/out",
        )
        assert done.returncode == 1
        assert message in done.stderr
        assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["policy=nowhere"], "policy must be a folder with policy.json, got nowhere"),
        (["bus=serial"], "bus must be one of twin, nominal, or a table"),
        (["settings.acceleration=255"], "settings.acceleration must be 0 to 254"),
        (["settings.acceleration=20"], "acceleration must be 0 on a simulated bus, got 20"),
    ],
)
def test_bad_input_is_one_line(folder, tmp_path, words, message):
    done = run(
        "drive",
        f"policy={folder}",
        *words,
        "seconds=2",
        "realtime=false",
        f"hydra.run.dir={tmp_path}/out",
    )
    assert done.returncode == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
