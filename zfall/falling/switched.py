"""Two policies, of which the mode chooses one, and the checkpoint of both."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.data import Composite

from zfall import checkpoint
from zfall.configs import compose_config, options_of
from zfall.envs.make import build_transform, left_out
from zfall.envs.tables import INTERFACE, changed, check_same_interface
from zfall.modules.actors import recurrent_keys
from zfall.policies.load import checkpoint_or_file
from zfall.simulation.model import identity_of

SCRIPT = "script"  # in the place of a policy that kneels: the movements alone


class SwitchedActor(TensorDictModuleBase):
    """Acts as one policy in mode RECOVER and as another in all other modes.

    The memory of ``recover`` begins anew when the robot has got up: it was trained in episodes that
    begin on its feet.

    Keys: reads ``mode`` ``(*B, 3)`` and what the two read; writes ``action`` ``(*B, J)`` and the
    hidden state of the one that has a memory.

    Args:
        recover: the policy of mode RECOVER.
        kneel: the policy of the other modes.
        begins: whether the memory of ``kneel`` is zero until it takes over, as in a training whose
            episodes begin in KNEEL; else it remembers what came before.

    Raises:
        ValueError: if both have a memory under one key: they would share it.
    """

    # It has no plain form, see ``zfall.modules.deployed``.
    not_deployed: ClassVar[str] = (
        "run must hold one policy; export recover and kneel each by itself."
    )

    def __init__(self, recover: Any, kneel: Any, *, begins: bool = False):
        super().__init__()
        for key in set(recurrent_keys(recover)) & set(recurrent_keys(kneel)):
            raise ValueError(
                f"recover and kneel must not both have a memory under one name, got {key} in both."
            )
        self.recover, self.kneel, self.begins = recover, kneel, begins
        self.in_keys = list(dict.fromkeys([*recover.in_keys, *kneel.in_keys, "mode"]))
        others = [key for key in (*recover.out_keys, *kneel.out_keys) if isinstance(key, tuple)]
        self.out_keys = ["action", *dict.fromkeys(others)]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action."""
        actions, recovers = [], tensordict["mode"][..., :1] > 0
        for actor in (self.recover, self.kneel):
            out = actor(tensordict.select(*actor.in_keys, strict=False))
            actions.append(out["action"])
            for key in self.out_keys[1:]:
                if key not in out.keys(True):
                    continue
                tensordict[key] = out[key]
                if actor is self.recover or self.begins:
                    rows = recovers == (actor is self.kneel)
                    rows = rows.view(*rows.shape, *[1] * (out[key].ndim - rows.ndim))
                    tensordict[key] = out[key].masked_fill(rows, 0.0)
        return tensordict.set("action", torch.where(recovers, *actions))


def switched_actor(
    observation_spec: Composite,
    action_spec: Composite,
    *,
    recover: Mapping[str, Any],
    kneel: Mapping[str, Any],
    begins: bool = False,
) -> SwitchedActor:
    """Both policies from their configs; they read the same ``observation``."""
    actors = [instantiate(config, observation_spec, action_spec) for config in (recover, kneel)]
    return SwitchedActor(*actors, begins=begins)


class StillActor(TensorDictModuleBase):
    """Acts with zeros: as ``kneel`` of a ``SwitchedActor`` it leaves the way down to the script.

    Keys: reads ``observation`` ``(*B, D)``, writes ``action`` ``(*B, J)``, zeros.

    Args:
        size: of the action J.
    """

    in_keys: ClassVar = ["observation"]
    out_keys: ClassVar = ["action"]

    def __init__(self, size: int):
        super().__init__()
        self.size = size

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action."""
        observation = tensordict["observation"]
        return tensordict.set("action", observation.new_zeros(*observation.shape[:-1], self.size))


def still_actor(observation_spec: Composite, action_spec: Composite) -> StillActor:
    """For an action of this size."""
    return StillActor(action_spec.shape[-1])


def switched_checkpoint(
    recover: str,
    kneel: str,
    *,
    env: str = "push_to_kneel",
    checkpoint_name: str = "last",
    changes: Sequence[str] = (),
    values: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The content of a checkpoint with both policies, in an env whose modes switch.

    Args:
        recover: run folder of a policy that recovers, the name of one that ships, or the file of a
            checkpoint.
        kneel: likewise of a policy that kneels, or ``script``.
        env: its name in ``recipes/env``.
        checkpoint_name: of the run folders, ``last``, ``best``, or a stage of both that is over.
        changes: values of the env to replace, ``["transforms.mode.probability=0.9"]``.
        values: more of them by full key, new ones too, before the changes.

    Raises:
        ValueError: if one is missing, or they do not see or do the same.
    """
    runs = {"recover": recover} if kneel == SCRIPT else {"recover": recover, "kneel": kneel}
    parts = {
        name: checkpoint.load(checkpoint_or_file(run, checkpoint_name, key=name))
        for name, run in runs.items()
    }
    configs = {name: OmegaConf.create(part["config"]) for name, part in parts.items()}
    check_same_interface(configs)
    env_cfg = _switched_env(configs, runs, env)
    for key, value in (values or {}).items():
        OmegaConf.update(env_cfg, key, value, force_add=True)
    env_cfg = changed(env_cfg, changes)
    made = instantiate(env_cfg, base_env={"num_envs": 1})
    spec, action_spec = made.observation_spec, made.action_spec
    actors = []
    for name, part in parts.items():
        with checkpoint.reading(Path(runs[name])):
            actor = instantiate(configs[name].actor, spec, action_spec)
            checkpoint.check_fits(part, identity_of(made.base_env.robot), actor, Path(runs[name]))
            actor.load_state_dict(part["policy"])
        actors.append(actor)
    actor_cfg = {"_target_": "zfall.falling.switched.switched_actor", "_recursive_": False}
    actor_cfg |= {name: OmegaConf.to_container(configs[name].actor) for name in parts}
    if kneel == SCRIPT:
        actor_cfg["kneel"] = {"_target_": "zfall.falling.switched.still_actor"}
        actors.append(still_actor(spec, action_spec))
    elif begins_kneeling(configs["kneel"].env):
        actor_cfg["begins"] = True
    state = SwitchedActor(*actors).state_dict()
    config = OmegaConf.create({"env": env_cfg, "actor": actor_cfg, "num_envs": 1})
    return {
        "config": OmegaConf.to_yaml(config, resolve=True),
        "robot": parts["recover"]["robot"],
        "actor": state,
        "policy": state,
    }


def _switched_env(
    configs: Mapping[str, DictConfig], runs: Mapping[str, str], name: str
) -> DictConfig:
    """The env of this name with what the policies need of their own."""
    if name not in options_of("env"):
        raise ValueError(f"env must be one of {', '.join(options_of('env'))}, got {name!r}.")
    env_cfg = compose_config([f"env={name}", "num_envs=1"]).env
    if env_cfg.transforms.get("mode") is None:
        raise ValueError(f"env must have a mode machine, as push_to_kneel has, got {name}.")
    OmegaConf.set_struct(env_cfg, False)  # changes may bring keys that it does not name
    last = configs["kneel" if "kneel" in configs else "recover"].env
    env_cfg.base_env = last.base_env
    if "kneel" in configs and last.transforms.get("mode") is None:
        raise ValueError(
            f"kneel must be a policy that kneels, trained with modes; {runs['kneel']} is not."
        )
    for name, cfg in configs.items():
        for key in sensing_and_acting(cfg.env, env_cfg):
            raise ValueError(
                f"{name} must need no {key} besides action and observation to be switched, "
                f"{runs[name]} has transforms.{key}."
            )
    # What kneels brings these along, recovering alone needs none.
    own = ["kneel_reference", "mirrored_falls"] if "kneel" in configs else []
    if "kneel" in configs and env_cfg.transforms.mode.get("rise") is None:
        own.append("mode")  # else its training had no way up
    for name in (*INTERFACE, *own):
        env_cfg.transforms[name] = last.transforms.get(name)
    env_cfg.transforms.mode.initial = "recover"
    return without_exploration(env_cfg)


def sensing_and_acting(env_cfg: DictConfig, known: DictConfig) -> list[str]:
    """Names of transforms between policy and physics that another table does not have.

    They change targets or commands on their way to the servos, or write measured values or
    something that ``observation`` reads: estimators, lags, servo models. Those of training alone
    do not count.

    Args:
        env_cfg: config of an env.
        known: config of the env with the other table.
    """
    only = left_out(OmegaConf.select(env_cfg, "training_only", default={}))
    unknown = {
        str(name): {key: value for key, value in transform.items() if key != "before"}
        for name, transform in env_cfg.transforms.items()
        if transform is not None and name not in {*known.transforms, *only}
    }
    if not unknown:
        return []
    base = instantiate(env_cfg.base_env, num_envs=1, _convert_="all")
    commands = {"action", "target", "control"}
    keys = OmegaConf.select(env_cfg, "transforms.observation.keys", default=[])
    seen = {key for key in keys if isinstance(key, str)}
    found = []
    for name, config in unknown.items():
        transform = build_transform(config, base, f"transforms.{name}")
        acts = commands & {*(transform.in_keys_inv or ()), *(transform.out_keys_inv or ())}
        written = transform.out_keys or ()
        measures = any(isinstance(key, tuple) and key[0] == "measured" for key in written)
        if acts or measures or seen & set(written):
            found.append(name)
    return found


def begins_kneeling(env_cfg: DictConfig) -> bool:
    """Whether episodes of a training begin in mode KNEEL, and so the memory of its policy."""
    return bool(OmegaConf.select(env_cfg, "transforms.mode.initial") == "kneel")


def without_exploration(env_cfg: DictConfig) -> DictConfig:
    """The env's config with the bounds of rest of a policy that does not explore.

    They are 0.1 m/s and rad/s, see ``ModeMachine``. Where the robot rises after rest, they stay.
    """
    new = env_cfg.copy()
    if OmegaConf.select(env_cfg, "transforms.mode.rise") is not None:
        return new
    for key in ("rest_speed", "rest_joint_speed"):
        OmegaConf.update(new, f"transforms.mode.{key}", 0.1, force_add=True)
    return new
