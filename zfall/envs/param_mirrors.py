"""Left and right exchanged in physical parameters of links and of points on them.

Which link is on the other side, and how its axes lie, follows from the compiled model in the
standing pose: links of mirrored joints are mirrored, and those without a joint are the ones at the
mirrored place of the mirrored parent.
"""

from collections.abc import Iterable

import mujoco
import numpy as np
from numpy.typing import NDArray

from zfall.envs.humanoid import HumanoidEnv
from zfall.envs.mirror import Permutation

_FLIP = np.diag([1.0, -1.0, 1.0])
_CLOSE = 0.1  # of the height of the center of mass: how far a point may lie from the mirrored one
_TURNED = 0.05  # by how much axes may differ from those of the mirrored link


def param_mirrors(env: HumanoidEnv, names: Iterable[str]) -> dict[str, Permutation]:
    """How those of the named quantities are mirrored that are parameters of this env's links.

    Args:
        env: the base env.
        names: of quantities, ``params/link_mass`` for instance; others are passed over.

    Raises:
        ValueError: if one of them has no mirror image: a push point without one on the other side,
            or a link whose axes are not those of the mirrored one up to order and signs.
    """
    makers = {"link_mass": _link_mass, "com_offset": _com_offset, "payload": _payload}
    found = {}
    for name in names:
        group, _, key = name.partition("/")
        if group == "params" and key in makers:
            found[name] = makers[key](env, _standing(env))
    return found


def _standing(env: HumanoidEnv) -> mujoco.MjData:
    model = env.simulation.model
    data = mujoco.MjData(model)
    for joint, angle in zip(env.robot.joints, env.robot.stand_position, strict=True):
        data.qpos[model.joint(joint).qposadr[0]] = angle
    mujoco.mj_kinematics(model, data)
    return data


def _link_mass(env: HumanoidEnv, data: mujoco.MjData) -> Permutation:
    links = [env.simulation.model.body(name).id for name in env.parameters.links]
    index = [links.index(_other_side(env, data, link)) for link in links]
    return Permutation(index, [1.0] * len(index))


def _com_offset(env: HumanoidEnv, data: mujoco.MjData) -> Permutation:
    """``x' = R'^T F R x`` in the axes R and R' of a link and of the other one; F flips y."""
    index, signs = [], []
    for place, other in enumerate(_link_mass(env, data).places):
        here, there = (_axes(env, data, number) for number in (place, other))
        turn = here.T @ _FLIP @ there
        whole = turn.round()
        if abs(turn - whole).max() > _TURNED:
            raise ValueError(
                "params/com_offset must have links whose axes are mirrored up to order and signs "
                f"to be mirrored, got {env.parameters.links[place]} and "
                f"{env.parameters.links[other]}: leave it out of the observation."
            )
        for row in whole:
            axis = int(abs(row).argmax())
            index.append(3 * other + axis)
            signs.append(float(row[axis]))
    return Permutation(index, signs)


def _payload(env: HumanoidEnv, data: mujoco.MjData) -> Permutation:
    points, model = env.parameters.push_points, env.simulation.model
    close, index = _CLOSE * env.robot.com_height, []
    for name, body in points.items():
        link = _other_side(env, data, int(model.body_parentid[body]))
        image = _FLIP @ data.xpos[body]
        away = {
            other: float(np.linalg.norm(data.xpos[other] - image))
            for other in points.values()
            if model.body_parentid[other] == link
        }
        other = min(away, key=away.__getitem__, default=0)
        if not away or away[other] > close:
            raise ValueError(
                f"params/payload must have a push point on the other side of {name} to be "
                f"mirrored, got {', '.join(points)}: add one to env.base_env.push_points, or leave "
                "params/payload out of the observation."
            )
        index.append(list(points.values()).index(other))
    return Permutation(index, [1.0] * len(index))


def _axes(env: HumanoidEnv, data: mujoco.MjData, place: int) -> NDArray[np.float64]:
    axes: NDArray[np.float64] = data.body(env.parameters.links[place]).xmat.reshape(3, 3)
    return axes


def _other_side(env: HumanoidEnv, data: mujoco.MjData, link: int) -> int:
    """The body that is this one in the mirror."""
    model = env.simulation.model
    joint = model.joint(model.body_jntadr[link]).name if model.body_jntnum[link] else None
    if joint in env.robot.joints:
        return int(model.joint(env.robot.mirror[joint]).bodyid[0])
    parent = int(model.body_parentid[link])
    if parent == 0:
        return link
    side = _other_side(env, data, parent)
    names = (model.body(name).id for name in env.parameters.links)
    siblings = [i for i in names if model.body_parentid[i] == side and not model.body_jntnum[i]]
    image = _FLIP @ data.xipos[link]
    return min(siblings, key=lambda i: float(np.linalg.norm(data.xipos[i] - image)), default=link)
