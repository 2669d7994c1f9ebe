"""What a study tests a policy with: another one, between which the mode machine switches."""

from collections.abc import Sequence
from typing import Any

import torch
from omegaconf import DictConfig, OmegaConf

from zfall import checkpoint
from zfall.envs.tables import check_same_interface
from zfall.falling.files import MOVEMENTS
from zfall.falling.switched import SCRIPT, SwitchedActor, begins_kneeling, still_actor
from zfall.fingerprints import file_digest
from zfall.policies import Policy, load_policy
from zfall.policies.load import checkpoint_of


class SwitchedWith:
    """Tests a row's policy together with the policy of the other modes.

    In the yaml of a study::

        tested_with: {ROW: {_target_: zfall.falling.switched_with.SwitchedWith, recover: best}}

    Each of the two is the name of a policy that ships, a run folder, or a list of overrides of
    ``recipes.train``, which is trained with the seed and the frames of the row. Exactly one is
    given; the row's policy acts in the other modes.

    Args:
        recover: the policy of mode RECOVER.
        kneel: the policy of modes KNEEL and STABLE; ``script`` leaves them to the recorded
            movements.

    Raises:
        ValueError: if it is not exactly one of the two, or there is no such policy.
    """

    def __init__(
        self,
        *,
        recover: str | Sequence[str] | None = None,
        kneel: str | Sequence[str] | None = None,
    ):
        given = {"recover": recover, "kneel": kneel}
        named = {mode: other for mode, other in given.items() if other is not None}
        if len(named) != 1:
            raise ValueError(f"it must have one of recover and kneel, got {named or 'neither'}.")
        ((self.mode, self.other),) = named.items()
        if self.mode == "recover" and self.other == SCRIPT:
            raise ValueError("recover must be a policy: only kneel has a script.")
        if isinstance(self.other, str):
            if self.other != SCRIPT:
                checkpoint_of(self.other, key=self.mode, others=[SCRIPT] * (self.mode == "kneel"))
        elif not isinstance(self.other, Sequence) or not self.other:
            raise ValueError(
                f"{self.mode} must be a name or a list of overrides, got {self.other}."
            )

    @property
    def trainings(self) -> list[Sequence[str]]:
        """Overrides of the other policy, if it is to be trained."""
        return [] if isinstance(self.other, str) else [self.other]

    def fingerprint(self) -> list[str]:
        """The mode, and the name and content of a policy or of the movements."""
        if not isinstance(self.other, str):
            return [self.mode]
        path = MOVEMENTS if self.other == SCRIPT else checkpoint_of(self.other)
        return [self.mode, self.other, file_digest(path)]

    def check(self, row: DictConfig, others: Sequence[DictConfig], env: DictConfig) -> None:
        """Refuses an env that does not switch, and policies that do not see or do the same.

        Raises:
            ValueError: naming what differs.
        """
        initial = OmegaConf.select(env, "transforms.mode.initial")
        if initial != "recover":
            raise ValueError(
                "env.transforms.mode.initial must be recover, in a world with a mode machine, for "
                f"policies to be switched, got {initial}."
            )
        if self.other == SCRIPT:
            return
        other: Any = others[0] if others else None
        if other is None:
            other = OmegaConf.create(checkpoint.load(checkpoint_of(str(self.other)))["config"])
        check_same_interface({"the row": row, self.mode: other})

    def actor(self, policy: Policy, others: Sequence[Policy]) -> torch.nn.Module:
        """Both policies, each in its modes.

        The memory of one that was trained in episodes that begin in KNEEL begins when it takes
        over.
        """
        if self.other == SCRIPT:
            env = policy.env()
            return SwitchedActor(policy.actor, still_actor(env.observation_spec, env.action_spec))
        other = others[0] if others else load_policy(str(self.other))
        recover, kneel = (policy, other) if self.mode == "kneel" else (other, policy)
        begins = begins_kneeling(kneel.config.env)
        return SwitchedActor(recover.actor, kneel.actor, begins=begins)
