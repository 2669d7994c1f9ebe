"""Worlds that begin in states of a bank, in hardware of choice."""

from hydra.utils import instantiate
from tensordict import TensorDict
from torch import Tensor
from torchrl.envs import TransformedEnv

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.make import make_env
from zfall.envs.transforms.starts import ScriptedStart
from zfall.falling.pushed import world_of


class BankWorlds:
    """Worlds without a policy, whose targets are given step by step.

    Attributes:
        base: the base env.
        env: it, in its hardware.

    Args:
        count: number of worlds.
        world: battery whose hardware is met, ``twin``, in each episode in another draw; ``None``:
            the published servos, and no delays.
        control_dt: time between two targets [s].
    """

    def __init__(self, count: int, world: str | None = None, *, control_dt: float = 0.04):
        hardware = world_of(world) or {}
        self.base: HumanoidEnv = instantiate(
            {"_target_": "zfall.envs.humanoid.HumanoidEnv", **hardware.get("base_env", {})},
            num_envs=count,
            control_dt=control_dt,
            physics_dt=0.004,
            _convert_="all",
        )
        self._start = ScriptedStart(self.base, states={})
        table = {**hardware.get("commands", {}), **hardware.get("physics", {})}
        self.env: TransformedEnv = make_env(self.base, {**table, "start": self._start})

    def begin(self, bank: dict[str, Tensor], rows: Tensor) -> TensorDict:
        """Resets every world into its row of a bank ``(N,)``; late commands are of its target."""
        self._start.states = {key: value[rows] for key, value in bank.items()}
        out: TensorDict = self.env.reset()
        return out
