"""Baselines that kneel by script."""

from omegaconf import DictConfig, OmegaConf

from zfall.falling.switched import without_exploration
from zfall.values import NotNegativeOrInfinite


class Scripted:
    """Kneels by itself when the mode machine says so: the movements of ``KneelReference`` alone.

    Args:
        moving: speed of the center of mass from which on a movement found for such falls is
            chosen; infinite: never, all joints go to the pose ``kneel``. ``None``: that of the
            env's table [m/s].
    """

    servos = True

    def __init__(self, *, moving: NotNegativeOrInfinite | None = None):
        self.moving = moving

    def fits(self, env_cfg: DictConfig) -> bool:
        """In envs with a kneel reference."""
        return env_cfg.transforms.get("kneel_reference") is not None

    def world(self, env_cfg: DictConfig) -> DictConfig:
        """With modes to which rest is rest, not what exploration leaves of it.

        Raises:
            ValueError: if the env has no modes.
        """
        if not self.fits(env_cfg):
            raise ValueError("env must have modes for a scripted baseline: env=push_to_kneel.")
        new = without_exploration(env_cfg)
        if self.moving is not None:
            OmegaConf.update(new, "transforms.kneel_reference.moving", self.moving, force_add=True)
        return new
