"""What the tree of links says of a body: its feet, legs, hips, arms, head and trunk."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from zfall.robots.completion import STAND, bare_model
from zfall.robots.geometry import bottom_points, geoms_of

if TYPE_CHECKING:
    from zfall.robots.robot import Robot

_LEVEL = 0.02  # of the robot's size: how much higher than the other one a foot may be
_ASIDE = 0.05  # of the robot's size: what lies farther from the middle belongs to a side
_UPRIGHT = 0.7  # of the vertical part of a joint's axis, from which it turns and does not bend
SIDES = ("left", "right")
FOOT = ("left_foot", "right_foot")  # the last two regions


def parents(model: mujoco.MjModel, body: int) -> list[int]:
    """Bodies from the one below the root link down to ``body``."""
    chain: list[int] = []
    while body > 1:
        chain.append(body)
        body = int(model.body_parentid[body])
    return chain[::-1]


def subtree(model: mujoco.MjModel, body: int) -> list[int]:
    """A body and all that hang from it."""
    found = [body]
    for other in range(body + 1, model.nbody):
        if int(model.body_parentid[other]) in found:
            found.append(other)
    return found


def leg(model: mujoco.MjModel, feet: Sequence[int], foot: int) -> list[int]:
    """Links of a leg from the hip to the foot: those that are on the way to this foot alone."""
    left, right = (parents(model, each) for each in feet)
    return [body for body in parents(model, foot) if not (body in left and body in right)]


def find_feet(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[int, int]:
    """The left and the right foot: the two links that are lowest in the reference pose.

    Raises:
        ValueError: if these are not two, one on each side.
    """
    lowest: dict[int, float] = {}
    for body in range(2, model.nbody):
        for geom in geoms_of(model, [body]):
            height = bottom_points(model, data, geom, np.array([0.0, 0.0, 1.0]))[:, 2].min()
            lowest[body] = min(lowest.get(body, np.inf), float(height))
    if not lowest:
        raise ValueError("no geom of a link below the root one can meet the floor")
    ground = min(lowest.values())
    size = data.xpos[1, 2] - ground
    low = [body for body, height in lowest.items() if height < ground + _LEVEL * abs(size)]
    feet = [body for body in low if not {*parents(model, body)[:-1]} & {*low}]  # toes belong to it
    feet.sort(key=lambda body: -float(data.xipos[body, 1]))
    if len(feet) != 2 or not data.xipos[feet[0], 1] > data.xipos[feet[1], 1]:
        names = ", ".join(model.body(body).name for body in feet)
        raise ValueError(
            f"the lowest links of the reference pose are {names}, not one on each side: name the "
            "left and the right one by foot_links"
        )
    return feet[0], feet[1]


def leg_joints(model: mujoco.MjModel, feet: Sequence[int], foot: int) -> list[int]:
    """Hinges between the link from which both legs hang and one of the feet, from the top."""
    return [
        int(joint)
        for body in leg(model, feet, foot)
        for joint in range(
            model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
        )
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
    ]


def segments(
    model: mujoco.MjModel, data: mujoco.MjData, joints: Sequence[int]
) -> tuple[list[int], list[int], list[int]]:
    """Joints of a leg above its thigh, between thigh and shank, and below the shank.

    Thigh and shank are the two longest ways from one joint to the next.
    """
    places = data.xanchor[list(joints)]
    ways = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    if not len(ways):
        return list(joints), [], []
    longest = sorted(int(way) + 1 for way in np.argsort(-ways, kind="stable")[:2])
    first, last = longest[0], longest[-1] if len(longest) > 1 else len(joints)
    return list(joints[:first]), list(joints[first:last]), list(joints[last:])


def hip_joints(model: mujoco.MjModel, data: mujoco.MjData, feet: Sequence[int]) -> list[int]:
    """Joints of both hips that bend, by pitch or roll; those that turn a leg are left out."""
    hips: list[int] = []
    for foot in feet:
        above, _, _ = segments(model, data, leg_joints(model, feet, foot))
        hips += [joint for joint in above if abs(data.xaxis[joint, 2]) < _UPRIGHT]
    return list(dict.fromkeys(hips))


@cache
def hips_of(robot: "Robot") -> list[int]:
    """Positions in ``joints`` of those that bend a hip, by pitch or roll.

    Zero joints of a robot whose feet hang from one link.
    """
    model = bare_model(robot)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key(STAND).id)
    mujoco.mj_kinematics(model, data)
    feet = [
        int(model.site_bodyid[model.sensor(f"feet_position/{foot}").objid[0]])
        for foot in robot.feet
    ]
    names = [model.joint(joint).name for joint in hip_joints(model, data, feet)]
    return [number for number, joint in enumerate(robot.joints) if joint in names]


def trunk(model: mujoco.MjModel, feet: Iterable[int]) -> int:
    """The heaviest link that is in neither leg."""
    legs = {body for foot in feet for body in parents(model, foot)}
    others = [body for body in range(1, model.nbody) if body not in legs]
    return max(others, key=lambda body: float(model.body_mass[body]))


def pelvis(model: mujoco.MjModel, feet: Sequence[int]) -> int:
    """The link from which both legs hang."""
    left, right = (parents(model, foot) for foot in feet)
    shared = [body for body in left[:-1] if body in right[:-1]]
    return shared[-1] if shared else 1


def find_regions(
    model: mujoco.MjModel, data: mujoco.MjData, feet: Sequence[int]
) -> dict[str, tuple[int, ...]]:
    """Links that can meet the floor, by the part of the body; the feet are the last two.

    ``head``, ``torso``, and left and right of ``arm``, ``hand``, ``thigh`` and ``shin``. The hand
    is the last link of an arm that has three. What only one side has belongs to the torso.
    """
    found: dict[str, list[int]] = {"head": [], "torso": []}
    for limb in ("arm", "hand", "thigh", "shin", "foot"):
        found |= {f"{side}_{limb}": [] for side in SIDES}
    placed: set[int] = set()

    def put(region: str, bodies: Iterable[int]) -> None:
        found[region] += [body for body in bodies if body not in placed]
        placed.update(bodies)

    for side, foot in zip(SIDES, feet, strict=True):
        put(f"{side}_foot", subtree(model, foot))
    for side, foot in zip(SIDES, feet, strict=True):
        chain = leg(model, feet, foot)
        above, between, below = segments(model, data, leg_joints(model, feet, foot))
        knee = model.jnt_bodyid[(between or below)[0]] if between or below else foot
        thigh = model.jnt_bodyid[above[-1]] if above else knee
        for body, lower in itertools.pairwise(chain):
            own = {*subtree(model, body)} - {*subtree(model, lower)}
            region = "torso" if body < thigh else f"{side}_thigh" if body < knee else f"{side}_shin"
            put(region, sorted(own))
    size = float(np.ptp(data.xipos[1:, 2])) or 1.0
    middle = float(data.xpos[1, 1])
    weight, shoulders = model.body_subtreemass, []
    for body in range(1, model.nbody):  # parents come first
        if body in placed:
            continue
        aside = float(data.subtree_com[body, 1]) - middle
        branch = subtree(model, body)
        if body > 1 and abs(aside) > _ASIDE * size and not {*branch} & {*feet}:
            side = SIDES[0] if aside > 0 else SIDES[1]
            shoulders.append(float(data.xpos[body, 2]))
            chain = _longest(model, body)
            hand = subtree(model, chain[-1]) if len(chain) > 2 else []
            put(f"{side}_hand", hand)
            put(f"{side}_arm", [b for b in branch if b not in hand])
    for body in range(1, model.nbody):
        if body in placed:
            continue
        branch = [b for b in subtree(model, body) if b not in placed]
        alone = body > 1 and branch == subtree(model, body) and weight[body] < 0.2 * weight[1]
        neck = max(shoulders, default=float(data.subtree_com[1, 2]))
        head = alone and data.subtree_com[body, 2] > neck
        put("head" if head else "torso", branch if alone else [body])
    return _both_sides(model, found)


def _longest(model: mujoco.MjModel, body: int) -> list[int]:
    """Bodies from one to the end of its longest branch."""
    ends = (parents(model, other) for other in subtree(model, body))
    chain = max(ends, key=len)
    return chain[chain.index(body) :]


def _both_sides(
    model: mujoco.MjModel, found: Mapping[str, Sequence[int]]
) -> dict[str, tuple[int, ...]]:
    """Only bodies that can meet the floor; what one side alone has goes to the torso."""
    meets = {body for body in range(1, model.nbody) if geoms_of(model, [body])}
    solid = {name: [body for body in bodies if body in meets] for name, bodies in found.items()}
    for limb in ("arm", "hand", "thigh", "shin"):
        pair = [f"{side}_{limb}" for side in SIDES]
        if not all(solid[name] for name in pair):
            for name in pair:
                solid["torso"] += solid.pop(name)
    return {name: tuple(bodies) for name, bodies in solid.items() if bodies}
