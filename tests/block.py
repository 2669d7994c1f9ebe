"""A rigid block as a robot: known mass, known inertia, known tipping point."""

from pathlib import Path

from zfall.robots import PushPoint, Robot

MASS, HALF_WIDTH, HALF_HEIGHT = 2.0, 0.05, 0.15  # [kg, m, m]; as deep as wide
SIDES = ("left", "right")
CORNERS = ("front_left", "front_right", "rear_left", "rear_right")


def inertia() -> tuple[float, float, float]:
    """Moments of inertia about the center [kg m2], ``m (a^2 + b^2) / 3`` with half sides a, b."""
    tall = MASS / 3 * (HALF_WIDTH**2 + HALF_HEIGHT**2)
    return tall, tall, MASS / 3 * 2 * HALF_WIDTH**2


def block_robot(folder: Path) -> Robot:
    """Writes the MJCF into ``folder``; its one joint turns a wheel without mass to speak of."""
    half = 0.5 * HALF_WIDTH
    feet, sites, sensors = [], [], []
    for side, sign in zip(SIDES, (1, -1), strict=True):
        y = sign * half
        feet.append(
            f'<geom name="{side}_foot" class="solid" priority="1" type="box" '
            f'size="{HALF_WIDTH} {half} 0.01" pos="0 {y} {0.01 - HALF_HEIGHT}"/>'
        )
        sites.append(f'<site name="{side}_sole" pos="0 {y} {-HALF_HEIGHT}"/>')
        for key, kind in (("position", "pos"), ("orientation", "quat"), ("velocity", "linvel")):
            sensors.append(
                f'<frame{kind} name="feet_{key}/{side}" objtype="site" objname="{side}_sole"/>'
            )
        touch = f'geom1="{side}_foot" geom2="floor" reduce="netforce"'
        sensors.append(f'<contact name="feet_contact/{side}" {touch} data="found force pos"/>')
        sensors.append(f'<contact name="contact_force_peak/{side}_foot" {touch} data="force"/>')
        for corner in CORNERS:
            x = half if corner.startswith("front") else -half
            shift = 0.5 * half if corner.endswith("left") else -0.5 * half
            name = f"{side}_{corner}"
            sites.append(
                f'<site name="{name}" type="box" pos="{x} {y + shift} {-HALF_HEIGHT}" '
                f'size="{half} {0.5 * half} 0.01"/>'
            )
            sensors.append(
                f'<contact name="feet_corner_force/{side}/{corner}" site="{name}" geom2="floor" '
                f'reduce="netforce" data="force"/>'
            )
    moments = " ".join(str(value) for value in inertia())
    text = f"""
    <mujoco>
      <option cone="pyramidal" integrator="implicitfast"/>
      <default><default class="solid"><geom contype="0" conaffinity="1"/></default></default>
      <worldbody>
        <geom name="floor" type="plane" size="0 0 1" contype="1" conaffinity="0"/>
        <body name="block" pos="0 0 {HALF_HEIGHT}">
          <freejoint name="floating_base"/>
          <inertial pos="0 0 0" mass="{MASS}" diaginertia="{moments}"/>
          <geom name="top" class="solid" type="box" size="{HALF_WIDTH} {HALF_WIDTH} 0.139" pos="0 0 0.011"/>
          {"".join(feet)}{"".join(sites)}<site name="imu"/>
          <body name="wheel">
            <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>
            <joint name="wheel" axis="0 0 1" armature="1e-6" damping="1e-3" limited="true" range="-1 1"/>
          </body>
        </body>
      </worldbody>
      <actuator><position name="wheel" joint="wheel" kp="1e-3"/></actuator>
      <sensor>
        <jointactuatorfrc name="joint_torque/wheel" joint="wheel"/>
        <accelerometer name="base_acceleration" site="imu"/>
        <subtreecom name="com_position" body="block"/>
        <subtreelinvel name="com_velocity" body="block"/>
        <subtreeangmom name="angular_momentum" body="block"/>
        <contact name="contact_force_peak/top" geom1="top" geom2="floor" reduce="netforce" data="force"/>
        {"".join(sensors)}
      </sensor>
      <keyframe><key name="stand" qpos="0 0 {HALF_HEIGHT} 1 0 0 0 0"/></keyframe>
    </mujoco>"""
    path = folder / "block.xml"
    path.write_text(text)
    return Robot(
        name="block",
        mjcf=str(path),
        joints=("wheel",),
        stand={},
        feet=SIDES,
        corners=CORNERS,
        sole_half_size=(HALF_WIDTH, 0.5 * HALF_WIDTH),
        regions=("top", "left_foot", "right_foot"),
        push_points={
            "torso": PushPoint(body="block"),
            "corner": PushPoint(body="block", offset=(0.04, 0.03, 0.1)),
        },
        mirror={"wheel": "wheel"},
        mirror_keeps_sign=(),
        com_height=HALF_HEIGHT,
        mass=MASS,
    )


def bare_block(folder: Path) -> Path:
    """The same block as an MJCF without a sensor, its feet two links that do not move."""
    feet = "".join(
        f'<body name="{side}_foot" pos="0 {sign * HALF_WIDTH / 2} {0.01 - HALF_HEIGHT}">'
        f'<inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>'
        f'<geom type="box" size="{HALF_WIDTH} {HALF_WIDTH / 2} 0.01" priority="1"/></body>'
        for side, sign in zip(SIDES, (1, -1), strict=True)
    )
    moments = " ".join(str(value) for value in inertia())
    path = folder / "bare_block.xml"
    path.write_text(f"""
    <mujoco>
      <option cone="pyramidal" integrator="implicitfast"/>
      <worldbody>
        <geom name="ground" type="plane" size="0 0 1"/>
        <body name="block" pos="0 0 {HALF_HEIGHT}">
          <freejoint/>
          <inertial pos="0 0 0" mass="{MASS}" diaginertia="{moments}"/>
          <geom type="box" size="{HALF_WIDTH} {HALF_WIDTH} 0.139" pos="0 0 0.011"
            contype="0" conaffinity="1"/>
          {feet}
          <body name="wheel">
            <inertial pos="0 0 0" mass="1e-9" diaginertia="1e-12 1e-12 1e-12"/>
            <joint name="wheel" axis="0 0 1" armature="1e-6" damping="1e-3" limited="true"
              range="-1 1"/>
          </body>
        </body>
      </worldbody>
      <actuator><position joint="wheel" kp="1e-3" forcerange="-1 1"/></actuator>
    </mujoco>""")
    return path
