"""An MJCF that was made for something else, with all that the env reads added to it.

What is added moves nothing: sensors and the sites that they need, a floor and a camera where there
is none, and the reference pose as a keyframe. Actuators become servos, see ``actuators``.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from zfall.robots.actuators import actuated_joints, make_servos
from zfall.robots.geometry import Sole
from zfall.robots.mjcf import compile_spec, follow, plain_model, read_spec

if TYPE_CHECKING:
    from zfall.robots.robot import Robot

CORNERS = ("front_left", "front_right", "rear_left", "rear_right")
STAND = "stand"  # name of the keyframe with the reference pose
_FROM, _FOUND, _FORCE, _POSITION = 3, 1, 2, 16  # of MuJoCo's contact sensors: net force; fields
_NET = 3


@dataclass(frozen=True)
class Additions:
    """What is added to an MJCF; names are those of its links and joints.

    Attributes:
        root: the root link.
        joints: those with a servo, in the order of every vector.
        angles: of the reference pose, by joint [rad].
        base: position and orientation of the root link in the reference pose ``(7,)``.
        soles: of the left and the right foot.
        toes: whether parts hang from the feet.
        regions: links by region.
        upright: least stiffness of the legs' joints [N m/rad].
        height: of the center of mass [m].
    """

    root: str
    joints: tuple[str, ...]
    angles: dict[str, float]
    base: tuple[float, ...]
    soles: tuple[Sole, Sole]
    toes: bool
    regions: dict[str, tuple[str, ...]]
    upright: dict[str, float]
    height: float


def speaks_our_names(spec: mujoco.MjSpec) -> bool:
    """Whether an MJCF was written for zfall: it has a sensor for every key then."""
    return any(sensor.name == "com_position" for sensor in spec.sensors)


def full_spec(robot: "Robot") -> mujoco.MjSpec:
    """The spec of a robot, with all that the env needs.

    Raises:
        ValueError: if it does not compile, or something cannot be added.
    """
    spec = read_spec(robot.mjcf)
    if not speaks_our_names(spec):
        complete(spec, robot, robot.additions)
    return spec


def let_feet_decide(spec: mujoco.MjSpec, robot: "Robot") -> None:
    """Gives the soles of a robot a higher priority than the floor, where they have none.

    Without it MuJoCo takes the larger friction of the two, which stays what it was, and a slippery
    foot would not slip. As it is, the robot stands and moves as before.
    """
    floor = spec.geom("floor")
    for foot in robot.feet:
        sole = spec.site(spec.sensor(f"feet_position/{foot}").objname)
        for geom in sole.parent.geoms:
            if geom.priority <= floor.priority:
                geom.friction = np.maximum(geom.friction, floor.friction)
                geom.condim = max(geom.condim, floor.condim)
                geom.priority = floor.priority + 1


def bare_model(robot: "Robot") -> mujoco.MjModel:
    """The compiled model of a robot alone.

    Raises:
        ValueError: as ``full_spec``.
    """
    return compile_spec(full_spec(robot), robot.mjcf)


def complete(spec: mujoco.MjSpec, robot: "Robot", add: Additions) -> None:
    """Adds to a spec what the env needs; see ``Additions``."""
    model = plain_model(robot.mjcf)
    make_servos(spec, model, add.joints, stiffness=robot.stiffness, upright=add.upright)
    if spec.option.integrator == mujoco.mjtIntegrator.mjINT_EULER:
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST  # servos are stiff
    spec.compiler.discardvisual = True  # of no use to the physics; pictures keep it
    _add_floor(spec)
    _add_camera(spec, add)
    _add_sensors(spec, robot.feet, add)
    _add_stand(spec, model, add)


def _add_floor(spec: mujoco.MjSpec) -> None:
    skies = (t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for t in spec.textures)
    if not any(skies):
        spec.add_texture(
            name="zfall/sky",
            type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
            rgb1=[0.93, 0.95, 0.98],
            rgb2=[0.72, 0.78, 0.86],
            width=16,
            height=96,
        )
    planes = [g for g in spec.worldbody.geoms if g.type == mujoco.mjtGeom.mjGEOM_PLANE]
    if not planes:
        spec.add_texture(
            name="zfall/tiles",
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
            rgb1=[0.82, 0.84, 0.86],
            rgb2=[0.74, 0.76, 0.79],
            width=64,
            height=64,
        )
        tiles = spec.add_material(name="zfall/tiles", texrepeat=[4, 4], texuniform=True)
        tiles.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "zfall/tiles"
        planes = [
            spec.worldbody.add_geom(
                type=mujoco.mjtGeom.mjGEOM_PLANE,
                size=[0, 0, 1],
                contype=1,
                conaffinity=1,
                friction=[1.0, 0.005, 0.0001],
                material="zfall/tiles",
            )
        ]
    if (before := planes[0].name) != "floor":
        planes[0].name = "floor"
        if before:
            follow(spec, mujoco.mjtObj.mjOBJ_GEOM, {before: "floor"})


def _add_camera(spec: mujoco.MjSpec, add: Additions) -> None:
    if spec.camera("track") is not None:
        return
    camera = spec.body(add.root).add_camera(name="track")
    camera.mode = mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    camera.pos = list(np.array([2.5, -2.7, 0.7]) * add.height)
    axes = np.array([[0.741, 0.671, 0.0], [-0.14, 0.155, 0.978]])
    right, up = axes[0] / np.linalg.norm(axes[0]), axes[1] / np.linalg.norm(axes[1])
    quaternion = np.zeros(4)
    turn = np.stack([right, np.cross(np.cross(right, up), right), np.cross(right, up)], -1)
    mujoco.mju_mat2Quat(quaternion, turn.ravel())
    camera.quat = quaternion


def _add_sensors(spec: mujoco.MjSpec, feet: Iterable[str], add: Additions) -> None:
    root, kinds, objects = spec.body(add.root), mujoco.mjtSensor, mujoco.mjtObj
    root.add_site(name="zfall/imu", size=[0.001] * 3, group=5)
    site, body = objects.mjOBJ_SITE, objects.mjOBJ_BODY

    def put(name: str, kind: mujoco.mjtSensor, what: mujoco.mjtObj, of: str) -> None:
        spec.add_sensor(name=name, type=kind, objtype=what, objname=of)

    def touch(name: str, what: mujoco.mjtObj, of: str, fields: int = _FORCE) -> None:
        spec.add_sensor(
            name=name,
            type=kinds.mjSENS_CONTACT,
            objtype=what,
            objname=of,
            reftype=objects.mjOBJ_GEOM,
            refname="floor",
            intprm=[fields, _NET, 1],
        )

    for joint in add.joints:
        put(f"joint_torque/{joint}", kinds.mjSENS_JOINTACTFRC, objects.mjOBJ_JOINT, joint)
    put("base_acceleration", kinds.mjSENS_ACCELEROMETER, site, "zfall/imu")
    put("com_position", kinds.mjSENS_SUBTREECOM, body, add.root)
    put("com_velocity", kinds.mjSENS_SUBTREELINVEL, body, add.root)
    put("angular_momentum", kinds.mjSENS_SUBTREEANGMOM, body, add.root)
    for foot, sole in zip(feet, add.soles, strict=True):
        name = f"zfall/{foot}_sole"
        link = spec.body(sole.link)
        link.add_site(name=name, pos=sole.position, quat=sole.quaternion, group=5, size=[1e-3] * 3)
        put(f"feet_position/{foot}", kinds.mjSENS_FRAMEPOS, site, name)
        put(f"feet_orientation/{foot}", kinds.mjSENS_FRAMEQUAT, site, name)
        put(f"feet_velocity/{foot}", kinds.mjSENS_FRAMELINVEL, site, name)
        whole = objects.mjOBJ_XBODY if add.toes else body  # MuJoCo's name of a subtree
        touch(f"feet_contact/{foot}", whole, sole.link, _FOUND | _FORCE | _POSITION)
        for corner, place, size in _corners(sole, add.height):
            link.add_site(
                name=f"{name}_{corner}",
                type=mujoco.mjtGeom.mjGEOM_BOX,
                pos=place,
                quat=sole.quaternion,
                size=size,
                group=5,
            )
            touch(f"feet_corner_force/{foot}/{corner}", site, f"{name}_{corner}")
    for region, links in add.regions.items():
        for link_name in links:
            touch(f"contact_force_peak/{region}/{link_name}", body, link_name)


def _corners(sole: Sole, height: float) -> list[tuple[str, list[float], list[float]]]:
    """A box around each quarter of a sole: name, center in the link's frame, half sizes [m]."""
    edge = 0.02 * height  # beyond the sole, up and down too
    half = np.array([(sole.half_size[0] + edge) / 2, (sole.half_size[1] + edge) / 2])
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, sole.quaternion)
    found = []
    for corner in CORNERS:
        signs = [1 if "front" in corner else -1, 1 if "left" in corner else -1]
        local = turn.reshape(3, 3) @ np.array([*(signs * half), 0.0])
        found.append((corner, list(sole.position + local), [*half, edge]))
    return found


def _add_stand(spec: mujoco.MjSpec, model: mujoco.MjModel, add: Additions) -> None:
    """The reference pose as the only keyframe, ``stand``."""
    qpos = model.qpos0.copy()
    qpos[:7] = add.base
    for joint, angle in add.angles.items():
        qpos[model.joint(joint).qposadr[0]] = angle
    control = [add.angles.get(joint, 0.0) for joint in actuated_joints(model)]
    for key in list(spec.keys):
        spec.delete(key)
    spec.add_key(name=STAND, qpos=qpos, ctrl=control)
