"""``experiment=falling``: all that a policy which recovers needs to fall well, from one command."""

import math

import numpy as np
import pandas as pd
import pytest
import torch

from tests.shell import run
from zfall import checkpoint
from zfall.configs import compose_config
from zfall.evaluation.battery import play
from zfall.falling.banks import bank_control_dt
from zfall.falling.lying import POSTURES, load_lying
from zfall.falling.making import SearchedCatches, SearchedRises
from zfall.falling.movements import HEADINGS, load_catches
from zfall.policies import load_policy
from zfall.robots import ZEROTH01
from zfall.training.run_folder import RunFolder
from zfall.training.stages import stages_of

FEW = ["candidates: 4", "trials: 1", "elite: 2", "rounds: 1"]
TINY = [
    "experiment=falling", "logger=null", "num_envs=8", "rollout_steps=4", "minibatches=2", "epochs=1",
    "checkpoint_every=1", "++stages.softer.num_envs=8", "++stages.softer.alike=4",
    "stages.lower.total_frames=64", "stages.softer.total_frames=32",
    "++stages.trigger.make.starts=1", "++stages.trigger.make.impulses=[0.2,1.5]",
    "++stages.trigger.make.epochs=8", "++stages.falls.make.starts=1", "++stages.falls.make.impulses=[1.5]",
    *(f"++stages.catches.make.{each.replace(': ', '=')}" for each in FEW),
    "++stages.catches.make.headings=[0,180]", "++stages.lying.make.count=2",
    *(f"++stages.rises.make.{each.replace(': ', '=')}" for each in FEW),
    "++stages.rises.make.searched=[left]",
]  # fmt: skip


class Killed(BaseException):
    """What no program catches."""


def arrays(path):
    with np.load(path) as file:
        return {key: file[key] for key in file.files}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run that nobody disturbed."""
    folder = tmp_path_factory.mktemp("falling") / "run"
    done = run("train", *TINY, f"hydra.run.dir={folder}")
    assert done.returncode == 0, done.stderr
    assert "checkpoints/falling.pt" in done.stdout
    return folder


@pytest.mark.long
def test_one_command_makes_a_policy_that_falls_and_gets_up(whole):
    """Its parts are those that the stages made."""
    assert list(pd.read_csv(whole / "metrics.csv")["stage"]) == [6, 6, 7]
    policy = load_policy(whole, checkpoint="falling")
    table = policy.config.env.transforms
    assert table.predictor.network.path == str(whole / "made" / "trigger.pt")
    assert table.kneel_reference.catches == str(whole / "made" / "catches.npz")
    assert table.rise_reference.rises == str(whole / "made" / "rises.npz")
    assert table.mode.probability == 0.8
    assert (
        table.mode.rise == compose_config(["env=push_to_stand"]).env.transforms.mode.rise
    )  # not that of the training, which had none
    assert table.mode.initial == "recover"
    assert "mirrored_falls" in table
    assert policy.config.env.base_env.control_dt == 0.02  # as often as twin decides
    assert bank_control_dt(whole / "made" / "falls.npz") == 0.02
    twin = load_policy("twin").actor.state_dict()
    softer = checkpoint.load(whole / "checkpoints" / "softer.pt")["policy"]
    state = policy.actor.state_dict()
    assert all(torch.equal(state[f"recover.{key}"], value) for key, value in twin.items())
    assert all(torch.equal(state[f"kneel.{key}"], value) for key, value in softer.items())


@pytest.mark.long
def test_what_it_makes_comes_to_all_its_modes(whole):
    """Pushed over it gives up, comes to rest and rises: the modes are 0 to 3 in their order."""
    policy = load_policy(whole, checkpoint="falling")
    env = policy.env(8, training=True)
    env.set_seed(0)
    modes = torch.stack([td["mode"].argmax(-1) for td in play(env, policy.actor, 600)], 1)
    assert set(modes.unique().tolist()) == {0, 1, 2, 3}
    first = [(modes == mode).float().argmax(1) for mode in (1, 2, 3)]
    fell = (modes == 3).any(1)
    assert (first[0][fell] < first[1][fell]).all()
    assert (first[1][fell] < first[2][fell]).all()


@pytest.mark.long
def test_only_what_is_searched_changes_and_the_bank_is_not_that_of_the_battery(whole):
    found, known = load_catches(ZEROTH01, whole / "made" / "catches.npz"), load_catches(ZEROTH01)
    same = (found.postures == known.postures).flatten(1).all(1)
    assert all(same[i] for i, heading in enumerate(HEADINGS) if heading not in (0, 180))
    bank, tested = load_lying(ZEROTH01, whole / "made" / "lying.npz"), load_lying(ZEROTH01)
    assert set(bank["posture"].tolist()) >= set(range(POSTURES.index("kneel")))
    first = bank["joint_position"][:, None] - tested["joint_position"]
    assert first.abs().amax(-1).min() > 1e-4


@pytest.mark.long
def test_killed_in_a_search_and_in_a_training_and_resumed_it_makes_the_same(
    whole, tmp_path, monkeypatch
):
    folder, kills = tmp_path / "run", ["catches", "rises", "write"]
    write = RunFolder.write

    def dying_write(self, learner, *args):
        if self.updates(learner) == 2 and "write" in kills:
            kills.remove("write")
            raise Killed
        return write(self, learner, *args)

    def dying(kind, name):
        make = kind.make

        def call(self, path, console):
            if name in kills:  # at the first line that it says
                kills.remove(name)
                monkeypatch.setattr(console, "print", stop)
            return make(self, path, console)

        monkeypatch.setattr(kind, "make", call)

    def stop(*args, **kwargs):
        raise Killed

    monkeypatch.setattr(RunFolder, "write", dying_write)
    dying(SearchedCatches, "catches")
    dying(SearchedRises, "rises")
    args = [*TINY, f"hydra.run.dir={folder}"]
    for left in (2, 1, 0):
        with pytest.raises(Killed):
            run("train", *args)
        assert len(kills) == left
        args = [f"resume={folder}", f"hydra.run.dir={tmp_path}/x"]
    done = run("train", *args)
    assert done.returncode == 0, done.stderr
    assert (folder / "metrics.csv").read_text() == (whole / "metrics.csv").read_text()
    for name in ("falls", "catches", "lying", "rises"):
        one, other = (arrays(each / "made" / f"{name}.npz") for each in (whole, folder))
        assert all(
            np.array_equal(one[key], other[key], equal_nan=one[key].dtype.kind == "f")
            for key in one
        )
    one, other = (
        load_policy(each, checkpoint="falling").actor.state_dict() for each in (whole, folder)
    )
    assert all(torch.equal(one[key], other[key]) for key in one)


def test_a_stage_for_each_thing_and_all_of_it_in_the_twin():
    stages = {
        stage.name: stage
        for stage in stages_of(compose_config(["experiment=falling", "recover=twin_fast"]))
    }
    assert [*stages] == [
        "recovers",
        "trigger",
        "gives_up",
        "falls",
        "catches",
        "lower",
        "softer",
        "lands",
        "lying",
        "rises",
        "falling",
    ]
    for name in ("trigger", "falls", "catches", "lying"):
        assert stages[name].make["world"] == "twin"
    for name in ("recovers", "gives_up", "lands", "falling"):
        assert stages[name].make["recover"] == "twin_fast"
    assert stages["lying"].make["seed"] != 0  # which is that of the battery's


@pytest.mark.parametrize(
    ("recover", "hertz"), [("twin_25hz", 25), ("twin", 50), ("twin_gru_mog", 50)]
)
def test_what_takes_time_takes_as_long_for_any_policy_that_recovers(recover, hertz):
    """Falls of 1.2 s; what a second brings; and the policy that kneels sees what recover sees."""
    cfg = compose_config(["experiment=falling", f"recover={recover}"])
    stages = {stage.name: stage for stage in stages_of(cfg)}
    lower, known = stages["lower"].config, load_policy(recover).config.env
    terms = lower.env.transforms.reward.terms
    assert lower.env.base_env.control_dt == 1 / hertz == known.base_env.control_dt
    assert lower.rollout_steps == round(1.2 * hertz)
    assert lower.rollout_steps / lower.minibatches == 15
    assert lower.loss.gamma**hertz == pytest.approx(math.exp(-1 / 1.3))
    assert lower.loss.lmbda**hertz == pytest.approx(math.exp(-1 / 0.38))
    assert lower.env.transforms.exploration.correlation**hertz == pytest.approx(math.exp(-1 / 0.25))
    assert lower.total_frames / hertz == 600_000  # as many falls
    assert stages["softer"].config.total_frames / hertz == 200_000
    softer = stages["softer"].config.env.transforms
    assert softer.reward == lower.env.transforms.reward
    assert softer.exploration == lower.env.transforms.exploration
    assert terms.kneeling[0] * hertz == pytest.approx(5.0)
    assert terms.clean_kneeling[0] * hertz == pytest.approx(17.5)
    assert lower.env.transforms.observation == known.transforms.observation
    assert stages["rises"].make["control_dt"] == 1 / hertz


def test_a_policy_to_recover_that_there_is_not_is_said_in_one_line(tmp_path):
    done = run("train", *TINY, "recover=nobody", f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 1
    assert done.stderr.startswith("error: policy must be a run folder, or one of")
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "run").exists()


@pytest.mark.long
def test_a_policy_that_sees_something_else_is_refused_before_anything_is_made(tmp_path):
    seen = "env.transforms.observation.keys=[projected_gravity,joint_position]"
    done = run("train", *TINY, seen, f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 1
    assert (
        "stages.lands.make: recover and kneel must have the same env.transforms.observation"
        in done.stderr
    )
    assert not (tmp_path / "run").exists()
