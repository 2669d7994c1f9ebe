"""The model that pictures show: the physics model with a robot's look, a stage and a camera.

What is stepped is never touched: the look is added to a copy that only renderers compile.
"""

import mujoco
import numpy as np

from zfall.robots import DEFAULT, Robot

HIDDEN = 3  # group of the geoms that collide; MuJoCo draws 0 to 2 unless it must draw more
SUN = (0.6, -1.0, 2.4)  # from the center of mass to the light [m]
VIEW = (0.84, -0.88, 0.26)  # from the center of mass to the camera [m]
FIELD = 32.0  # that it sees, up and down [degrees]


def dress(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Adds the look of a robot to its spec, hides what collides, and lights the scene.

    A robot without a look keeps its geoms as they are.

    Args:
        spec: of the robot with all that is in its world; changed in place.
        robot: whose ``look`` names an MJCF with a body for each link that it shows.

    Raises:
        ValueError: if the look has a body that is no link of the robot.
    """
    _light(spec, robot.com_height / DEFAULT.com_height)
    if robot.look is None:
        return
    look = mujoco.MjSpec.from_file(robot.look)
    plain = spec.copy().compile()
    data = mujoco.MjData(plain)
    mujoco.mj_kinematics(plain, data)
    mujoco.mj_comPos(plain, data)
    _aim(spec, data)
    links = {body.name for body in spec.bodies} - {"world"}
    shown = [body.name for body in look.worldbody.bodies]
    if strange := sorted(set(shown) - links):
        raise ValueError(
            f"look must have bodies with the names of links alone, got {', '.join(strange)}."
        )
    for geom in spec.geoms:
        if geom.parent.name not in ("world", "ball"):
            geom.group = HIDDEN
    for name in shown:
        link = data.body(name)
        back, place = np.zeros(4), np.zeros(3)
        mujoco.mju_negPose(place, back, link.xpos, link.xquat)
        frame = spec.body(name).add_frame(pos=place, quat=back)
        frame.attach_body(look.body(name), "look/", "")


def _light(spec: mujoco.MjSpec, size: float) -> None:
    """A light that follows the robot and casts its shadow, a pale floor, and a bright sky."""
    whole, head = spec.visual.global_, spec.visual.headlight
    whole.offwidth, whole.offheight = 1920, 1080
    head.ambient, head.diffuse, head.specular = [0.42] * 3, [0.3] * 3, [0.05] * 3
    spec.visual.quality.shadowsize, spec.visual.map.shadowscale = 4096, 0.4
    spec.visual.map.zfar = 10.0  # times the extent: there the floor fades into the sky
    for sun in spec.lights:
        sun.active = False
    sun = spec.worldbody.first_body().add_light(name="look/sun", castshadow=True)
    sun.type, sun.mode = mujoco.mjtLightType.mjLIGHT_SPOT, mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
    sun.pos, sun.dir = size * np.array(SUN), -np.array(SUN)
    sun.cutoff, sun.exponent = 60.0, 2.0
    sun.diffuse, sun.specular, sun.ambient = [0.62] * 3, [0.3] * 3, [0.0] * 3
    for texture in spec.textures:
        if texture.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX:
            texture.rgb1, texture.rgb2 = [0.97, 0.975, 0.98], [0.80, 0.86, 0.92]
        else:
            texture.rgb1, texture.rgb2 = [0.90, 0.905, 0.91], [0.85, 0.857, 0.866]


def _aim(spec: mujoco.MjSpec, data: mujoco.MjData) -> None:
    """Has the camera ``track`` look at the center of mass from the front and the right."""
    camera = spec.camera("track")
    if camera is None:
        return
    root = data.body(camera.parent.name)
    back = np.array(VIEW) / np.linalg.norm(VIEW)  # the camera's z axis: it looks along -z
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    axes = np.column_stack([right, np.cross(back, right), back])
    turned, quat = root.xmat.reshape(3, 3).T, np.zeros(4)
    mujoco.mju_mat2Quat(quat, (turned @ axes).ravel())
    camera.fovy, camera.quat = FIELD, quat
    camera.pos = turned @ (root.subtree_com + VIEW - root.xpos)
