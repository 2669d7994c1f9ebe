"""Where classes and functions went that yaml files and checkpoints name by an older path."""

import re

# Old path: new path, of a module or of one name in it. The longest that fits counts.
MOVED = {
    "zfall.envs.model.Ball": "zfall.robots.Ball",
    "zfall.envs.robots": "zfall.robots",
    "zfall.envs.simulation": "zfall.simulation.cpu",
    "zfall.envs.gaits": "zfall.motions.gaits",
    "zfall.envs.mirror.Mirror": "zfall.modules.mirror.Mirror",
    "zfall.envs.motions": "zfall.motions.library",
    "zfall.envs.rotations": "zfall.rotations",
    "zfall.envs.terms.kneel": "zfall.falling.terms",
    "zfall.envs.transforms.actions.KneelReference": "zfall.falling.kneel_reference.KneelReference",
    "zfall.envs.transforms.actions.kneel_reference": "zfall.falling.kneel_reference",
    "zfall.envs.transforms.mirroring": "zfall.falling.mirrored_falls",
    "zfall.envs.transforms.modes": "zfall.falling.modes",
    "zfall.envs.transforms.starts.FallingStart": "zfall.falling.falling_start.FallingStart",
    "zfall.modules.fall_network": "zfall.falling.fall_network",
    "zfall.modules.switched": "zfall.falling.switched",
}
_PATH = re.compile(r"\bzfall(?:\.\w+)+")


def moved(path: str) -> str | None:
    """The new path of what an older one names; ``None`` if it has not moved."""
    for old in sorted(MOVED, key=len, reverse=True):
        if path == old or path.startswith(f"{old}."):
            return MOVED[old] + path.removeprefix(old)
    return None


def with_new_paths(text: str) -> str:
    """A text, such as a stored config, with every older path replaced."""
    return _PATH.sub(lambda match: moved(match[0]) or match[0], text)
