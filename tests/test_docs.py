"""What the pages show works as shown."""

import re
import shlex
import sys
from inspect import isclass
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml
from hydra.utils import get_object, instantiate
from torch import nn
from torch.testing import assert_close
from torchrl.envs import Transform

from zfall.envs.make import build_transform
from zfall.simulation.model import Ball
from zfall.training.learner import Learner

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "transforms.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
LINES = re.findall(r"`(\w+: \{_target_: \.\.\..*?\})` \|", PAGE)


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.split(":")[0])
def test_every_line_of_yaml_makes_its_transform(make_base, line):
    ((_, config),) = yaml.safe_load(line.replace("...", "zfall.envs.transforms.")).items()
    env = make_base(ball=Ball(mass=0.2, radius=0.04))
    made = get_object(config["_target_"])
    assert isinstance(build_transform(config, env), made if isclass(made) else Transform)


def test_the_page_shows_every_transform():
    shown = set(re.findall(r"^\| `([\w.]+)`", PAGE, re.MULTILINE))
    folder = ROOT / "zfall" / "envs" / "transforms"
    there = set()
    for path in folder.rglob("*.py"):
        concept = path.relative_to(folder).parts[0].removesuffix(".py")
        names = re.findall(r"^class (\w+)\(Transform\)", path.read_text(), re.MULTILINE)
        there |= {f"{concept}.{name}" for name in names}
    assert len(there) > 20
    assert there <= shown


def test_the_example_of_an_own_transform_obeys_its_law(tmp_path, monkeypatch):
    module, test, *_ = BLOCKS
    (tmp_path / "wind.py").write_text(module)
    monkeypatch.syspath_prepend(tmp_path)
    space: dict = {}
    exec(test, space)
    space["test_momentum_is_force_times_time"]()
    sys.modules.pop("wind")


def test_the_example_of_worlds_in_turns_collects_a_batch():
    page = (ROOT / "docs" / "learning.md").read_text()
    (block,) = re.findall(r"```python\n(from hydra import .*?)```", page, re.DOTALL)
    space: dict[str, Any] = {"policy": lambda td: td.set("action", torch.zeros(len(td), 20))}
    exec(block.replace("512", "6").replace("cfg.num_envs)", "cfg.num_envs, 2)"), space)
    assert space["batch"].shape == (6, 16)
    assert space["batch"]["next", "reward"].shape == (6, 16, 1)


def test_an_own_transform_takes_part_in_training(tmp_path, monkeypatch, compose_config):
    module, *_ = BLOCKS
    (tmp_path / "wind.py").write_text(module)
    monkeypatch.syspath_prepend(tmp_path)
    wind = "+env.transforms.wind={_target_:wind.SteadyWind,point:torso,force:2.0}"
    sizes = ["num_envs=4", "rollout_steps=3", "minibatches=1", "epochs=1"]
    learner = Learner(compose_config(wind, *sizes))
    seen = []
    base = learner.env.base_env
    step = base._step
    base._step = lambda td: seen.append(td["push", "wrench"].clone()) or step(td)
    learner.learn(learner.collect())
    body = base.push_targets["torso"]
    assert all((wrench[:, :, body, 0] > 1.99).all() for wrench in seen)
    sys.modules.pop("wind")


def test_the_example_of_an_own_observation_is_seen(tmp_path, monkeypatch, compose_config):
    """Its own test passes; by the line of the shell the critic's vector ends with it."""
    (tmp_path / "stance.py").write_text(BLOCKS[2])
    monkeypatch.syspath_prepend(tmp_path)
    space: dict = {}
    exec(BLOCKS[3], space)
    space["test_width_is_the_distance_of_the_soles"]()
    given = next(re.finditer(r"make train ARGS=\"(.*stance.StanceWidth.*)\"", PAGE))[1]
    env = instantiate(compose_config("num_envs=4", *shlex.split(given)).env)
    for td in (env.reset(), env.rollout(3)["next"][:, -1]):
        assert td["observation_critic"].shape == (4, 3 + 3 + 20 + 20 + 1)
        assert_close(td["observation_critic"][:, -1:], td["stance_width"], rtol=0, atol=0)
    sys.modules.pop("stance")


def test_an_own_reward_term_is_worth_what_it_says(tmp_path, monkeypatch, compose_config):
    """Shoulders rolled by 0.3 rad, at a sigma of 0.3 rad and a weight of 0.05: 0.05 / e."""
    (tmp_path / "my_terms.py").write_text(BLOCKS[-1])
    monkeypatch.syspath_prepend(tmp_path)
    (line,) = re.findall(r"'(\+env.transforms.reward.terms.*?)'", PAGE)
    env = instantiate(compose_config(line, "num_envs=2").env, training=False)
    td = env.reset()
    simulation, robot = env.base_env.simulation, env.base_env.robot
    for side in ("left", "right"):
        joint = simulation.model.joint(f"{side}_shoulder_roll")
        simulation.qpos[:, int(joint.qposadr[0])] = 0.3
    td["action"] = torch.zeros(2, len(robot.joints))
    worth = env.step(td)["next", "reward_terms", "low_hands"]
    rolls = simulation.qpos[
        :, [int(simulation.model.joint(f"{s}_shoulder_roll").qposadr[0]) for s in ("left", "right")]
    ]
    assert_close(worth, 0.05 * torch.exp(-((rolls / 0.3) ** 2).mean(1, keepdim=True)).float())
    assert (worth < 0.045).all()  # the arms have begun to move back
    sys.modules.pop("my_terms")


def learning_example(name: str) -> str:
    """The block of learning.md that begins with the name of its file."""
    page = (ROOT / "docs" / "learning.md").read_text()
    (block,) = re.findall(rf"```python\n(# {name}\n.*?)```", page, re.DOTALL)
    return block


def test_an_own_actor_takes_part_in_training(tmp_path, monkeypatch, compose_config):
    """The example of learning.md: its yaml is found, it explores by its Gaussian and it learns."""
    (tmp_path / "my_actors.py").write_text(learning_example("my_actors.py"))
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "actor").mkdir()
    page = (ROOT / "docs" / "learning.md").read_text()
    (values,) = re.findall(r"```yaml\n(_target_: my_actors.*?)```", page, re.DOTALL)
    (tmp_path / "actor" / "layer_norm.yaml").write_text(values)
    own = (f"hydra.searchpath=[file://{tmp_path}]", "actor=layer_norm", "actor.width=64")
    learner = Learner(compose_config(*own, "num_envs=8", "rollout_steps=8", "caps=atalante"))
    batch = learner.collect()
    params = learner.actor.get_submodule("module.0")(batch.select("observation"))
    normal = torch.distributions.Normal(params["loc"], params["scale"])
    assert_close(batch["action_log_prob"], normal.log_prob(batch["action"]).sum(-1))
    weights = [layer.weight for layer in learner.actor.modules() if isinstance(layer, nn.Linear)]
    assert [tuple(weight.shape[:1]) for weight in weights] == [(64,), (64,), (40,)]
    before = [weight.clone() for weight in weights]
    learner.learn(batch)
    sys.modules.pop("my_actors")
    assert all((weight != old).any() for weight, old in zip(weights, before, strict=True))


def test_an_own_loss_takes_part_in_training(tmp_path, monkeypatch, compose_config):
    """The example of learning.md: with a large weight it keeps the actions small."""
    (tmp_path / "my_losses.py").write_text(learning_example("my_losses.py"))
    monkeypatch.syspath_prepend(tmp_path)
    there: dict[str, Any] = {}
    exec(learning_example("test_my_losses.py"), there)  # its own test, which stands below it
    there["test_size_is_the_mean_square_of_the_mean_action"]()
    sizes = []
    for coeff in (0.0, 10.0):
        loss = f"+auxiliary_losses.size={{_target_:my_losses.SmallActions,coeff:{coeff}}}"
        learner = Learner(compose_config(loss, "num_envs=8", "rollout_steps=8"))
        losses = [learner.learn(learner.collect()) for _ in range(4)][-1]
        assert "loss_size" in losses
        mean = learner.actor.get_dist(learner.collect()).mean
        sizes.append(mean.square().mean().item())
    sys.modules.pop("my_losses")
    assert sizes[1] < 0.7 * sizes[0]


def test_an_own_ppo_takes_part_in_training(tmp_path, monkeypatch, compose_config):
    """The example of learning.md: with factor 1 it is PPO, with 0 bad actions teach nothing."""
    (tmp_path / "my_ppo.py").write_text(learning_example("my_ppo.py"))
    monkeypatch.syspath_prepend(tmp_path)
    small = ("num_envs=8", "rollout_steps=8", "loss.normalize_advantage=null")
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
    sys.modules.pop("my_ppo")
    assert_close(*losses[1.0])
    # Before the first step all ratios are 1: the objective is the mean of what is left.
    assert_close(losses[0.0][0], -advantage.clamp(min=0).mean())
    assert not torch.isclose(*losses[0.0])
