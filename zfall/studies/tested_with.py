"""What the policies of a study's row may be tested with: the hook, and how yaml names it."""

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import torch
from hydra.utils import instantiate
from omegaconf import DictConfig

from zfall.policies import Policy


@runtime_checkable
class TestedWith(Protocol):
    """Other policies that act in a test together with the row's.

    A class of this shape is named in the yaml of a study, with its arguments::

        tested_with: {ROW: {_target_: my_package.MyPartner, partner: best}}
    """

    @property
    def trainings(self) -> Sequence[Sequence[str]]:
        """Overrides of ``recipes.train`` of the policies that are to be trained for it.

        Each is trained with the seed and the frames of the row's policy. Below, ``others`` are
        these in the same order.
        """

    def fingerprint(self) -> object:
        """JSON values that tell it from others of its class, with digests of the files it reads.

        Results with another fingerprint are others. What it trains need not be in it.
        """

    def check(self, row: DictConfig, others: Sequence[DictConfig], env: DictConfig) -> None:
        """Refuses what would fail in a test, before anything is trained.

        Args:
            row: config of the training of the row's policy.
            others: configs of the other trainings.
            env: config of the env in which it is tested.

        Raises:
            ValueError: naming the key, the rule and the value.
        """

    def actor(self, policy: Policy, others: Sequence[Policy]) -> torch.nn.Module:
        """The policy that the battery tests, made of the row's and the others.

        Returns:
            A module that reads ``observation`` ``(*B, D)`` and whatever else the env of a test
            has, and writes ``action`` ``(*B, J)``.
        """


def build_tested_with(table: Mapping[str, Any]) -> TestedWith:
    """From its table in the yaml.

    Raises:
        ValueError: if what it names is not of the shape of ``TestedWith``.
    """
    built = instantiate(dict(table), _convert_="all")
    if not isinstance(built, TestedWith):
        raise ValueError(
            f"_target_ must name a class with trainings, fingerprint, check and actor, "
            f"got {table['_target_']}."
        )
    return built
