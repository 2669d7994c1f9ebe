"""A stranger's run: nothing of it is executed, whichever recipe reads it."""

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from omegaconf import OmegaConf

import zfall
from tests.shell import run
from zfall import checkpoint
from zfall.policies.load import POLICIES

RECIPES = {
    "play": ["play", "run={run}"],
    "evaluate": ["evaluate", "run={run}"],
    "compare": ["evaluate", "runs=[pose_hold,{run}]"],
    "export": ["export", "run={run}"],
    "recover": ["falling.switch", "recover={run}", "kneel=script"],
    "kneel": ["falling.switch", "recover=best", "kneel={run}"],
    "falls": ["falling.falls", "run={run}"],
    "trigger": ["falling.trigger", "run={run}"],
    "resume": ["train", "resume={run}"],
    "warm_start": ["train", "warm_start={run}", "num_envs=4", "minibatches=1"],
    "teacher": ["train", "imitation=teacher", "auxiliary_losses.imitation.teacher={run}",
                "num_envs=4", "minibatches=1"],
}  # fmt: skip


class Payload:
    """Writes a file when it is unpickled."""

    def __init__(self, path: Path):
        self.path = path

    def __reduce__(self) -> tuple:
        return (open, (str(self.path), "w"))


def _hostile(folder: Path) -> dict[str, tuple[dict[str, Any], str]]:
    """What to put into a config, and what its refusal says; each would write ``folder/evil``."""
    evil, payload, script = str(folder / "evil"), str(folder / "a.pkl"), "open('evil', 'w')"
    network = {"_target_": "zfall.falling.fall_network.FallNetwork", "size": 3}
    opened = {"_target_": "builtins.open", "file": evil, "mode": "w"}
    hub = {"repo_or_dir": str(folder), "model": "model", "source": "local"}
    return {
        "pandas": (
            {"actor.std": {"_target_": "pandas.read_pickle", "filepath_or_buffer": payload}},
            "actor.std._target_",
        ),
        "torch": (
            {"actor.std": {"_target_": "torch.load", "f": payload, "weights_only": False}},
            "actor.std._target_",
        ),
        "numpy": (
            {"actor.std": {"_target_": "numpy.load", "file": payload, "allow_pickle": True}},
            "actor.std._target_",
        ),
        "hub": ({"actor.std": {"_target_": "torch.hub.load", **hub}}, "actor.std._target_"),
        "open": ({"env.base_env.robot": opened}, "env.base_env.robot._target_"),
        "copy": (
            {"actor.x": {"_target_": "shutil.copyfile", "src": payload, "dst": evil}},
            "actor.x._target_",
        ),
        "savetxt": (
            {"actor.x": {"_target_": "numpy.savetxt", "fname": evil, "X": [1]}},
            "actor.x._target_",
        ),
        "attribute": (
            {"actor.x": {"_target_": "zfall.envs.terms.posture.torch.hub.load", **hub}},
            "zfall.envs.terms.posture.torch.hub.load",
        ),
        "ours": (
            {
                "env.transforms.fall": {
                    "_target_": "zfall.falling.fall_network.save_fall_network",
                    "network": network,
                    "path": {"_target_": "pathlib.Path", "_args_": [evil]},
                }
            },
            "env.transforms.fall._target_",
        ),
        "exec": ({"actor.x": {"_target_": "builtins.exec", "_args_": [script]}}, "builtins.exec"),
        "hidden": (
            {"env.transforms.reward.terms.x": [1.0, {"_partial_": True, "a": [[opened]]}]},
            "env.transforms.reward.terms.x.1.a.0.0._target_",
        ),
        "method": (
            {"actor._target_": {"_target_": "hydra.utils.get_method", "path": "os.system"}},
            "actor._target_",
        ),
        "interpolated": ({"actor._target_": "${name}", "name": "os.system"}, "${name}"),
        "environment": ({"env.transforms.x": "${oc.env:HOME}"}, "${oc.env:HOME}"),
        "logger": (
            {
                "logger": [
                    {"_target_": "torchrl.record.CSVLogger", "exp_name": "a", "log_dir": evil}
                ]
            },
            "logger.0.log_dir",
        ),
        "key": (
            {"env.transforms.reward.terms": {f"../../../../../{evil}": [1.0, None]}},
            "must be a plain name",
        ),
        "module": ({"actor._target_": "stranger.actor"}, "trust=[stranger] if you trust its code"),
        "self-trusted": ({"trust": ["stranger"], "actor._target_": "stranger.actor"}, "stranger"),
    }


TEXTS = {
    "tag": "\nx: !!python/object/apply:builtins.open [evil, w]",
    "aliases": "\na: &a [x,x]\nb: &b [*a,*a,*a]\nc: [*b,*b,*b]",
    "deep": "\nx: " + "[" * 500 + "]" * 500,
}
NAMES = [*_hostile(Path()), *TEXTS, "pickle"]


@pytest.fixture
def strange(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], tuple[Path, str]]:
    """Makes a stranger's run of a technique; gives its folder, and what the refusal says."""
    work = tmp_path / "work"
    work.mkdir()
    monkeypatch.chdir(work)
    monkeypatch.syspath_prepend(tmp_path)
    wrote = f"open({str(tmp_path / 'evil')!r}, 'w')\n"
    (tmp_path / "stranger.py").write_text(wrote)
    (tmp_path / "hubconf.py").write_text(wrote)
    (tmp_path / "a.pkl").write_bytes(pickle.dumps(Payload(tmp_path / "evil")))

    def made(name: str) -> tuple[Path, str]:
        content = torch.load(POLICIES / "best.pt", weights_only=True)
        content |= {key: {} for key in ("critic", "optimizer", "scheduler", "buffers")}
        content |= {"worlds": [], "run": {"version": 7}, "rng": torch.get_rng_state()}
        content |= {"averaged": 1, "updates": 1}
        says = "must be a yaml table of plain values"
        if name == "pickle":
            content["robot"], says = Payload(tmp_path / "evil"), "damaged or of another kind"
        elif name in TEXTS:
            content["config"] += TEXTS[name]
        else:
            config = OmegaConf.create(content["config"])
            changes, says = _hostile(tmp_path)[name]
            for key, value in changes.items():
                OmegaConf.update(config, key, value, merge=False, force_add=True)
            content["config"] = OmegaConf.to_yaml(config)
        path = tmp_path / "strange" / "checkpoints" / "last.pt"
        path.parent.mkdir(parents=True, exist_ok=True)
        if name == "pickle":
            torch.save(content, path)
        else:
            checkpoint.save(path, content)
        return path.parents[1], says

    return made


def _tree(folder: Path) -> dict[Path, tuple[int, int]]:
    """All files below a folder, with the time of their last change and their size."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in files}


def _check_refused(strange: Callable[[str], tuple[Path, str]], name: str, recipe: str) -> None:
    folder, says = strange(name)
    before = _tree(folder.parent)
    module, *args = (part.format(run=folder) for part in RECIPES[recipe])
    done = run(module, *args)
    lines = done.stderr.splitlines()
    assert (done.returncode, len(lines)) == (1, 1), done.stderr
    assert lines[0].startswith("error: ")
    assert says in lines[0]
    assert str(folder / "checkpoints" / "last.pt") in lines[0]
    assert _tree(folder.parent) == before


@pytest.mark.parametrize("name", NAMES)
def test_nothing_of_a_strangers_checkpoint_is_executed(strange, name):
    folder, says = strange(name)
    before = _tree(folder.parent)
    with pytest.raises(ValueError, match="must") as caught:
        checkpoint.load(folder / "checkpoints" / "last.pt", {})
    assert says in str(caught.value)
    assert _tree(folder.parent) == before


SOME = [(name, list(RECIPES)[i % len(RECIPES)]) for i, name in enumerate(NAMES)]


@pytest.mark.parametrize(("name", "recipe"), SOME)
def test_recipes_refuse_a_strangers_run_in_one_line_and_write_nothing(strange, name, recipe):
    _check_refused(strange, name, recipe)


@pytest.mark.slow
@pytest.mark.parametrize("recipe", RECIPES)
@pytest.mark.parametrize("name", NAMES)
def test_every_recipe_refuses_every_kind_of_strange_run(strange, name, recipe):
    _check_refused(strange, name, recipe)


def test_ones_own_module_is_built_once_it_is_trusted(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_counting.py").write_text(
        "from torchrl.envs import StepCounter\n\nclass Counting(StepCounter): ...\n"
    )
    content = torch.load(POLICIES / "best.pt", weights_only=True)
    config = OmegaConf.create(content["config"])
    config.env.transforms.steps = {"_target_": "my_counting.Counting"}
    content["config"] = OmegaConf.to_yaml(config)
    path = tmp_path / "mine" / "checkpoints" / "last.pt"
    path.parent.mkdir(parents=True)
    checkpoint.save(path, content)
    args = ["run=mine", "num_envs=1", "seconds=0.08", "video=false"]
    refused = run("play", *args)
    assert refused.returncode == 1
    assert "env.transforms.steps._target_" in refused.stderr
    assert "my_counting.Counting; trust=[my_counting] if you trust its code." in refused.stderr
    played = run("play", *args, "trust=[my_counting]")
    assert played.returncode == 0, played.stderr
    assert zfall.load_policy("mine", trust=["my_counting"]).env(2).rollout(2).shape == (2, 2)
    with pytest.raises(ValueError, match="trust must be a list"):
        zfall.load_policy("mine", trust="my_counting")
    assert "trust must be a list, [os]" in run("play", *args, "trust=os").stderr
