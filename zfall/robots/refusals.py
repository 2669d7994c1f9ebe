"""What is refused of an MJCF, and of what is declared next to it, in one line each."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from zfall.robots import anatomy
from zfall.robots.geometry import geoms_of

if TYPE_CHECKING:
    from zfall.robots.actuators import Stiffness

GRAVITY = 9.81  # [m/s2], MuJoCo's default, which the assets keep


def check_gravity(model: mujoco.MjModel) -> None:
    """Raises unless it is that of all units without dimension."""
    on = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_GRAVITY
    found = model.opt.gravity if on else np.zeros(3)
    if not np.allclose(found, [0.0, 0.0, -GRAVITY], rtol=0.0, atol=1e-6):
        there = " ".join(f"{value:g}" for value in found)
        raise ValueError(
            f"gravity must be 0 0 -{GRAVITY:g} m/s2, as all units without dimension have it, the "
            f"MJCF has {there}: leave it out of its option"
        )


def check_base(model: mujoco.MjModel) -> None:
    """Raises unless the first link alone moves freely."""
    free = np.flatnonzero(model.jnt_type == mujoco.mjtJoint.mjJNT_FREE)
    if not len(free):
        raise ValueError("the robot must have a free joint, it has none")
    if len(free) > 1 or free[0] != 0 or model.jnt_bodyid[0] != 1:
        there = ", ".join(model.body(int(model.jnt_bodyid[joint])).name for joint in free)
        raise ValueError(
            f"the first body of the world alone must have a free joint, these have: {there}"
        )


def check_joints(model: mujoco.MjModel, joints: Sequence[str]) -> None:
    """Raises unless the MJCF has them, and there are some."""
    known = [model.joint(number).name for number in range(model.njnt)]
    if unknown := [joint for joint in joints if joint not in known]:
        raise ValueError(f"joints must be of {', '.join(known)}; there is no {unknown[0]}")
    if not joints:
        raise ValueError("the robot must have actuators on hinge joints, it has none")


def check_stiffness(stiffness: "Stiffness", joints: Sequence[str]) -> None:
    """Raises unless it is positive, and by joint of joints that there are."""
    if isinstance(stiffness, Mapping):
        _check_known("stiffness", stiffness, joints)
        values = {f"stiffness.{joint}": value for joint, value in stiffness.items()}
    else:
        values = {} if stiffness is None else {"stiffness": stiffness}
    for key, value in values.items():
        if not value > 0.0:
            raise ValueError(f"{key} must be positive, got {value}: left out, it is derived")


def check_stand(model: mujoco.MjModel, stand: Mapping[str, float]) -> None:
    """Raises unless its angles lie within the ranges of their joints."""
    for joint, angle in stand.items():
        low, high = model.jnt_range[model.joint(joint).id]
        if model.jnt_limited[model.joint(joint).id] and not low <= angle <= high:
            raise ValueError(
                f"stand.{joint} must lie in its range of {low:g} to {high:g} rad, got {angle:g}: "
                "give it in radians"
            )


def check_postures(postures: Mapping[str, Iterable[str]], joints: Sequence[str]) -> None:
    """Raises unless each names joints of the robot."""
    for name, angles in postures.items():
        _check_known(f"postures.{name}", angles, joints)


def _check_known(key: str, named: Iterable[str], joints: Sequence[str]) -> None:
    if unknown := [joint for joint in named if joint not in joints]:
        raise ValueError(
            f"{key} must name joints with an actuator, got {unknown[0]}: take one of "
            f"{', '.join(joints)}"
        )


def check_feet(model: mujoco.MjModel, data: mujoco.MjData, links: Sequence[str]) -> None:
    """Raises unless ``foot_links`` are two that can meet the floor, the left one on the left.

    Args:
        model, data: the robot in its reference pose, facing along x.
        links: the left and the right one.
    """
    names = [model.body(number).name for number in range(1, model.nbody)]
    if len(links) != 2:
        raise ValueError(f"foot_links must be the left and the right link, got {len(links)} links")
    if unknown := [link for link in links if link not in names]:
        raise ValueError(f"foot_links must be of {', '.join(names)}; there is no {unknown[0]}")
    left, right = (int(model.body(link).id) for link in links)
    if left in anatomy.subtree(model, right) or right in anatomy.subtree(model, left):
        raise ValueError(
            f"foot_links must be two links of which none carries the other, got {links[0]} and "
            f"{links[1]}: name one of each leg"
        )
    for foot in (left, right):
        if not geoms_of(model, anatomy.subtree(model, foot)):
            raise ValueError(
                f"foot_links must be links that can meet the floor, {model.body(foot).name} has "
                "no geom that does: name another, or let one of its geoms collide"
            )
    if not data.xipos[left, 1] > data.xipos[right, 1]:
        raise ValueError(
            f"foot_links must be the left and then the right one, {links[0]} lies right of "
            f"{links[1]}: exchange them"
        )


def check_regions(
    model: mujoco.MjModel, feet: tuple[int, int], declared: Mapping[str, Sequence[str]]
) -> None:
    """Raises unless ``region_links`` place each link that can meet the floor, feet in the last."""
    names = [model.body(number).name for number in range(1, model.nbody)]
    for region, links in declared.items():
        if unknown := [link for link in links if link not in names]:
            raise ValueError(f"region_links.{region} must be links, there is no {unknown[0]}")
    if tuple(declared)[-2:] != anatomy.FOOT:
        raise ValueError(f"region_links must end with {' and '.join(anatomy.FOOT)}")
    placed = {link for links in declared.values() for link in links}
    solid = [name for number, name in enumerate(names, 1) if geoms_of(model, [number])]
    if missing := [name for name in solid if name not in placed]:
        raise ValueError(
            "region_links must have each link that can meet the floor, or its falls are not seen; "
            f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing: add to a region"
        )
    for region, foot in zip(anatomy.FOOT, feet, strict=True):
        own = {model.body(body).name for body in anatomy.subtree(model, foot)} & {*solid}
        if strange := own - {*declared[region]}:
            raise ValueError(
                f"region_links.{region} must have all links of the foot, it lacks "
                f"{', '.join(sorted(strange))}: add to it, or name the feet by foot_links"
            )
