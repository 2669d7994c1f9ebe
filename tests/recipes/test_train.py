"""Training from the shell: its files, and bad input in one line."""

import gc
import re
from dataclasses import replace
from datetime import datetime, timedelta

import pandas as pd
import pytest
from omegaconf import OmegaConf

from tests.shell import ROOT, SOON, TINY, run
from zfall.evaluation import showcase
from zfall.training.loop import garbage_collector_of_new_things


def test_runs_started_together_have_folders_of_their_own():
    """A shell starts several within one second; in one folder they would overwrite each other."""
    texts = [recipe.read_text() for recipe in (ROOT / "recipes").rglob("*.yaml")]
    formats = [item for text in texts for item in re.findall(r"\$\{now:([^}]*)\}", text)]
    assert len(formats) >= 8
    one = datetime(2026, 1, 1, 12)
    for item in formats:
        assert one.strftime(item) != (one + timedelta(milliseconds=1)).strftime(item)


def test_training_leaves_the_files_of_a_run(trained):
    for name in ("metrics.csv", "timing.csv", "summary.json", ".hydra/config.yaml",
                 "checkpoints/last.pt", "checkpoints/best.pt", "plots/planar.png",
                 "plots/learning_curves.png", "tensorboard"):  # fmt: skip
        assert (trained / name).exists(), name
    metrics = pd.read_csv(trained / "metrics.csv")
    assert metrics["frames"].tolist() == [32, 64]
    expected = {"episode_return", "episode_seconds", "kl", "reward/upright", "loss/objective"}
    assert expected <= set(metrics.columns)
    assert not [column for column in metrics if "_s" in column[-3:] and column != "episode_seconds"]


@pytest.mark.parametrize("actor", ["mlp_mog", "gru_mog"])
def test_every_actor_trains(actor, tmp_path):
    done = run("train", *TINY, f"actor={actor}", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr


def row(td, next_td):
    """A reward term without its last dimension."""
    return next_td["done"][:, 0].float()


BAD = [
    (["num_envs=0"], "num_envs must be at least 1, got 0"),
    (["num_envs=-4"], "num_envs must be at least 1, got -4"),
    (
        ["num_envs=4", "env.base_env.num_envs=3"],
        "env.base_env.num_envs must be left to num_envs, got 3",
    ),
    (["groups=0"], "groups must be at least 1, got 0"),
    (["groups=two"], "groups must be a whole number or null, got two"),
    (
        ["num_envs=4", "groups=5"],
        "groups must be null, or from 1 to the 4 worlds of num_envs, got 5",
    ),
    (["num_envs=abc"], "num_envs must be a whole number, got abc"),
    (["total_frames=inf"], "total_frames must be a finite number, got inf"),
    (["total_frame=3"], "loss); did you mean total_frames? A new one begins with a +."),
    (
        ["env.transforms.push.sise=3"],
        "env.transforms.push.sise is not a key of the config (point, size, duration, interval); "
        "did you mean size?",
    ),
    (["env.transforms.push.size.y=3"], "a list has values 0, 1 and so on, none that is called y"),
    (["loss.gamma=2"], "loss.gamma must lie in [0, 1], got 2"),
    (["loss.clip_epsilon=abc"], "loss.clip_epsilon must be a number, got abc"),
    (["optimizer=null"], "optimizer must be a table, got null"),
    (["~optimizer._target_"], "optimizer must be a table with a _target_, the dotted path"),
    (["auxiliary_losses=3"], "auxiliary_losses must be a table, got 3"),
    (
        ["env.transforms.noise.std=3"],
        "env.transforms.noise.std must be a table or null, got 3",
    ),
    (
        ["optimizer.lr=0.01"],
        "optimizer.lr must lie within scheduler.min_lr 1e-05 and scheduler.max",
    ),
    (["showcase=5"], "showcase must be a table or null, got 5."),
    (["showcase={starts: 0, sizes: [0.4]}"], "showcase.starts must be at least 1, got 0"),
    (["showcase={starts: 1, sizes: 0.4}"], "showcase.sizes must be a list, [0.4], got 0.4"),
    (
        ["showcase={starts: 1, sizes: [-0.4]}"],
        "showcase.sizes.0 must be positive and finite, got -0.4",
    ),
    (
        ["showcase={start: 1}"],
        "showcase.start is not a key of the config (battery, every, sizes, starts, video)",
    ),
    (
        ["env.transforms.push.size=0.3"],
        "env.transforms.push.size must be a list, [0.3], or null, got 0.3",
    ),
    (
        ["env.transforms.delay=7"],
        "env.transforms.delay must be a table with a _target_, or null, got 7",
    ),
    (["+env.transforms.x={_target_: no.X}"], "that Python can import, got no.X: No module named"),
    (["+env.transforms.x={_target_: tests.shell.X}"], "got tests.shell.X: tests.shell has no X."),
    (
        ["+env.transforms.reward.terms.y=[0.1,{_target_:tests.recipes.test_train.row}]"],
        "row is called in every step: beside its _target_ say _partial_: true.",
    ),
    (["max_grad_norm=0"], "max_grad_norm must be positive, got 0"),
    (["optimizer.lr=abc"], "optimizer.lr must be a number, finite and not negative, got abc"),
    (["alike=3"], "alike must divide the 8 worlds of each group (num_envs, groups), got 3"),
    (["alike=2"], "alike must be 1 without a transform that has one, got 2."),
    (["minibatches=33"], "minibatches must not be more than the 32 samples of an update, got 33"),
    (["actor=gru_mog", "minibatches=9"], "more than the 8 sequences of an update, got 9"),
    (
        ["env.transforms.reward.terms.posture.0=x"],
        "env.transforms.reward.terms.posture.0 must be a number or null, got x",
    ),
    (
        ["+env.transforms.push.siez=[0.1,0.2]"],
        "env.transforms.push.siez is not a parameter of RandomPush (axes, ",
    ),
    (
        ["warm_start=pose_hold"],
        "warm_start must be a run folder, or one of atalante, best, best_gru, icub, kneel, kneel_soft, twin, twin_25hz, twin_fast, twin_gru_mog, zeroth_fall; there",
    ),
    (
        [
            "+env.transforms.reward.terms.mine=[0.1,{_target_:tests.recipes.test_train.row,_partial_:true}]"
        ],
        "terms.mine must return (2, 1), one number per world, got (2,)",
    ),
    (["total_frames=many"], "total_frames must be a number, got many"),
    (
        [
            "+env.transforms.reward.terms.knee="
            "[0.1,{_target_:zfall.envs.terms.posture.reference_posture,_partial_:true}]"
        ],
        "env.transforms.reward.terms.knee.1.sigma must be given, a number",
    ),
    (
        ["env.transforms.reward=null"],
        "env.transforms must bring reward, as zfall.envs.transforms.r",
    ),
    (
        ["env.transforms.init=null"],
        "env.transforms must bring is_init, as torchrl.envs.InitTracker",
    ),
    (["env.transforms.observation.keys=[]"], "keys must name at least one quantity, got []"),
    (["env.transforms.observation_critic=null"], "critic: the env must bring observation_critic"),
    (
        ["env.transforms.action=null"],
        "LastAction needs an action, as JointPositionTarget brings it, got an env that reads control",
    ),
    (["env.base_env.control_dt=0.03"], "control_dt must be a multiple of physics_dt"),
    (["env.transforms.delay.delay=[0,0.5]"], "env.transforms.delay: delay must be"),
    (["env.transforms.push.point=tail"], "env.transforms.push: point must be a push point"),
    (["+env.transforms.push.impulze=1"], "impulze"),
    (["numenvs=3"], "numenvs"),
    (["+epoch=3"], "epoch is not a key of the config"),
    (["actor=mlp_transformer"], "mlp_transformer"),
    (["+loss.clip_eps=0.3"], "loss.clip_eps is not a key of the config"),
    (["showcase={foo: 1}"], "showcase.foo is not a key of the config"),
    (["rollout_steps=0"], "rollout_steps must be at least 1, got 0"),
    (["loss.kl_target=0.01"], "kl_target must be positive and go with a positive kl_coeff"),
    (["actor.activation=gelu"], "actor.activation must be elu or relu or tanh, got gelu"),
    (["actor=mlp_mog", "+actor.learn_std=false"], "learn_std must be true with components"),
    (
        ["experiment=atalante_standing_laptop", "critic=gru"],
        "did you mean num_layers? '~critic.num_cells' takes it out",
    ),
    (["resume=nowhere"], "resume must be a run folder, there is no folder nowhere"),
    (["hydra.run.dir=/proc/zfall"], "/proc/zfall"),
]


@pytest.mark.parametrize(("overrides", "message"), BAD, ids=[" ".join(o) for o, _ in BAD])
def test_bad_input_ends_before_the_first_step_with_a_clear_line(overrides, message, tmp_path):
    folder = [] if "hydra.run.dir" in overrides[0] else [f"hydra.run.dir={tmp_path}"]
    done = run("train", *TINY, *folder, *overrides)
    assert done.returncode != 0
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    lines = [
        line for line in done.stderr.splitlines() if "Warning" not in line and "warn" not in line
    ]
    assert len(lines) == 1
    assert lines[0].startswith("error: ")
    assert not tmp_path.exists() or not any(tmp_path.iterdir())  # nothing is left behind


def test_a_folder_that_holds_a_run_is_not_trained_into(trained):
    names = ("metrics.csv", ".hydra/config.yaml", ".hydra/overrides.yaml")
    before = [(trained / name).read_text() for name in names]
    done = run("train", *TINY, "seed=5", f"hydra.run.dir={trained}")
    assert done.returncode != 0
    assert f"hydra.run.dir must be a folder without a run, {trained} holds one" in done.stderr
    assert "goes on with it" in done.stderr
    assert [(trained / name).read_text() for name in names] == before


def test_a_run_that_ended_before_its_first_checkpoint_is_to_be_removed(tmp_path):
    """There is nothing to go on from."""
    (tmp_path / "metrics.csv").write_text("frames\n")
    done = run("train", *TINY, f"hydra.run.dir={tmp_path}")
    assert done.returncode != 0
    assert f"{tmp_path} holds one without a checkpoint; remove it" in done.stderr


def test_a_sweep_trains_each_value_in_a_folder_of_its_own(tmp_path, monkeypatch):
    """The folder of all is made before there is a config of any job."""
    monkeypatch.chdir(tmp_path)
    done = run("train", "-m", *TINY, "seed=0,1")
    assert done.returncode == 0, done.stderr
    folders = sorted((tmp_path / "runs" / "sweeps").glob("*/*/checkpoints/last.pt"))
    configs = [OmegaConf.load(path.parents[1] / ".hydra" / "config.yaml") for path in folders]
    assert [config.seed for config in configs] == [0, 1]


def test_the_garbage_collector_spares_what_was_there_and_takes_it_back():
    def fail_amid_it():
        with garbage_collector_of_new_things():
            spared.append(gc.get_freeze_count())
            raise InterruptedError

    spared: list[int] = []
    with pytest.raises(InterruptedError):
        fail_amid_it()
    assert spared[0] > 10_000  # all of torch, for one
    assert gc.get_freeze_count() == 0


def test_what_could_not_be_read_again_is_not_trained(tmp_path):
    done = run("train", *TINY, "name=../elsewhere", f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 1
    assert "name must be a plain name, got ../elsewhere." in done.stderr
    assert not any(tmp_path.iterdir())


def test_a_run_whose_logger_writes_elsewhere_goes_on_once_that_is_trusted(tmp_path):
    logger = f"{{_target_: torchrl.record.CSVLogger, exp_name: a, log_dir: {tmp_path}}}"
    done = run("train", *TINY, f"logger=[{logger}]", f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    more = [f"resume={tmp_path}/run", "total_frames=96"]
    done = run("train", *more)
    assert "trust=[torchrl.record.CSVLogger]" in done.stderr
    done = run("train", *more, "trust=[torchrl.record.CSVLogger]")
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_a_look_in_between_changes_nothing_of_the_training(tmp_path):
    """It is there before the training is over, and of the battery that was asked for."""
    looked = "{starts: 1, sizes: [0.4], video: false, every: 2, battery: twin}"
    whole = [*TINY, "total_frames=128"]
    assert run("train", *whole, f"hydra.run.dir={tmp_path}/a").returncode == 0
    seen = []
    shown, asked = showcase.show, showcase.battery_of

    def show(cfg, actor, untrained, folder, console):
        seen.append(len((folder / "metrics.csv").read_text().splitlines()) - 1)
        shown(cfg, actor, untrained, folder, console)
        assert (folder / "report.html").exists()
        assert (folder / "plots" / "twin.png").exists()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(showcase, "show", show)
        patch.setattr(showcase, "battery_of", lambda cfg: replace(asked(cfg), **SOON))
        done = run("train", *whole, f"showcase={looked}", f"hydra.run.dir={tmp_path}/b")
    assert done.returncode == 0, done.stderr
    assert seen == [2, 4]
    metrics = [(tmp_path / name / "metrics.csv").read_text() for name in "ab"]
    assert metrics[0] == metrics[1]


def test_a_showcase_of_another_kind_of_battery_is_refused(tmp_path):
    given = "showcase={starts: 1, sizes: [0.4], video: false, battery: kneel}"
    done = run("train", *TINY, given, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 1
    assert (
        "showcase.battery must be planar, twin or another of their kind, got kneel" in done.stderr
    )
    assert not (tmp_path / "run").exists()
