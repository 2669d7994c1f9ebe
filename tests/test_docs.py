"""What the pages show works as shown."""

import re
import shlex
import sys
from collections.abc import Callable, Iterator
from inspect import isclass
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.utils import get_object, instantiate
from torch.testing import assert_close
from torchrl.envs import Transform
from torchrl.modules import set_recurrent_mode

from tests.shell import TINY, run
from zfall.cluster.launcher import register
from zfall.envs.make import build_transform
from zfall.robots import Ball
from zfall.training.learner import Learner

ROOT = Path(__file__).parents[1]
GUIDE = sorted((ROOT / "docs" / "guide").glob("*.md"))
REFERENCE = ROOT / "docs" / "reference"
CARDS = ROOT / "zfall" / "policies"
TOP = [ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md")]
PAGES = [*TOP, *sorted((ROOT / "docs").rglob("*.md")), *sorted(CARDS.glob("*.md"))]
OF_TRANSFORMS = {"transforms.md": "zfall.envs.transforms.", "falling.md": "zfall.falling."}
CODE = re.compile(r"```(\w*)\n(.*?)```", re.DOTALL)


def blocks(page: Path, language: str = "python") -> list[str]:
    """The blocks of code of a page."""
    return [code for kind, code in CODE.findall(page.read_text()) if kind == language]


def named(code: str) -> str | None:
    """The file that a block is to be put into, by its first line."""
    match = re.match(r"# (\w+\.py)\n", code)
    return match and match[1]


FILES = {named(code): code for page in GUIDE for code in blocks(page) if named(code)}
SCRIPTS = [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in [ROOT / "README.md", *GUIDE]
    for number, code in enumerate(blocks(page))
    if not named(code)
]


@pytest.fixture
def in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Path]]:
    """Puts files that the guide shows into an empty folder, from which Python imports them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)

    def write(*names: str) -> Path:
        for name in names:
            (tmp_path / name).write_text(FILES[name])
        return tmp_path

    yield write
    for name in FILES:
        sys.modules.pop(Path(name).stem, None)


def put(path: Path, text: str) -> None:
    """Writes a file, with its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


def yaml_with(page: str, word: str) -> str:
    """The block of yaml of a page of the guide that has a word."""
    (found,) = [code for code in blocks(ROOT / "docs/guide" / page, "yaml") if word in code]
    return found


# Pages as they are.


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file(page):
    text = CODE.sub("", page.read_text())
    links = re.findall(r"\]\(([^)\s]+)\)", text)
    for link in (link for link in links if "://" not in link):
        path, _, anchor = link.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.exists(), link
        if anchor:
            heads = re.findall(r"^#+ (.*)$", CODE.sub("", there.read_text()), re.MULTILINE)
            assert anchor in {_anchor(head) for head in heads}, link


def _anchor(heading: str) -> str:
    """As GitHub makes it of a heading."""
    kept = re.sub(r"[^\w\- ]", "", heading.lower().strip())
    return kept.replace(" ", "-")


def test_the_readme_has_at_most_150_lines():
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_every_function_named_in_from_a_sentence_to_the_code_is_in_its_file():
    page = ROOT / "docs/guide/from-a-sentence-to-the-code.md"
    rows = [line for line in page.read_text().splitlines() if line.startswith("| ")]
    places = 0
    for row in rows:
        match = re.search(r"\]\(([^)]+)\) \| ([^|]*) \|$", row)
        if match is None:
            continue
        path, functions = match[1], match[2]
        code = (page.parent / path).read_text()
        for name in re.findall(r"`([\w.]+)`", functions):
            places += 1
            for part in name.split("."):
                assert re.search(rf"^\s*(def|class) {part}\b", code, re.MULTILINE), (path, name)
    assert places > 40


@pytest.mark.parametrize(("page", "package"), OF_TRANSFORMS.items())
def test_every_line_of_yaml_makes_its_transform(make_base, page, package):
    lines = re.findall(r"`(\w+: \{_target_: \.\.\..*?\})` \|", (REFERENCE / page).read_text())
    assert len(lines) > 4
    for line in lines:
        ((name, config),) = yaml.safe_load(line.replace("...", package)).items()
        env = make_base(ball=Ball(mass=0.2, radius=0.04))
        made = get_object(config["_target_"])
        built = build_transform(config, env)
        assert isinstance(built, made if isclass(made) else Transform), name


def test_the_page_of_transforms_shows_every_transform():
    page = (REFERENCE / "transforms.md").read_text()
    shown = set(re.findall(r"^\| `([\w.]+)`", page, re.MULTILINE))
    folder = ROOT / "zfall" / "envs" / "transforms"
    there = set()
    for path in folder.rglob("*.py"):
        concept = path.relative_to(folder).parts[0].removesuffix(".py")
        names = re.findall(r"^class (\w+)\(Transform\)", path.read_text(), re.MULTILINE)
        there |= {f"{concept}.{name}" for name in names}
    assert len(there) > 20
    assert there <= shown


# Commands.


def commands() -> Iterator[Any]:
    """Lines of the shell in README and guide, without those that need files of a user."""
    for page in [ROOT / "README.md", *GUIDE]:
        text = page.read_text()
        for line in re.findall(r"(?:make train ARGS=\".*\"|python -m recipes\.[^`\n]*)", text):
            if "--config-dir" in line or re.search(r"wind\.|stance\.|my_\w+\.", line):
                continue
            if line.startswith("make"):
                recipe, args = "train", shlex.split(shlex.split(line)[2].removeprefix("ARGS="))
            else:
                words = shlex.split(line, comments=True)
                recipe, args = words[2].removeprefix("recipes."), words[3:]
            yield pytest.param(recipe, args, id=f"{page.stem}-{recipe}-{' '.join(args)[:60]}")


@pytest.mark.parametrize(("recipe", "args"), list(commands()))
def test_every_command_has_a_recipe_and_values_that_it_knows(recipe, args):
    folder = ROOT / "recipes"
    *below, name = recipe.split(".")
    folder = folder.joinpath(*below)
    assert (folder / f"{name}.py").exists()
    register()
    with initialize_config_dir(str(folder), version_base=None):
        compose(name, overrides=first_of_sweep([arg for arg in args if arg != "-m"]))


def first_of_sweep(args: list[str]) -> list[str]:
    """Overrides of the first job of a sweep."""
    parsed = zip(args, OverridesParser.create().parse_overrides(args), strict=True)
    return [
        f"{each.get_key_element()}={next(each.sweep_string_iterator())}"
        if each.is_sweep_override()
        else arg
        for arg, each in parsed
    ]


def test_the_tiny_training_of_the_first_policy_trains(tmp_path):
    (line,) = re.findall(
        r"make train ARGS=\"(.*total_frames=64.*)\"",
        (ROOT / "docs/guide/first-policy.md").read_text(),
    )
    done = run("train", *line.split(), f"hydra.run.dir={tmp_path}/run")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run/checkpoints/last.pt").exists()


# Examples in Python.


@pytest.mark.long
@pytest.mark.parametrize("code", SCRIPTS)
def test_every_example_runs_as_it_stands(code, tmp_path, monkeypatch):
    """In an empty folder, with six worlds where the page has 512, and one start where it has 2."""
    monkeypatch.chdir(tmp_path)
    for long, short in (("num_envs=512", "num_envs=6"), ('"starts": 2', '"starts": 1')):
        code = code.replace(long, short)
    exec(compile(code, "example", "exec"), {})


def test_the_example_of_an_own_transform_obeys_its_law(in_folder):
    in_folder("wind.py")
    space: dict[str, Any] = {}
    exec(FILES["test_wind.py"], space)
    space["test_momentum_is_force_times_time"]()


def test_a_table_of_your_own_blows_in_every_step(in_folder, compose_config):
    folder = in_folder("wind.py")
    put(folder / "conf/env/windy.yaml", yaml_with("tasks.md", "SteadyWind"))
    small = ("num_envs=4", "rollout_steps=3", "minibatches=1", "epochs=1")
    learner = Learner(
        compose_config(f"hydra.searchpath=[file://{folder}/conf]", "env=windy", *small)
    )
    seen = []
    base = learner.env.base_env
    step = base._step
    base._step = lambda td: seen.append(td["push", "wrench"].clone()) or step(td)
    learner.learn(learner.collect())
    body = base.push_targets["torso"]
    assert all((wrench[:, :, body, 0] > 1.5).all() for wrench in seen)


def test_the_example_of_an_own_observation_is_seen(in_folder, compose_config):
    """Its own test passes; by the line of the shell the critic's vector ends with it."""
    in_folder("stance.py")
    space: dict[str, Any] = {}
    exec(FILES["test_stance.py"], space)
    space["test_width_is_the_distance_of_the_soles"]()
    page = (ROOT / "docs/guide/tasks.md").read_text()
    given = next(re.finditer(r"make train ARGS=\"(.*stance.StanceWidth.*)\"", page))[1]
    env = instantiate(compose_config("num_envs=4", *shlex.split(given)).env)
    for td in (env.reset(), env.rollout(3)["next"][:, -1]):
        assert td["observation_critic"].shape == (4, 3 + 3 + 20 + 20 + 1)
        assert_close(td["observation_critic"][:, -1:], td["stance_width"], rtol=0, atol=0)


def test_an_own_reward_term_is_worth_what_it_says(in_folder, compose_config):
    """Shoulders rolled by 0.3 rad, at a sigma of 0.3 rad and a weight of 0.05: 0.05 / e."""
    in_folder("my_terms.py")
    page = (ROOT / "docs/guide/tasks.md").read_text()
    (line,) = re.findall(r"'(\+env.transforms.reward.terms.*?)'", page)
    env = instantiate(compose_config(line, "num_envs=2").env, training=False)
    td = env.reset()
    simulation, robot = env.base_env.simulation, env.base_env.robot
    places = [
        int(simulation.model.joint(f"{side}_shoulder_roll").qposadr[0])
        for side in ("left", "right")
    ]
    simulation.qpos[:, places] = 0.3
    td["action"] = torch.zeros(2, len(robot.joints))
    worth = env.step(td)["next", "reward_terms", "low_hands"]
    rolls = simulation.qpos[:, places]
    assert_close(worth, 0.05 * torch.exp(-((rolls / 0.3) ** 2).mean(1, keepdim=True)).float())
    assert (worth < 0.045).all()  # the arms have begun to move back


def own_actor(name: str, word: str, folder: Path, compose_config: Callable[..., Any]) -> Learner:
    """A learner with an actor of learning.md, found by its yaml."""
    put(folder / f"conf/actor/{name}.yaml", yaml_with("learning.md", word))
    own = (f"hydra.searchpath=[file://{folder}/conf]", f"actor={name}")
    return Learner(compose_config(*own, "num_envs=8", "rollout_steps=8", "caps=atalante"))


def test_an_own_actor_explores_by_its_gaussian_and_learns(in_folder, compose_config):
    learner = own_actor("layer_norm", "layer_norm_actor", in_folder("my_actors.py"), compose_config)
    batch = learner.collect()
    params = learner.actor.get_submodule("module.0")(batch.select("observation"))
    normal = torch.distributions.Normal(params["loc"], params["scale"])
    assert_close(batch["action_log_prob"], normal.log_prob(batch["action"]).sum(-1))
    before = [value.clone() for value in learner.actor.parameters()]
    learner.learn(batch)
    moved = zip(learner.actor.parameters(), before, strict=True)
    assert all((value != old).any() for value, old in moved)


def test_an_own_lstm_replays_what_it_did_and_learns(in_folder, compose_config):
    """Sequences from the stored hidden state have the log-probabilities of collection."""
    learner = own_actor("lstm", "lstm_actor", in_folder("my_lstm.py"), compose_config)
    learner.learn(learner.collect())
    batch = learner.collect()
    with torch.no_grad(), set_recurrent_mode(True):
        policy = learner.actor.get_dist(batch.select(*learner.actor.in_keys))
    assert_close(policy.log_prob(batch["action"]), batch["action_log_prob"], rtol=1e-4, atol=1e-3)
    lstm = [value.clone() for name, value in learner.actor.named_parameters() if "lstm" in name]
    assert lstm
    learner.learn(batch)
    now = [value for name, value in learner.actor.named_parameters() if "lstm" in name]
    assert all((value != old).any() for value, old in zip(now, lstm, strict=True))


def test_an_own_loss_keeps_the_actions_small_with_a_large_weight(in_folder, compose_config):
    in_folder("my_losses.py")
    there: dict[str, Any] = {}
    exec(FILES["test_my_losses.py"], there)
    there["test_size_is_the_mean_square_of_the_mean_action"]()
    sizes = []
    for coeff in (0.0, 10.0):
        loss = f"+auxiliary_losses.size={{_target_:my_losses.SmallActions,coeff:{coeff}}}"
        learner = Learner(compose_config(loss, "num_envs=8", "rollout_steps=8"))
        losses = [learner.learn(learner.collect()) for _ in range(4)][-1]
        assert "loss_size" in losses
        mean = learner.actor.get_dist(learner.collect()).mean
        sizes.append(mean.square().mean().item())
    assert sizes[1] < 0.7 * sizes[0]


def test_an_own_ppo_takes_part_in_training(in_folder, compose_config):
    """With factor 1 it is PPO, with 0 bad actions teach nothing."""
    in_folder("my_ppo.py")
    still = ("loss.normalize_advantage=null", "statistics_batches=0")
    small = ("num_envs=8", "rollout_steps=8", *still)
    losses = {}
    for below in (1.0, 0.0):
        own = ("+loss._target_=my_ppo.OptimisticPPOLoss", f"+loss.below={below}")
        learner, plain = (Learner(compose_config(*small, *more)) for more in (own, ()))
        batch = learner.collect()
        with torch.no_grad():
            plain.advantage(batch)
        advantage = batch["advantage"]
        assert (advantage > 0).any()
        assert (advantage < 0).any()
        losses[below] = learner.loss(batch)["loss_objective"], plain.loss(batch)["loss_objective"]
        learner.learn(batch)
    assert_close(*losses[1.0])
    # Before the first step all ratios are 1: the objective is the mean of what is left.
    assert_close(losses[0.0][0], -advantage.clamp(min=0).mean())
    assert not torch.isclose(*losses[0.0])


def test_an_own_logger_gets_every_figure(in_folder):
    folder = in_folder("my_logger.py")
    ((entry,),) = yaml.safe_load(yaml_with("learning.md", "my_logger")).values()
    logger = "logger=[{" + ",".join(f'{key}:"{value}"' for key, value in entry.items()) + "}]"
    done = run("train", *TINY, logger, f"hydra.run.dir={folder}/run")
    assert done.returncode == 0, done.stderr
    lines = (folder / "run/figures.jsonl").read_text().splitlines()
    names = {yaml.safe_load(line)["name"] for line in lines}
    assert {"kl", "episode_return"} <= names


def test_a_battery_of_your_own_with_its_kind_and_measure(in_folder):
    folder = in_folder("my_measures.py", "my_kinds.py")
    put(folder / "conf/battery/lifted.yaml", yaml_with("batteries.md", "my_kinds"))
    args = ("--config-dir", f"{folder}/conf", "run=pose_hold", "battery=lifted", "directions=4")
    done = run("evaluate", *args, f"hydra.run.dir={folder}/out")
    assert done.returncode == 0, done.stderr
    (trials,) = (folder / "out").rglob("trials.csv")
    header, first, *_ = trials.read_text().splitlines()
    lift = dict(zip(header.split(","), first.split(","), strict=True))["foot_lift"]
    assert 0 <= float(lift) < 0.05  # of a trial without a push [m]
    summary = yaml.safe_load(trials.with_name("summary.json").read_text())
    low, high = summary["recovered_interval"]
    assert low <= summary["recovered"] <= high
