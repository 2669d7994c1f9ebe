"""Puts a policy that recovers and one that kneels together, switched by the mode machine.

``python -m recipes.falling.switch recover=RUN kneel=RUN hydra.run.dir=runs/switched`` writes a run folder
that ``recipes.evaluate`` takes. With ``kneel=script`` the movements of ``recipes.falling.catches`` kneel.
"""

from pathlib import Path
from typing import Any

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from recipes.shell import one_line_errors, start
from zfall import checkpoint
from zfall.configs import compose_config
from zfall.envs.make import left_out
from zfall.envs.tables import INTERFACE, changed, check_same_interface
from zfall.errors import check_keys
from zfall.evaluation.candidate import begins_kneeling, without_exploration
from zfall.falling.switched import SwitchedActor, still_actor
from zfall.policies.load import checkpoint_of
from zfall.simulation.model import identity_of

SCRIPT = "script"


@hydra.main(version_base=None, config_path=".", config_name="switch")
def main(cfg: DictConfig) -> None:
    """Writes ``checkpoints/last.pt`` with both policies and the env ``push_to_kneel``."""
    with one_line_errors():
        check_keys(cfg, {"recover", "kneel", "checkpoint", "change"})
        folder = Path(HydraConfig.get().runtime.output_dir)
        content = switched(cfg)
    (folder / "checkpoints").mkdir(parents=True, exist_ok=True)
    checkpoint.save(folder / "checkpoints" / "last.pt", content)
    print(f"wrote {folder}/checkpoints/last.pt")


def switched(cfg: DictConfig) -> dict[str, Any]:
    """The content of a checkpoint of both.

    Raises:
        ValueError: if one is missing, or they do not see or do the same.
    """
    names = ("recover",) if cfg.kneel == SCRIPT else ("recover", "kneel")
    parts = {
        name: checkpoint.load(checkpoint_of(cfg[name], cfg.checkpoint, key=name)) for name in names
    }
    configs = {name: OmegaConf.create(part["config"]) for name, part in parts.items()}
    check_same_interface(configs)
    env_cfg = compose_config(["env=push_to_kneel", "num_envs=1"]).env
    OmegaConf.set_struct(env_cfg, False)  # changes may bring keys that it does not name
    last = configs[names[-1]].env
    env_cfg.base_env = last.base_env
    if "kneel" in names and last.transforms.get("mode") is None:
        raise ValueError(
            f"kneel must be a policy that kneels, trained with modes; {cfg.kneel} is not."
        )
    for name in names:
        for key in sensing_and_acting(configs[name].env, env_cfg):
            raise ValueError(
                f"{name} must need no {key} besides action and observation to be switched, "
                f"{cfg[name]} has transforms.{key}."
            )
    # What kneels brings these along, recovering alone needs none.
    own = ("kneel_reference", "mode", "mirrored_falls") if "kneel" in names else ()
    for name in (*INTERFACE, *own):
        env_cfg.transforms[name] = last.transforms.get(name)
    env_cfg.transforms.mode.initial = "recover"
    env_cfg = changed(without_exploration(env_cfg), cfg.change)
    env = instantiate(env_cfg, base_env={"num_envs": 1})
    spec, action_spec = env.observation_spec, env.action_spec
    actors = []
    for name, part in parts.items():
        actor = instantiate(configs[name].actor, spec, action_spec)
        checkpoint.check_fits(part, identity_of(env.base_env.robot), actor, Path(cfg[name]))
        actor.load_state_dict(part["policy"])
        actors.append(actor)
    actor_cfgs = {name: OmegaConf.to_container(configs[name].actor) for name in parts}
    if cfg.kneel == SCRIPT:
        actor_cfgs["kneel"] = {"_target_": "zfall.falling.switched.still_actor"}
        actors.append(still_actor(spec, action_spec))
    state = SwitchedActor(*actors).state_dict()
    actor_cfg = {"_target_": "zfall.falling.switched.switched_actor", "_recursive_": False}
    actor_cfg |= actor_cfgs
    if "kneel" in names and begins_kneeling(last):
        actor_cfg["begins"] = True
    config = OmegaConf.create({"env": env_cfg, "actor": actor_cfg, "num_envs": 1})
    return {
        "config": OmegaConf.to_yaml(config, resolve=True),
        "robot": parts["recover"]["robot"],
        "actor": state,
        "policy": state,
    }


def sensing_and_acting(env_cfg: DictConfig, known: DictConfig) -> list[str]:
    """Names of transforms between policy and physics that a table does not have: estimators, lags.

    Those of training alone do not count.
    """
    places = tuple(
        f"zfall.envs.transforms.{name}" for name in ("actions", "observations", "estimation")
    )
    only = left_out(OmegaConf.select(env_cfg, "training_only", default={}))
    return [
        name
        for name, transform in env_cfg.transforms.items()
        if transform is not None
        and transform._target_.startswith(places)
        and name not in {*known.transforms, *only}
    ]


if __name__ == "__main__":
    start(main)
