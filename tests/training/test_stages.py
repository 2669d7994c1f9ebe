"""Trainings of several stages: what each is, where it begins, and that it goes on anywhere."""

from dataclasses import replace

import pandas as pd
import pytest
import torch
from omegaconf import OmegaConf

from tests.shell import SOON, TINY, run
from zfall import checkpoint
from zfall.configs import compose_config
from zfall.evaluation import showcase
from zfall.training.learner import Learner
from zfall.training.run_folder import RunFolder
from zfall.training.stages import check_lengths, stages_of, written_out

BASE = {
    "seed": 1,
    "num_envs": 8,
    "total_frames": 64,
    "warm_start": None,
    "env": {"worlds": "${num_envs}", "push": {"size": [0.1, 0.2], "point": "torso"}},
    "actor": {"std": 0.3},
    "optimizer": {"_target_": "torch.optim.Adam", "lr": 1e-3, "fused": True},
}


class Killed(BaseException):
    """What no program catches."""


def stages(**changes):
    return stages_of(OmegaConf.create({**BASE, "stages": changes}))


def test_a_stage_is_the_config_with_its_own_values():
    first, second = stages(
        easy={"total_frames": 32},
        hard={"num_envs": 16, "env": {"push": {"size": [0.5, 0.9]}}},
    )
    assert (first.name, first.number, second.name, second.number) == ("easy", 1, "hard", 2)
    assert first.config.env == BASE["env"] | {"worlds": 8}
    assert (first.config.total_frames, second.config.total_frames) == (32, 64)
    # Lists are replaced, tables are not; what refers to a value of the stage follows it.
    assert second.config.env == {"worlds": 16, "push": {"size": [0.5, 0.9], "point": "torso"}}
    assert second.config.stages == {}


def test_another_class_takes_none_of_the_old_arguments():
    changes = {"_target_": "torch.optim.SGD", "lr": 0.1}
    same, other = stages(same={"optimizer": {"lr": 0.2}}, other={"optimizer": changes})
    assert same.config.optimizer == BASE["optimizer"] | {"lr": 0.2}
    assert other.config.optimizer == changes


def test_a_stage_begins_where_it_says():
    made = stages(
        a={}, b={}, c={"warm_start": "stage:a"}, d={"warm_start": None}, e={"warm_start": "best"}
    )
    assert [stage.begins_with for stage in made] == [None, "a", "a", None, None]
    assert [stage.config.warm_start for stage in made] == [None, None, None, None, "best"]
    sharper, same = stages(a={}, b={"actor": {"std": 0.1}}, c={"actor": {"std": 0.1}})[1:]
    assert (sharper.keeps_deviation, same.keeps_deviation) == (False, True)


def test_written_out_they_are_the_same_stages():
    """A file of a run refers to nothing."""
    changes = {"a": {"num_envs": 4}, "b": {"actor": {"std": 0.1}}, "c": {"warm_start": "stage:a"}}
    changes |= {"d": {"warm_start": None}, "e": {"warm_start": "best"}}
    text = written_out(OmegaConf.create({**BASE, "stages": changes}))
    assert "${" not in text
    assert stages_of(OmegaConf.create(text)) == stages(**changes)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("last: {}", "stages must have names of letters, digits and _, not last or best, got 'last'"),
        ("easy: 5", "stages.easy must be a table of what it changes, or null, got 5"),
        ("easy: {frames: 5}", "stages.easy must hold seed, num_envs"),
        ("easy: {logger: null}", "alone, got logger"),
        ("easy: {env: {transforms: {push: {siez: 1}}}}", "stages.easy.env.transforms.push"),
        ("easy: {total_frames: 0}", "stages.easy: total_frames must"),
        ("easy: {}, hard: {actor: {num_cells: [8]}}",
         "stages.hard: stage easy must hold the configured actor, but module.0.module.1.0.bias has shape"),
        ("easy: {}, hard: {env: {transforms: {action: {scale: 0.1}}}}",
         "stages.hard: stage easy and this run must have the same env.transforms.action.scale, got 0.6 and 0.1"),
        ("easy: {warm_start: hard}, hard: {}", "stages.easy: warm_start must be a run folder, or one of"),
        ("easy: {warm_start: 'stage:hard'}, hard: {}",
         "stages.easy.warm_start must name no stage, it is the first, got stage:hard"),
        ("easy: {}, hard: {warm_start: 'stage:esay'}",
         "stages.hard.warm_start must name a stage before it, easy, got stage:esay"),
    ],
)  # fmt: skip
def test_stages_that_cannot_be_are_refused_before_the_first(given, says, tmp_path):
    folder = tmp_path / "run"
    tiny = [given for given in TINY if not given.startswith("total_frames")]
    done = run("train", *tiny, f"+stages={{{given}}}", f"hydra.run.dir={folder}")
    assert done.returncode == 1
    assert len(done.stderr.splitlines()) == 1
    assert says in done.stderr
    assert not folder.exists()


def test_a_stage_that_is_null_is_left_out():
    cfg = OmegaConf.create({**BASE, "stages": {"one": {}, "two": None, "three": {"seed": 5}}})
    one, three = stages_of(cfg)
    assert (one.name, three.name, three.number, three.begins_with) == ("one", "three", 2, "one")
    with pytest.raises(ValueError, match=r"stages.*null.*one, two"):
        stages_of(OmegaConf.create({**BASE, "stages": {"one": None, "two": None}}))


@pytest.mark.parametrize(
    ("given", "reached"),
    [("+stages.a.total_frames=30", 1), ("+stages.b.total_frames=30", 2), ("total_frames=7", 1)],
)
def test_a_stage_that_is_left_out_has_no_length_and_no_number(given, reached):
    """b is the first stage and c the second, and each has its own length."""
    cfg = "stages: {a: null, b: {total_frames: 10}, c: {total_frames: 20}}"
    with pytest.raises(ValueError, match="must be"):
        check_lengths(cfg, [given], reached)
    check_lengths(cfg, ["+stages.c.total_frames=30"], 2)


@pytest.mark.parametrize("name", ["../a", "a.b", "best", "", 3])
def test_a_name_is_one_of_a_file(name):
    with pytest.raises(ValueError, match="stages must have names of letters, digits and _"):
        stages_of(OmegaConf.create({**BASE, "stages": {name: {}}}))


STAGED = [
    *TINY[:-2],
    "statistics_batches=1",
    "showcase=null",
    "+stages={easy: {env: {transforms: {push: {size: [0.1, 0.2]}}}},"
    " other: {num_envs: 16, total_frames: 128}, last_one: {warm_start: 'stage:easy', actor: {std: 0.1}}}",
]


TEACHER = "zfall.losses.imitation.ImitationLoss"
WITH_LOSS = [
    *TINY[:-2],
    "statistics_batches=0",
    "showcase=null",
    f"+stages={{easy: {{}}, other: {{auxiliary_losses: {{imitation: {{_target_: {TEACHER}, teacher: 'stage:easy'}}}}}},"
    " last_one: {}}",
]  # fmt: skip
KILLS = [("write", 2), ("save", 3), ("write", 4), ("next_stage", 4), ("write", 6)]


@pytest.mark.long
@pytest.mark.parametrize(
    "given",
    [
        pytest.param(STAGED, id="stages", marks=pytest.mark.slow),
        pytest.param(WITH_LOSS, id="losses that come and go"),
    ],
)
def test_killed_in_three_stages_and_resumed_it_gives_the_same(given, tmp_path, monkeypatch):
    """Same weights and same metrics, to the last digit; also when killed between two stages.

    It is killed before a row is written, between a row and the checkpoint, and after a stage.
    """
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    done = run("train", *given, f"hydra.run.dir={whole}")
    assert done.returncode == 0, done.stderr
    kills = list(KILLS)

    def dying(name):
        method = getattr(RunFolder, name)

        def call(self, learner, *args):
            if kills and kills[0] == (name, self.updates(learner)):
                kills.pop(0)
                raise Killed
            return method(self, learner, *args)

        monkeypatch.setattr(RunFolder, name, call)

    for name in ("write", "save", "next_stage"):
        dying(name)
    args = [*given, f"hydra.run.dir={parts}"]
    for left in range(len(KILLS) - 1, -1, -1):
        with pytest.raises(Killed):
            run("train", *args)
        assert len(kills) == left
        args = [f"resume={parts}", f"hydra.run.dir={tmp_path}/x"]
    done = run("train", *args)
    assert done.returncode == 0, done.stderr
    assert (parts / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()
    metrics = pd.read_csv(whole / "metrics.csv")
    assert list(metrics["update"]) == list(range(1, len(metrics) + 1))
    assert list(metrics["stage"]) == [1] * 2 + [2] * 2 + [3] * 2
    for name in ("easy", "other", "last"):
        one, other = (
            checkpoint.load(folder / "checkpoints" / f"{name}.pt")["policy"]
            for folder in (whole, parts)
        )
        assert all(torch.equal(one[key], other[key]) for key in one)
    if given == STAGED:  # frames of all stages: 32, of which one batch sets statistics, and 64
        assert list(metrics["frames"])[1::2] == [96, 96 + 192, 96 + 192 + 96]


def test_a_stage_begins_with_the_weights_of_the_one_before(tmp_path):
    """Steps of length 0 leave the weights where the stage began."""
    still = "optimizer: {lr: 0.0}, scheduler: null, averaging: 0.0"
    given = f"+stages={{a: {{}}, b: {{{still}}}, c: {{{still}, actor: {{std: 0.07}}}}}}"
    done = run("train", *TINY, given, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    a, b, last = (
        checkpoint.load(tmp_path / "checkpoints" / f"{name}.pt") for name in ("a", "b", "last")
    )
    learned = [key for key in a["policy"] if key.endswith(("weight", "bias", "log_std"))]
    assert any(key.endswith("log_std") for key in learned)
    for key in learned:
        assert torch.equal(a["policy"][key], b["policy"][key])
        if key.endswith("log_std"):
            torch.testing.assert_close(last["policy"][key].exp(), torch.full((20,), 0.07))
        else:
            assert torch.equal(b["policy"][key], last["policy"][key])
    assert all(torch.equal(value, b["critic"][key]) for key, value in a["critic"].items()
               if key.endswith(("weight", "bias")))  # fmt: skip
    assert OmegaConf.create(last["config"]).actor.std == 0.07


@pytest.mark.long
def test_only_lengths_of_stages_change_when_it_goes_on(tmp_path):
    done = run("train", *TINY, "+stages={a: {}, b: {}}", f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    more = ["train", f"resume={tmp_path}/run", f"hydra.run.dir={tmp_path}/x"]
    refused = run(*more, "+stages.b.seed=5")
    assert refused.returncode == 1
    assert "stages.b.seed must not be given with resume" in refused.stderr
    done = run(*more, "+stages.b.total_frames=128")
    assert done.returncode == 0, done.stderr
    assert list(pd.read_csv(tmp_path / "run" / "metrics.csv")["stage"]) == [1, 1, 2, 2, 2, 2]


@pytest.mark.long
def test_a_length_that_no_stage_would_have_is_refused(tmp_path):
    done = run("train", *TINY, "+stages={a: {}, b: {}}", f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    more = ["train", f"resume={tmp_path}/run", f"hydra.run.dir={tmp_path}/x"]
    for given, says in (
        ("+stages.bb.total_frames=128", "stages.bb.total_frames must be that of a stage which is not over: +stages.b.total"),
        ("+stages.a.total_frames=128", "stages.a.total_frames must be that of a stage which is not over"),
        ("total_frames=128", "total_frames must be given for a stage, each has its own: +stages.b.total_frames"),
    ):  # fmt: skip
        done = run(*more, given)
        assert done.returncode == 1
        assert says in done.stderr
    whole = "+stages={a: {total_frames: 32}, b: {total_frames: 32}}"
    done = run("train", *TINY, whole, f"hydra.run.dir={tmp_path}/y")  # TINY gives total_frames
    assert done.returncode == 1
    assert "total_frames must be given for a stage" in done.stderr


def test_a_later_stage_is_tried_before_the_first(tmp_path):
    term = "{_target_: zfall.envs.terms.calm.idle_servos, _partial_: true, reach: 0.1, sigma: 1.0, torque: load}"
    given = f"+stages={{a: {{}}, b: {{env: {{transforms: {{reward: {{terms: {{idle: [1.0, {term}]}}}}}}}}}}}}"
    done = run("train", *TINY, given, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 1
    assert "stages.b.env.transforms.reward" in done.stderr
    assert not (tmp_path / "run").exists()


def test_ones_own_code_needs_no_trust_in_ones_own_stages(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_stage_terms.py").write_text(
        "def low(td, next_td):\n    return -next_td['com_position'][..., 2:]\n"
    )
    low = "[0.1, {_target_: my_stage_terms.low, _partial_: true}]"
    given = (
        f"+stages={{a: {{}}, b: {{env: {{transforms: {{reward: {{terms: {{low: {low}}}}}}}}}}}}}"
    )
    done = run("train", *TINY, given, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_what_is_shown_before_is_what_the_stage_began_with(tmp_path, monkeypatch):
    """Also where it is another network."""
    shown = "showcase={starts: 1, sizes: [0.4], video: false, every: 1}"
    stages = "+stages={a: {}, b: {warm_start: null, actor: {num_cells: [16]}}}"
    asked = showcase.battery_of
    monkeypatch.setattr(showcase, "battery_of", lambda cfg: replace(asked(cfg), **SOON))
    done = run("train", *TINY[:-1], shown, stages, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr


def test_a_learner_is_one_stage():
    with pytest.raises(ValueError, match="stages must be {} for a Learner"):
        Learner(compose_config(["+stages={a: {}}"]))


def test_nothing_of_a_strangers_stages_is_executed(tmp_path):
    done = run("train", *TINY, "+stages={a: {}, b: {}}", f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    path = tmp_path / "run" / "checkpoints" / "last.pt"
    content = checkpoint.load(path, checkpoint.TRAINING)
    config = OmegaConf.create(content["run"]["whole_config"])
    config.stages.b.actor = {
        "_target_": "builtins.open",
        "file": str(tmp_path / "evil"),
        "mode": "w",
    }
    content["run"]["whole_config"] = OmegaConf.to_yaml(config)
    checkpoint.save(path, content)
    done = run("train", f"resume={tmp_path}/run", f"hydra.run.dir={tmp_path}/x")
    assert done.returncode == 1
    assert "stages.b.actor._target_" in done.stderr
    assert not (tmp_path / "evil").exists()
