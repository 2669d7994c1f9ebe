"""Left and right exchanged in named quantities.

The general quantities are known here. A transform that writes others declares how they mirror:
``mirror_signs`` or ``mirror_like``, see ``mirrors_of``.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor
from torchrl.envs import Transform

from zfall.envs.transforms.commands import ENTRIES
from zfall.modules.mirror import Mirror
from zfall.robots import Robot

# Signs under a reflection at the robot's plane of symmetry, whose normal is y.
_POLAR, _AXIAL, _QUATERNION = (1.0, -1.0, 1.0), (-1.0, 1.0, -1.0), (1.0, -1.0, 1.0, -1.0)
_SIGNS: dict[str, tuple[float, ...]] = {
    **dict.fromkeys(("base_position", "com_position", "projected_gravity", "push/force"), _POLAR),
    **dict.fromkeys(("base_linear_velocity", "com_velocity", "linear_momentum"), _POLAR),
    "base_acceleration": _POLAR,
    **dict.fromkeys(("base_angular_velocity", "angular_momentum"), _AXIAL),
    **dict.fromkeys(("base_orientation", "imu_orientation"), _QUATERNION),
    **dict.fromkeys(("tilt", "roll_pitch"), (-1.0, 1.0)),
    **dict.fromkeys(
        ("base_height", "base_acceleration_peak", "joint_torque_peak"),
        (1.0,),
    ),
    **dict.fromkeys(("battery_voltage", "supply_voltage", "params/supply_resistance"), (1.0,)),
    **dict.fromkeys(
        ("params/foot_friction", "params/floor_friction", "params/battery_voltage"), (1.0,)
    ),
    "step_count": (1.0,),
    "params/slope": (1.0, -1.0),
    "command": tuple(-1.0 if name in ("vy", "yaw", "roll") else 1.0 for name in ENTRIES),
}
# Of a foot; left and right change places besides.
_FOOT_SIGNS: dict[str, tuple[float, ...]] = {
    **dict.fromkeys(("feet_position", "feet_velocity", "feet_force", "feet_in_base"), _POLAR),
    **dict.fromkeys(("feet_contact", "feet_load", "feet_air_time"), (1.0,)),
    "feet_orientation": _QUATERNION,
    "feet_cop": (1.0, -1.0),
}
_JOINTS = (
    *("joint_position", "joint_velocity", "joint_torque", "target", "action", "last_action"),
    "params/joint_zero_offset",
)
_OF_JOINTS = (  # not negative: the other joint's, whatever the signs of their angles
    *("params/joint_friction_loss", "params/joint_damping", "params/joint_armature"),
    *("params/servo_stiffness", "params/servo_torque_limit", "params/load_friction"),
    "servo_temperature",
)
_OF_REGIONS = ("contact_force_peak", "contact_impulse")
_WITHIN_RANGE = ("joint_position", "target")  # left and right need not have the same ranges


class Permutation(NamedTuple):
    """Of each component of a quantity, where its image comes from, and the sign."""

    places: Sequence[int]
    signs: Sequence[float]


Declared = Mapping[str, tuple[float, ...] | Permutation | str]  # of ``mirrors_of``


def mirrors_of(transforms: Iterable[Transform]) -> dict[str, tuple[float, ...] | Permutation | str]:
    """What transforms declare of how the quantities that they write are mirrored.

    The hook for a transform with quantities of its own kind; it has, on its class or itself,

    - ``mirror_signs``: by key, the factor on each component under a reflection at the plane of
      symmetry, whose normal is y: ``{"wind": (1.0, -1.0, 1.0)}`` for a vector; a ``Permutation``
      if components also change places; or
    - ``mirror_like``: by key, another quantity with the same components that mirrors in the same
      way: ``{"contact_force_max": "contact_force_peak"}``.

    Args:
        transforms: of a task, ``env.transform``.

    Returns:
        By key, the signs, or the name of the other quantity.
    """
    declared: dict[str, tuple[float, ...] | Permutation | str] = {}
    for transform in transforms:
        declared |= getattr(transform, "mirror_signs", {})
        declared |= getattr(transform, "mirror_like", {})
    return declared


def mirror_vector(
    robot: Robot,
    spans: Mapping[str, slice],
    joint_range: Tensor,
    affine: Mapping[str, tuple[float | Tensor, float | Tensor]] | None = None,
    declared: Declared | None = None,
) -> Mirror:
    """Mirror of a vector of named quantities.

    Angles that the joint on the other side cannot take are clamped to its range: no robot is
    quite symmetric.

    Args:
        robot: whose sides are exchanged.
        spans: where each quantity lies in the vector, by name; a nested key as ``outer/inner``.
        joint_range: of the joints ``(J, 2)`` [rad].
        affine: of quantities that stand there as ``factor * x + summand``, by name, both.
        declared: what the transforms of the task declare, ``mirrors_of(env.transform)``.

    Raises:
        ValueError: on a quantity whose mirror image is not known.
    """
    size = max(span.stop for span in spans.values())
    index, sign = torch.arange(size), torch.ones(size)
    factor, summand = torch.ones(size), torch.zeros(size)
    low, high = torch.full((size,), -torch.inf), torch.full((size,), torch.inf)
    for name, span in spans.items():
        places, signs = mirror_quantity(robot, name, declared)
        if span.stop - span.start != len(places):
            raise ValueError(
                f"keys must name whole quantities to be mirrored, {name} has {len(places)} "
                f"components, got {span.stop - span.start}."
            )
        index[span] = span.start + torch.tensor(list(places))
        sign[span] = torch.tensor(list(signs))
        if name in _WITHIN_RANGE:
            low[span], high[span] = joint_range.unbind(-1)
        if affine and name in affine:
            factor[span], summand[span] = affine[name]
    # What the bounds are in the vector, and in it the image of x = (v - summand) / factor.
    bounds = torch.stack([factor * low + summand, factor * high + summand])
    scale = sign * factor / factor[index]
    shift = summand - scale * summand[index]
    return Mirror(index, scale, shift, bounds.amin(0), bounds.amax(0))


def mirror_quantity(robot: Robot, name: str, declared: Declared | None = None) -> Permutation:
    """Of each component of a quantity, where its image comes from, and the sign.

    Args:
        robot: whose sides are exchanged.
        name: of the quantity; a nested key as ``outer/inner``.
        declared: what the transforms of the task declare, ``mirrors_of(env.transform)``.

    Raises:
        ValueError: on a quantity whose mirror image is not known.
    """
    known = {} if declared is None else declared
    if name in known:
        own = known[name]
        if isinstance(own, str):
            return mirror_quantity(robot, own, {k: v for k, v in known.items() if k != name})
        return own if isinstance(own, Permutation) else Permutation(range(len(own)), own)
    if name in _SIGNS:
        return Permutation(range(len(_SIGNS[name])), _SIGNS[name])
    if name in _FOOT_SIGNS:
        return _swapped(range(len(_FOOT_SIGNS[name])), _FOOT_SIGNS[name])
    special: dict[str, Callable[[], Permutation]] = {
        **dict.fromkeys(_JOINTS, lambda: Permutation(robot.mirror_index, robot.mirror_sign)),
        **dict.fromkeys(
            _OF_JOINTS, lambda: Permutation(robot.mirror_index, [1.0] * len(robot.joints))
        ),
        "feet_corner_force": lambda: _corners(robot),
        **dict.fromkeys(_OF_REGIONS, lambda: _regions(robot)),
    }
    if name not in special:
        names = ", ".join((*_SIGNS, *_FOOT_SIGNS, *special, *known))
        raise ValueError(
            f"a mirrored quantity must be one of {names}; got {name}. A transform that writes "
            "another one declares its mirror_signs, or mirror_like; without it, symmetry=none."
        )
    return special[name]()


def mirror_action(robot: Robot, size: int) -> Mirror:
    """Mirror of an action ``(*B, size)`` of all joints, or of those of the legs.

    Raises:
        ValueError: on another size.
    """
    for group in (
        tuple(range(len(robot.joints))),
        tuple(robot.joints.index(j) for j in robot.legs),
    ):
        if len(group) == size:
            index = torch.tensor([group.index(robot.mirror_index[joint]) for joint in group])
            return Mirror(index, torch.tensor([robot.mirror_sign[joint] for joint in group]))
    raise ValueError(
        f"a mirrored action must have {len(robot.joints)} joints, or the {len(robot.legs)} of the "
        f"legs; got {size}."
    )


def _swapped(within: Sequence[int], signs: Sequence[float]) -> Permutation:
    """Two feet that change places, their components permuted ``within`` each."""
    return Permutation([*(len(within) + i for i in within), *within], [*signs, *signs])


def _corners(robot: Robot) -> Permutation:
    other = [robot.corners.index(_other_side(corner)) for corner in robot.corners]
    return _swapped(other, [1.0] * len(other))


def _regions(robot: Robot) -> Permutation:
    index = [robot.regions.index(_other_side(region)) for region in robot.regions]
    return Permutation(index, [1.0] * len(index))


def _other_side(name: str) -> str:
    """The name with left and right exchanged."""
    words = {"left": "right", "right": "left"}
    return "_".join(words.get(word, word) for word in name.split("_"))
