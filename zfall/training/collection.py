"""The worlds of a training, in groups that alternate."""

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import DictConfig
from tensordict import NestedKey, TensorDictBase
from torchrl._utils import seed_generator
from torchrl.envs import ExplorationType, TransformedEnv, set_exploration_type

from zfall.envs.env_state import env_state, load_env_state
from zfall.modules.memory import memory_primer
from zfall.simulation.turns import in_turns, physics_first
from zfall.training.ranks import ALONE, Policy, Ranks

PAYS_FROM = 256  # worlds in all: with fewer, two calls take longer than the physics between them


def group_sizes(num_envs: int, groups: int | None) -> list[int]:
    """How many worlds each group has, as equal as can be; ``groups`` as in ``recipes.train``.

    Raises:
        ValueError: if there are none or more than worlds.
    """
    if groups is not None and not 1 <= groups <= num_envs:
        raise ValueError(
            f"groups must be null, or from 1 to the {num_envs} worlds of num_envs, got {groups}."
        )
    count = groups or (2 if num_envs >= PAYS_FROM else 1)
    fewer, more = divmod(num_envs, count)
    return [fewer + (group < more) for group in range(count)]


def _built(env_cfg: DictConfig, sizes: Sequence[int]) -> list[TransformedEnv]:
    """An env for each group; an error speaks of all worlds, ``num_envs`` as it was given."""
    try:
        return [instantiate(env_cfg, base_env={"num_envs": size}) for size in sizes]
    except InstantiationException:
        if len(sizes) > 1:
            instantiate(env_cfg, base_env={"num_envs": sum(sizes)})
        raise


class Worlds:
    """Envs of the same task that are stepped alternately, see ``zfall.simulation.turns.in_turns``.

    Rows of what it returns are those of the first env, then those of the second, and so on.

    Args:
        env_cfg: config of the env.
        num_envs: worlds N in all.
        groups: envs that they are spread over; ``None``: two from 256 worlds on, else one. An env
            without a ``base_env`` is one group.
        ranks: of which this one has a part of the worlds.
        alike: worlds in a row that no part may divide.

    Attributes:
        carriers: what the worlds of each env are in, before the coming step; after ``begin``.

    Raises:
        ValueError: if there are more groups than worlds, or than an env can be spread over.
    """

    def __init__(
        self,
        env_cfg: DictConfig,
        num_envs: int,
        groups: int | None = None,
        ranks: Ranks = ALONE,
        alike: int = 1,
    ):
        sizes = group_sizes(num_envs, groups if "base_env" in env_cfg else groups or 1)
        self.ranks, self.pieces = ranks, ranks.pieces(sizes, alike)
        self._groups = len(sizes)
        if "base_env" in env_cfg:
            own = [piece.worlds for piece in self.pieces]
            self.envs: list[TransformedEnv] = _built(env_cfg, own)
        elif groups in (None, 1):
            self.envs = [instantiate(env_cfg)]
        else:
            raise ValueError(f"groups must be 1 or null without env.base_env, got {groups}.")
        self.carriers: list[TensorDictBase] = []

    @property
    def env(self) -> TransformedEnv:
        """The first of them, for what is the same in all."""
        return self.envs[0]

    @property
    def carrier(self) -> TensorDictBase:
        """What all worlds are in ``(N,)``, before the coming step."""
        return self.carriers[0] if len(self.carriers) == 1 else torch.cat(self.carriers)

    def remember(self, module: torch.nn.Module, place: str) -> None:
        """Has the envs carry the memory of a recurrent module; before ``begin``.

        Raises:
            ValueError: if the module, called ``place``, does not say how its memory begins.
        """
        for env in self.envs:
            env.append_transform(memory_primer(module, place))

    def begin(self, seed: int) -> None:
        """Seeds the envs, each by what TorchRL makes of the seed before it, and resets them.

        Raises:
            ValueError: if a part of an env's worlds are to be stepped that have no streams.
        """
        seeds = [seed]
        while len(seeds) <= self.pieces[-1].group:
            seeds.append(seed_generator(seeds[-1]))
        for env, piece in zip(self.envs, self.pieces, strict=True):
            env.set_seed(seeds[piece.group])
            if not piece.first:
                continue
            streams = getattr(getattr(env, "base_env", None), "streams", None)
            if streams is None:
                raise ValueError(
                    "launch.ranks must be 1 for an env whose worlds have no random streams of "
                    "their own, zfall.envs.streams."
                )
            worlds = range(piece.first, piece.first + piece.worlds)
            streams.begin(seeds[piece.group], worlds)
        self.carriers = [env.reset() for env in self.envs]

    def close(self) -> None:
        """Lets go of the envs; nothing can be run any more."""
        self.envs, self.carriers = [], []

    def run(
        self,
        policy: Policy,
        steps: int,
        stored: Sequence[NestedKey],
    ) -> TensorDictBase:
        """Steps all worlds by an exploring policy, resetting those that end.

        Args:
            policy: writes the action.
            steps: how many T.
            stored: keys to return, those that are there.

        Returns:
            A batch ``(N, T)``.

        Raises:
            RuntimeError: before ``begin``.
        """
        if not self.carriers:
            raise RuntimeError("Worlds.begin must come before Worlds.run.")
        exploring = set_exploration_type(ExplorationType.RANDOM)
        with physics_first(), exploring:
            tasks = [
                partial(self._run, group, policy, steps, stored) for group in range(len(self.envs))
            ]
            parts = in_turns(tasks)
        return parts[0] if len(parts) == 1 else torch.cat(parts)

    @torch.no_grad()
    def _run(
        self,
        group: int,
        policy: Policy,
        steps: int,
        stored: Sequence[NestedKey],
    ) -> TensorDictBase:
        env, carrier, rows = self.envs[group], self.carriers[group], []
        for _ in range(steps):
            with self.ranks.drawing(group, policy, carrier):
                acting = policy(carrier)
            data, carrier = env.step_and_maybe_reset(acting)
            rows.append(data.select(*stored, strict=False))
        self.carriers[group] = carrier
        return torch.stack(rows, 1)

    def state_dict(self) -> list[dict[str, Any]]:
        """All that the envs depend on, one entry for each."""
        return [
            {"env": env_state(env), "carrier": carrier.to_dict()}
            for env, carrier in zip(self.envs, self.carriers, strict=True)
        ]

    def load_state_dict(self, states: Sequence[dict[str, Any]]) -> list[str]:
        """Goes on from what ``state_dict`` gave, after ``begin``.

        Returns:
            What does not go on, in lines to show.

        Raises:
            ValueError: if it is of other groups.
        """
        before = [len(state["carrier"]["done"]) for state in states]
        sizes = [env.batch_size.numel() for env in self.envs]
        if before != sizes:
            raise ValueError(
                f"groups must be as they were when the run began, of {before} worlds, got {sizes}."
            )
        for group, (env, state) in enumerate(zip(self.envs, states, strict=True)):
            load_env_state(env, _whole(state))
            carrier = self.carriers[group]
            self.carriers[group] = carrier.from_dict(
                state["carrier"], batch_size=carrier.batch_size
            )
        if any("rng" in _whole(state)["base_env"] for state in states):
            return [
                "the checkpoint is of a version with one random generator for all worlds: random "
                "numbers begin anew from the seed, all else goes on."
            ]
        return []

    def redraw(self, states: Sequence[dict[str, Any]]) -> list[str]:
        """Begins anew, after ``begin``, where a run was shared among other ranks.

        What a transform names as ``lasting`` a world keeps: its level of the curriculum.

        Args:
            states: of all worlds, as ``state_dict`` gave them, in their order.

        Returns:
            What does not go on, in lines to show.
        """
        sizes = group_sizes(sum(len(state["carrier"]["done"]) for state in states), self._groups)
        begins = [sum(sizes[: piece.group]) + piece.first for piece in self.pieces]
        for env, piece, begin in zip(self.envs, self.pieces, begins, strict=True):
            for number, transform in enumerate(env.transform):
                for name in getattr(transform, "lasting", ()):
                    key = f"transforms.{number}.{name}"
                    everyone = torch.cat([_whole(state)["transform"][key] for state in states])
                    own = {name: everyone[begin : begin + piece.worlds]}
                    transform.load_state_dict(own, strict=False)
        self.carriers = [env.reset() for env in self.envs]
        return [
            "the run had another number of launch.ranks: its worlds are drawn anew, all that was "
            "learned goes on."
        ]


def _whole(state: dict[str, Any]) -> dict[str, Any]:
    """The env's state in a checkpoint, also in one from before it was one entry."""
    if "transforms" in state:
        return {"base_env": state["env"], "transform": state["transforms"]}
    return state["env"]
