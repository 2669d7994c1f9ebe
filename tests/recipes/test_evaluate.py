"""Batteries from the shell: their files, what is kept and what is refused."""

import html
import json
import re
import shlex

import pandas as pd
import pytest

from tests.shell import SMALL, run

SMALL_SETTING = "planar_point-pelvis_directions-2_impulses-0.2_starts-1_end_time-4.0"


@pytest.fixture(scope="module")
def evaluated(trained):
    """The results of a run in a small battery."""
    done = run("evaluate", f"run={trained}", "battery=planar", *SMALL, "num_envs=64")
    assert done.returncode == 0, done.stderr
    return trained / "evaluation" / SMALL_SETTING


ENVELOPE = ["battery=envelope", "point=torso", "directions=2", "impulses=[0.8]", "starts=1",
            "num_envs=64", "resolution=0.4", "end_time=3.6"]  # fmt: skip


@pytest.fixture(scope="module")
def envelope(trained):
    """The results of a run in a small envelope."""
    done = run("evaluate", f"run={trained}", *ENVELOPE)
    assert done.returncode == 0, done.stderr
    setting = "envelope_point-torso_directions-2_impulses-0.8_starts-1_resolution-0.4_end_time-3.6"
    return trained / "evaluation" / setting


@pytest.mark.long
def test_battery_of_a_run(evaluated):
    folder = evaluated
    summary = json.loads((folder / "summary.json").read_text())
    assert {"battery_version", "n", "i50_mean", "i50_min", "i90_mean", "i50", "success", "success_low",
            "success_high", "control_falls", "control_n"} <= set(summary)  # fmt: skip
    trials = pd.read_csv(folder / "trials.csv")
    assert len(trials) == summary["n"] == 4
    assert {"direction_rad", "impulse", "duration_s", "force_n", "body", "seed", "recovered", "fell",
            "kneeled", "time_to_fall_s", "peak_base_acceleration",
            "peak_contact_force"} <= set(trials.columns)  # fmt: skip
    assert (folder / "success_map.png").exists()


@pytest.mark.parametrize("name", ["pose_hold", "limp"])
def test_battery_of_a_baseline_goes_into_hydras_folder(name, tmp_path):
    done = run("evaluate", f"run={name}", *SMALL, "num_envs=64", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    summary = json.loads((tmp_path / "evaluation" / SMALL_SETTING / "summary.json").read_text())
    assert summary["control_falls"] == (2 if name == "limp" else 0)
    assert summary["definition"]["starts"] == 1


@pytest.mark.parametrize("given", [[], ["run=nowhere"]])
def test_an_evaluation_of_nothing_says_what_there_is(given):
    done = run("evaluate", *given)
    assert done.returncode == 1
    assert "run must be a run folder, or" in done.stderr
    assert "pose_hold" in done.stderr


def test_an_interrupted_battery_goes_on_and_ends_as_if_it_had_not_been(tmp_path, monkeypatch):
    """Cut off after the first of two chunks; the rest is run, and the file is the same.

    A limp robot soon lies on the floor, with a push or without, and so soon that is known.
    """
    from zfall.evaluation import run as library

    args = ["run=limp", "starts=10", "directions=3", "impulses=[0.1,0.3]", "point=chest",
            "end_time=3.6", "num_envs=64", f"hydra.run.dir={tmp_path}"]  # fmt: skip
    setting = "planar_point-chest_directions-3_impulses-0.1,0.3_starts-10_end_time-3.6"
    folder = tmp_path / "evaluation" / setting
    assert run("evaluate", *args).returncode == 0
    whole = (folder / "trials.csv").read_bytes()
    write = library.write_trials

    def cut_off(path, trials, conditions):
        write(path, trials, conditions)
        raise KeyboardInterrupt

    monkeypatch.setattr(library, "write_trials", cut_off)
    stopped = run("evaluate", *args)
    assert (stopped.returncode, stopped.stderr) == (130, "stopped\n")
    monkeypatch.setattr(library, "write_trials", write)
    assert len(pd.read_csv(folder / "trials.partial.csv")) == 64
    done = run("evaluate", *args)
    assert "goes on after 64 trials" in done.stdout.replace("\n", " ")
    assert (folder / "trials.csv").read_bytes() == whole
    assert not (folder / "trials.partial.csv").exists()


@pytest.mark.long
def test_runs_side_by_side_read_what_was_run_before(trained, tmp_path):
    more = [*SMALL, "num_envs=64", f"hydra.run.dir={tmp_path}"]
    done = run("evaluate", f"runs=[{trained},pose_hold,limp]", *more)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "comparison" / SMALL_SETTING
    table = pd.read_csv(folder / "comparison.csv").set_index("run")
    assert table.loc[str(trained), "difference"] == 0.0
    assert table.loc["limp", "success"] == 0.0
    assert table.loc["limp", "control_falls"] == 2
    assert (folder / "overlay.png").exists()
    assert (folder / "overlay.pdf").exists()
    page = html.unescape((folder / "report.html").read_text())
    assert f"-m recipes.evaluate 'runs=[{trained},pose_hold,limp]' starts=1" in page
    assert f"{' '.join(map(shlex.quote, SMALL))} num_envs=64" in page
    again = run("evaluate", f"runs=[{trained},pose_hold,limp]", *more)
    assert again.stdout.count("read from") == 3
    assert pd.read_csv(folder / "comparison.csv").set_index("run").equals(table)


def test_a_trial_run_alone_is_the_same_trial(trained, evaluated):
    trials = pd.read_csv(evaluated / "trials.csv")
    done = run("evaluate", f"run={trained}", *SMALL, "trial=3")
    assert done.returncode == 0, done.stderr
    for key in ("peak_tilt", "joint_torque_rms", "recovered", "displacement"):
        value = trials[key][3]
        shown = f"{value:.4g}" if isinstance(value, float) else str(value)
        assert f"{key}: {shown}" in done.stdout
    folder = evaluated
    traces = pd.read_csv(folder / "trial_3.csv")
    assert len(traces) == 100  # 4 s
    assert traces["target/left_knee_pitch"].iloc[0] != 0.0
    assert (folder / "trial_3_left_hip_pitch.png").exists()
    bad = run("evaluate", f"run={trained}", *SMALL, "trial=3", "joint=left_wing")
    assert "joint must be one of right_hip_yaw" in bad.stderr
    bad = run("evaluate", f"run={trained}", *SMALL, "trial=999")
    assert bad.returncode != 0
    assert "trial must be one of 0 to 3, got 999" in bad.stderr


@pytest.mark.long
def test_results_of_one_setting_do_not_overwrite_those_of_another(trained, evaluated):
    before = (evaluated / "trials.csv").read_bytes()
    changed = ["battery.max_tilt=0.3", 'change=["transforms.action.scale=0.3"]']
    for more in (["keep=[noise]", "seed=7"], changed):
        assert run("evaluate", f"run={trained}", *SMALL, *more).returncode == 0
    assert (evaluated / "trials.csv").read_bytes() == before
    stems = [path.name for path in (trained / "evaluation").glob("planar_*")]
    assert f"{SMALL_SETTING}_keep-noise_seed-7" in stems
    page = html.unescape((trained / "report.html").read_text())
    assert all(f"Battery {name.replace('_', ' ')}" in page for name in stems)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (["runs=best"], "error: runs must be a list, [best], or null, got best."),
        (["run=best", "keep=noise"], "error: keep must be a list, [noise], got noise."),
        (["run=[best,kneel]"], "error: run must be text or null, got ['best', 'kneel']."),
        (["run=best", "num_envs=abc"], "error: num_envs must be a whole number, got abc."),
        (["run=best", "seed=-1"], "error: seed must be at least 0 and below 2^63, got -1."),
        (["run=best", "point=5"], "error: point must be text or a list, [5], or null, got 5."),
        (["run=best", "env=icub_balance"], "error: env must be given for baselines alone, best"),
        (["run=best", "video=true"], "error: video needs a trial"),
        (["run=best", "slow=0.5", "trial=3"], "error: slow needs a film"),
        (["run=best", "shown=[1,2]", "trial=3"], "error: shown needs a film"),
        (
            ["run=best", "battery=twin", "servo=datasheet"],
            "error: servo must be left out with a battery whose world has servos of its own",
        ),
        (
            ["run=best", "battery=twin", "keep=[noise]"],
            "error: keep must not name noise: the battery has hardware of its own, "
            "battery.world.PART.NAME.KEY=VALUE changes that.",
        ),
        (
            ["runs=[pose_hold,best]", "battery=twin", "keep=[noise]"],
            "error: keep must not name noise",
        ),
        (
            ["run=best", "battery=twin", "change=['transforms.noise.std.feet_force=2.0']"],
            "error: change must not name noise: the battery has hardware of its own",
        ),
        (
            ["run=best", "change=['transforms.noise.std.feet_force=2.0']"],
            "error: change must name what acts, noise is left out of trials: keep=[noise] leaves "
            "it on.",
        ),
        (
            ["run=best", "change=['transforms.push.point=chest']"],
            "error: change must name what acts, push is left out of trials: a battery has its own.",
        ),
        (["run=best", "checkpoint=foo"], "error: checkpoint must be last or best of best, got foo"),
        (["run=limp", "checkpoint=foo"], "error: checkpoint must be last or best of limp, got foo"),
        (["run=best", "starts=abc"], "error: starts must be a whole number or null, got abc."),
        (["run=best", "impulses=0.4"], "error: impulses must be a list, [0.4], or null, got 0.4."),
        (
            ["run=best", "battery=spherical", "resolution=0.1"],
            "error: battery.resolution must be null",
        ),
        (["run=best", "battery=linear"], "error: In 'evaluate': Could not find 'battery/linear'"),
        (
            ["run=best", "battery.max_tilt=low"],
            "error: battery.max_tilt must be a number, got low.",
        ),
        (
            ["run=best", "battery.kind=zfall.evaluation.Round"],
            "error: battery.kind must name something",
        ),
    ],
)
def test_values_that_make_no_sense_are_refused_in_one_line(given, message):
    done = run("evaluate", *given)
    assert done.returncode == 1
    assert message in done.stderr
    assert done.stderr.count("\n") == 1


def test_run_and_runs_exclude_each_other(trained):
    done = run("evaluate", f"run={trained}", f"runs=[{trained}]")
    assert "runs a list of them; got both" in done.stderr


def test_envelope_of_a_run_is_drawn_with_that_of_pose_hold(trained, envelope):
    folder = envelope
    table = pd.read_csv(folder / "envelope.csv")
    assert len(table) == 2
    assert table["largest"].isin([0.0, 0.4, 0.8]).all()
    for name in ("trials.csv", "summary.json", "envelope.png", "envelope.pdf"):
        assert (folder / name).exists(), name
    assert not (folder / "rounds").exists()
    bad = run("evaluate", f"runs=[{trained},pose_hold]", "battery=envelope")
    assert "runs needs a battery whose trials are the same" in bad.stderr


@pytest.mark.long
def test_an_interrupted_envelope_goes_on_after_its_last_round(trained, envelope, monkeypatch):
    from zfall.evaluation import run as library

    args, folder = [f"run={trained}", *ENVELOPE], envelope
    whole = (folder / "trials.csv").read_bytes(), (folder / "envelope.csv").read_bytes()
    real, labels = library.run_battery, []

    def counted(*given, **known):
        labels.append(len(labels))
        if len(labels) == 3:
            raise KeyboardInterrupt
        return real(*given, **known)

    monkeypatch.setattr(library, "run_battery", counted)
    stopped = run("evaluate", *args)
    assert (stopped.returncode, stopped.stderr) == (130, "stopped\n")
    assert len(list((folder / "rounds").glob("*.csv"))) == 2
    assert run("evaluate", *args).returncode == 0
    assert len(labels) == 3 + 6 - 2  # two policies, a control arm and two rounds each
    assert ((folder / "trials.csv").read_bytes(), (folder / "envelope.csv").read_bytes()) == whole


@pytest.mark.parametrize(
    ("battery", "files"),
    [
        (["battery=spherical", "point=[torso,pelvis]", "impulses=[0.1]", "duration=[0.1,0.2]", "starts=1",
          "end_time=3.0"], ["withstood.png", "withstood.pdf", "withstood.md"]),
        (["battery=kneel", "impulses=[1.0]", "directions=2", "starts=1", "force_starts=1",
          "end_time=1.5"], ["outcomes.md", "outcomes.csv"]),
    ],
)  # fmt: skip
def test_other_batteries_write_their_files(trained, battery, files):
    done = run("evaluate", f"run={trained}", *battery, "num_envs=64")
    assert done.returncode == 0, done.stderr
    (folder,) = (trained / "evaluation").glob(f"{battery[0].removeprefix('battery=')}_*")
    for name in ["trials.csv", "summary.json", *files]:
        assert (folder / name).exists(), name
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["control_falls"] == 0
    page = (trained / "report.html").read_text()
    assert f"Battery {folder.name.replace('_', ' ')}" in page


def test_of_a_refused_battery_nothing_stays(trained, tmp_path):
    before = sorted(trained.rglob("*"))
    done = run("evaluate", f"run={trained}", "battery=planar", "point=nose")
    assert done.stderr.startswith("error: point must be a push point or a link, one of elbow")
    assert len(done.stderr.splitlines()) == 1
    assert sorted(trained.rglob("*")) == before
    folder = tmp_path / "out"
    done = run("evaluate", "run=pose_hold", "point=nose", f"hydra.run.dir={folder}")
    assert "point must be a push point" in done.stderr
    assert not folder.exists()


USERS = """
import numpy as np

from zfall.evaluation.kinds.planar import Planar
from zfall.evaluation.plans import grid


class Lean:
    outcomes = ()

    def __init__(self, env):
        self.forward = np.zeros(env.num_envs, dtype=bool)

    def before(self, td, now):
        pass

    def update(self, td, now):
        self.forward |= (td["projected_gravity"][:, 0] > 0.1).numpy()

    def table(self, ended):
        import torch

        return {"leant_forward": torch.from_numpy(self.forward)}


def plan(battery, impulse_unit, seed):
    trials = grid(battery, impulse_unit, seed)
    return trials[trials["impulse"] > 0].reset_index(drop=True)


def passed(battery, trials):
    return {"passed": float(trials["leant_forward"].mean()), "control_falls": 0, "control_n": 0}


class Forward:
    independent, needs_training_size, baseline_task = True, False, "push_recovery"
    pushes, columns = staticmethod(lambda *a: Planar.pushes(*a)), lambda self, *_: {}
    plan, summary = staticmethod(plan), staticmethod(passed)

    def check(self, battery):
        pass

    def background(self, battery):
        return None

    def write(self, result, folder):
        from zfall.evaluation.writers import Written

        return Written(shown=[f"passed {result.summary['passed']}"])


class Slack:
    servos = True

    def fits(self, env_cfg):
        return True

    def world(self, env_cfg):
        return env_cfg
"""


def test_a_users_battery_and_baseline_are_a_yaml_and_a_class_each(tmp_path, monkeypatch):
    """Pushed to the front all lean forward, pushed to the back none: one of two trials."""
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "users_battery.py").write_text(USERS)
    for group, name, text in (
        ("battery", "mine", "defaults: [planar, _self_]\nname: mine\nkind: users_battery.Forward\n"
         "measures: [users_battery.Lean]\nimpulses: [0.9]\nstarts: 1\ndirections: 2\nend_time: 4.0\n"),
        ("baseline", "slack", "_target_: users_battery.Slack\n"),
    ):  # fmt: skip
        (tmp_path / group).mkdir()
        (tmp_path / group / f"{name}.yaml").write_text(text)
    out = f"hydra.run.dir={tmp_path}/out"
    done = run("evaluate", f"--config-dir={tmp_path}", "battery=mine", "run=slack", out)
    assert done.returncode == 0, done.stderr
    assert "passed 0.5" in done.stdout
    trials = pd.read_csv(tmp_path / "out" / "evaluation" / "mine" / "trials.csv")
    assert trials["leant_forward"].tolist() == [True, False]
    assert "kneeled" not in trials


def test_a_battery_can_be_run_with_other_servos(tmp_path):
    """Both sets stand; under the sheets' servos a small push moves the robot another way."""
    done = run("evaluate", "run=pose_hold", "servo=published", *SMALL, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    folder = next((tmp_path / "evaluation").glob("planar_*servo-published*"))
    published = pd.read_csv(folder / "trials.csv")
    done = run("evaluate", "run=pose_hold", *SMALL, f"hydra.run.dir={tmp_path}")
    sheet = pd.read_csv(  # by default, as in the quickstart
        next(p for p in (tmp_path / "evaluation").iterdir() if p != folder) / "trials.csv"
    )
    assert (sheet.direction_rad == published.direction_rad).all()
    assert (sheet.peak_base_acceleration != published.peak_base_acceleration).any()
    done = run("evaluate", "run=pose_hold", "servo=mine", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    assert "servo/mine" in done.stderr
    assert done.stderr.count("\n") == 1


def test_the_line_of_a_lost_trial_in_the_report_repeats_it(trained, monkeypatch):
    """I = 2 fells whoever is pushed; alone the trial has the same outcome, to the last digit."""
    given = [
        "battery=planar",
        "starts=1",
        "directions=2",
        "impulses=[2.0]",
        "point=pelvis",
        "end_time=3.6",
    ]
    done = run("evaluate", f"run={trained}", *given, "num_envs=64")
    assert done.returncode == 0, done.stderr
    page = html.unescape((trained / "report.html").read_text())
    lines = [line for line in re.findall(r"<code>([^<]*)</code>", page) if "impulses=[2.0]" in line]
    assert len(lines) >= 2
    words = shlex.split(lines[-1])
    assert words[1:3] == ["-m", "recipes.evaluate"]
    assert words[-1] == "video=true"
    again = run("evaluate", *words[3:-1])  # a film needs a graphics card
    assert again.returncode == 0, again.stderr
    setting = "planar_point-pelvis_directions-2_impulses-2.0_starts-1_end_time-3.6"
    trials = pd.read_csv(trained / "evaluation" / setting / "trials.csv").set_index("trial")
    row = trials.loc[int(words[-2].removeprefix("trial="))]
    said = dict(re.findall(r"^  (\S+): (\S+)$", again.stdout, re.MULTILINE))
    assert said["recovered"] == "False"
    for key in ("time_to_fall_s", "peak_base_acceleration", "peak_tilt", "direction_rad"):
        assert said[key] == f"{row[key]:.4g}", key
