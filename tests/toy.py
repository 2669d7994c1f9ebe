"""A two-legged toy of six joints and no arms, as a bare MJCF: nothing in it was made for zfall."""

from pathlib import Path

MASS, HALF_FOOT = 2.5, (0.06, 0.03)  # [kg, m]
HINGES = ("hip", "knee", "ankle")
MOTORS = '<motor name="{name}_motor" joint="{name}" gear="2" ctrlrange="-5 5" ctrllimited="true"/>'
FOOT = '<geom type="box" size="0.06 0.03 0.01" pos="0.02 0 -0.02" mass="0.1"/>'
FREE = "<freejoint/>"


def toy_mjcf(
    folder: Path,
    *,
    actuator: str = MOTORS,
    foot: str = FOOT,
    free: str = FREE,
    right: float = 1.0,
    more: str = "",
    key: str = "",
) -> Path:
    """Writes the MJCF into ``folder``.

    Args:
        folder: to write into.
        actuator: of each joint, with its ``{name}``.
        foot: what hangs from an ankle, with its ``{side}``.
        free: the joint of the root link.
        right: factor on the length of the right thigh.
        more: elements after the world.
        key: attributes of a keyframe ``home``.
    """
    legs = ""
    for side, sign, long in (("left", 1, 1.0), ("right", -1, right)):
        legs += f"""
        <body name="{side}_thigh" pos="0 {0.06 * sign} -0.03">
          <joint name="{side}_hip" axis="0 {sign} 0" range="-1.5 1.5"/>
          <geom type="capsule" fromto="0 0 -0.02 0 0 {-0.11 * long}" size="0.02" mass="0.3"/>
          <body name="{side}_shank" pos="0 0 {-0.13 * long}">
            <joint name="{side}_knee" axis="0 {sign} 0" range="-1.5 1.5"/>
            <geom type="capsule" fromto="0 0 -0.02 0 0 -0.1" size="0.018" mass="0.2"/>
            <body name="{side}_sole" pos="0 0 -0.13">
              <joint name="{side}_ankle" axis="0 {sign} 0" range="-1 1"/>
              {foot.format(side=side)}
            </body>
          </body>
        </body>"""
    names = [f"{side}_{hinge}" for side in ("left", "right") for hinge in HINGES]
    keyframe = f'<keyframe><key name="home" {key}/></keyframe>' if key else ""
    text = f"""
    <mujoco>
      <compiler autolimits="true" angle="radian"/>
      <default><joint armature="0.005" damping="0.05"/></default>
      <worldbody>
        <body name="trunk" pos="0 0 0.4">
          {free}
          <geom type="box" size="0.05 0.07 0.06" pos="0 0 0.03" mass="1.3"/>
          {legs}
        </body>
      </worldbody>
      <actuator>{"".join(actuator.format(name=name) for name in names)}</actuator>
      {more}{keyframe}
    </mujoco>"""
    path = folder / "toy.xml"
    path.write_text(text)
    return path
