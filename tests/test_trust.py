"""What of a file is built, and what is refused."""

import ast
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from pkgutil import walk_packages

import pytest
import torch
from omegaconf import OmegaConf

import zfall
from zfall import checkpoint
from zfall.configs import compose_config, config_folder
from zfall.policies.load import POLICIES
from zfall.trust import ALLOWED, config_of_file, targets_of, texts_of_file, trusting

FILE = Path("strange.pt")
ENV = "env: {a: 1}\nactor: {b: 1}\n"


def refusal(text: object) -> str:
    """The one line with which a config of a file is refused."""
    with pytest.raises(ValueError, match="must") as caught:
        config_of_file(text, FILE)
    assert "\n" not in str(caught.value)
    assert "strange.pt" in str(caught.value)
    return str(caught.value)


TARGETS = [
    *("pandas.read_pickle", "torch.load", "numpy.load", "torch.hub.load", "builtins.open"),
    *("builtins.eval", "os.system", "shutil.copyfile", "numpy.savetxt", "subprocess.run"),
    *("hydra.utils.get_method", "hydra.utils.instantiate", "torch.jit.load", "zfall.load_policy"),
    *("zfall.checkpoint.save", "zfall.falling.banks.save_bank", "zfall.errors.object_at"),
    *("zfall.falling.fall_network.save_fall_network", "zfall.motions.library.save_motions"),
    *("zfall.evaluation.run.evaluate", "zfall.training.learner.Learner", "recipes.train.main"),
    # What our modules import is not theirs.
    *("zfall.envs.terms.posture.torch.load", "zfall.envs.terms.posture.torch.hub.load"),
    *("zfall.modules.actors.torch.serialization.load", "zfall.modules.actors.nn.Module.apply"),
    *("zfall.envs.transforms.starts.reference.load_motions", "zfall.modules.actors.TensorDictModule"),
    *("zfall.losses.ppo.torch.optim.Adam", "zfall.modules.actors.math.sqrt"),
    # Attributes of what they define.
    *("zfall.envs.terms.posture.upright.__globals__.get", "zfall.robots.Robot.__init__.__globals__"),
    *("zfall.robots.Robot.__subclasses__", "zfall.envs.make.make_env.__call__", "zfall.robots.ZEROTH01"),
    *("zfall.envs.transforms.pushes.RandomPush.load_state_dict", "zfall.modules.mlp_actor.__class__"),
    *("torch.optim.Adam.load_state_dict", "torch.optim.Adam.__init__", "torch.optim.Optimizer"),
    *("torchrl.envs.GymEnv", "torchrl.record.WandbLogger", "torchrl.envs.transforms.R3MTransform"),
    *("torchrl.record.CSVLogger", "torchrl.record.TensorboardLogger"),  # but as a logger
    *("antigravity.geohash", "zfall", "zfall..envs.terms", " zfall.envs.terms.posture.upright"),
    *("zfall.envs.terms", "zfall.envs.terms.", "zfall.envs.termsx.f", "zfall.envs.terms.nosuch.f"),
]  # fmt: skip


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_not_allowed_is_refused_with_its_key(target):
    config = OmegaConf.to_yaml({"actor": {"std": {"_target_": target}}})
    text = refusal(config)
    assert "actor.std._target_ must name" in text
    assert target in text
    assert "trust=[" not in text  # it is no module of the user's own


def test_nothing_is_imported_to_find_out():
    assert "antigravity" not in sys.modules
    refusal("actor: {_target_: antigravity.geohash}")
    assert "antigravity" not in sys.modules


EVIL = "{_target_: os.system, command: 'touch evil'}"


@pytest.mark.parametrize(
    "text",
    [
        f"a: {{_target_: zfall.robots.Ball, mass: {EVIL}}}",
        f"a: {{_target_: zfall.robots.Ball, _args_: [{EVIL}]}}",
        f"a: [1, [2, {EVIL}]]",
        f"a: {{_recursive_: false, b: {{c: [{EVIL}]}}}}",
        f"a: {{_partial_: true, {EVIL[1:-1]}}}",
        f"a: {{<<: {EVIL}}}",
        f"a: {{_convert_: object, _args_: [{{_partial_: true, b: {EVIL}}}]}}",
        "a: {_target_: [os.system], _args_: [x]}",
        "a: {_target_: {_target_: hydra.utils.get_method, path: os.system}}",
        "a: {_target_: 3}",
        "a: {_target_: null}",
    ],
)
def test_a_target_is_found_wherever_it_hides(text):
    assert "_target_ must name" in refusal(text)


@pytest.mark.parametrize(
    "text",
    [
        "a: ${oc.env:HOME}",
        "a: {_target_: '${b}'}\nb: os.system",
        "a: 'x ${now:%Y}'",
        "a: {'${b}/c': 1}",
        "a: ['${a.0}']",
        r"a: '\${b}'",
        "a: !!python/object/apply:os.system [touch evil]",
        "a: !!python/name:os.system",
        "a: !!python/object/apply:pathlib.PosixPath [x]",
        "a: !mine 3",
        "a: &x [1]\nb: *x",
        "a: &x 1",
        "a: &a [x,x]\nb: &b [*a,*a]\nc: &c [*b,*b]",
        "[" * 1000 + "]" * 1000,
        "a: " + "{b: " * 60 + "1" + "}" * 60,
        "a: [" + "1," * 110_000 + "]",
        "# " + "x" * 2_000_000,
        "a: 1\na: 2",
        "a: [",
        "a: \x00",
        "- 1",
        "3",
        "{../../evil: 1}",
        "reward: {/tmp/evil: 1}",
        "reward: {'a\x1b[2J': 1}",
        "name: ../../evil",
        "name: /tmp/evil",
        "name: ..",
        "name: [a]",
        3,
        None,
        b"a: 1",
    ],
)
def test_a_config_of_a_file_is_plain(text):
    refusal(text)


LOGGER = "{{_target_: torchrl.record.CSVLogger, exp_name: {}, log_dir: {}}}"


@pytest.mark.parametrize(
    ("name", "log_dir"),
    [
        ("csv", "/tmp/evil"),
        ("csv", "'{folder}/../../evil'"),
        ("csv", "'{folder[0]}tmp'"),
        ("csv", "null"),
        ("/tmp/evil", "'{folder}'"),
        ("../../evil", "'{folder}'"),
        ("'{folder[0]}tmp{folder[0]}evil'", "'{folder}'"),
        ("'{name.__class__}'", "'{folder}'"),
        ("[a]", "'{folder}'"),
        ("{_target_: zfall.robots.Ball}", "'{folder}'"),
        ("csv, video_format: ../evil", "'{folder}'"),
    ],
)
def test_a_logger_of_a_file_writes_into_its_run_folder_alone(name, log_dir):
    assert "logger.0." in refusal(f"logger: [{LOGGER.format(name, log_dir)}]")


def test_a_logger_that_is_trusted_writes_where_it_says():
    text = f"logger: [{LOGGER.format('csv', 'elsewhere')}]"
    assert "trust=[torchrl.record.CSVLogger]" in refusal(text)
    with trusting(["torchrl.record.CSVLogger"]):
        config_of_file(text, FILE)


def test_a_logger_stands_among_the_loggers_alone():
    logger = LOGGER.format("csv", "'{folder}'")
    config_of_file(f"logger: [{logger}]", FILE)
    config_of_file("logger: [" + LOGGER.format("'a-{name}'", "'{folder}/logs'") + "]", FILE)
    assert "a._target_" in refusal(f"a: {logger}")
    assert "logger.0.a._target_" in refusal(f"logger: [{{a: {logger}}}]")
    assert "log_dir" in refusal("logger: [{_target_: torchrl.record.CSVLogger, exp_name: a}]")


def test_ones_own_module_is_named_once_it_is_trusted(tmp_path, monkeypatch):
    (tmp_path / "my_terms.py").write_text(
        "import os\nimport torch\nfrom os import system\n\ndef low(td): ...\n\n"
        "class Mine(torch.nn.Module):\n    @classmethod\n    def built(cls): ...\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    text = refusal("reward: {_target_: my_terms.low}")
    assert "reward._target_" in text
    assert text.endswith("got my_terms.low; trust=[my_terms] if you trust its code.")
    assert "my_terms" not in sys.modules
    with trusting(["my_terms"]):
        for target in ("low", "Mine", "Mine.built"):
            config_of_file(f"a: {{_target_: my_terms.{target}}}", FILE)
        with trusting(["other"]):
            config_of_file("a: {_target_: my_terms.low}", FILE)
        for target in ("os.system", "system", "torch.load", "Mine.load_state_dict", "nosuch"):
            assert f"my_terms.{target}" in refusal(f"a: {{_target_: my_terms.{target}}}")
        refusal("a: {_target_: my_terms_too.low}")
    with trusting(["my_terms.low"]):
        config_of_file("a: {_target_: my_terms.low}", FILE)
        refusal("a: {_target_: my_terms.Mine}")
    refusal("a: {_target_: my_terms.low}")


@pytest.mark.parametrize("trust", ["my_terms", [3], ["../a"], [""], None, 3, [["a"]]])
def test_trust_is_a_list_of_modules(trust):
    with pytest.raises(ValueError, match="trust must"), trusting(trust):
        pass


def test_a_file_cannot_say_what_is_trusted():
    assert "trust" not in config_of_file(f"{ENV}trust: [os]", FILE)
    refusal(f"trust: [os]\n{ENV}a: {{_target_: os.system}}")


def _all_of(group: str) -> list[str]:
    return sorted(path.stem for path in (config_folder() / group).glob("*.yaml"))


@pytest.mark.parametrize("experiment", _all_of("experiment"))
def test_all_that_our_yaml_names_may_be_named_by_a_file(experiment):
    config = compose_config([f"experiment={experiment}"])
    assert targets_of(config)
    config_of_file(OmegaConf.to_yaml(config, resolve=True), FILE)


@pytest.mark.parametrize("group", ["env", "actor", "critic", "loss", "caps", "symmetry"])
def test_every_option_of_a_group_may_be_named_by_a_file(group):
    for option in _all_of(group):
        config = compose_config([f"{group}={option}"])
        config_of_file(OmegaConf.to_yaml(config, resolve=True), FILE)


def test_the_config_of_a_policy_that_ships_is_read_as_it_stands():
    content = torch.load(POLICIES / "best.pt", weights_only=True)
    assert checkpoint.load(POLICIES / "best.pt")["config"] == content["config"]


# Names in the source of functions that may be named by a file, and why each does no harm.
HARMLESS = {
    "instantiate": "of tables in the same file, which are checked as well",
    "get_object": "likewise, to look at its parameters",
    "load_bank": "numbers of an npz file, no pickles",
    "load_catches": "numbers of an npz file, no pickles",
    "load_rises": "numbers of an npz file, no pickles",
    "load_motions": "numbers of an npz file, no pickles",
    "load_fall_network": "a checkpoint, through zfall.checkpoint.load",
}
BUILTINS = ("open", "exec", "eval", "compile", "__import__")
SUSPECT = ("open", "system", "run", "Popen", "import_module", "check_call", "check_output")
PARTS = ("load_", "save", "write_text", "write_bytes", "unlink", "mkdir", "rmtree", "instantiate",
         "get_object", "object_at", "get_method", "pickle", "from_pretrained")  # fmt: skip


def test_nothing_that_a_file_may_name_writes_or_runs_what_it_is_given():
    modules = {path for path in ALLOWED if path.startswith("zfall")}
    names = [m.name for m in walk_packages(zfall.__path__, "zfall.") if "recipes" not in m.name]
    within = [n for n in names if any(f"{n}.".startswith(f"{path}.") for path in modules)]
    assert len(within) > 60
    for path in modules - set(names):
        module, _, name = path.rpartition(".")
        assert callable(getattr(import_module(module), name))
    for name in within:
        source = Path(str(find_spec(name).origin)).read_text()
        for node in ast.walk(ast.parse(source)):
            if not isinstance(node, ast.Call):
                continue
            function = getattr(node.func, "attr", getattr(node.func, "id", ""))
            builtin = isinstance(node.func, ast.Name) and function in BUILTINS
            suspect = builtin or function in SUSPECT or function.startswith(PARTS)
            known = function in HARMLESS or function.startswith("load_state_dict")
            known |= function == "save_for_backward"
            assert not suspect or known, f"{name} calls {function}: may a file name it?"


def test_texts_of_a_file_are_not_resolved(tmp_path):
    path = tmp_path / "overrides.yaml"
    path.write_text("- a=${oc.env:HOME}\n- b=1\n")
    assert texts_of_file(path) == ["a=${oc.env:HOME}", "b=1"]
    path.write_text("a: 1")
    with pytest.raises(ValueError, match="must be a yaml list"):
        texts_of_file(path)
