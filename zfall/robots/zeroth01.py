"""The Zeroth-01: 20 servos, 3.3 kg, 0.4 m."""

from pathlib import Path

from zfall.robots.points import PushPoint
from zfall.robots.robot import Robot

_ASSETS = Path(__file__).parent / "assets"

_LEG = ("hip_yaw", "hip_roll", "hip_pitch", "knee_pitch", "ankle_pitch", "ankle_roll")
_ARM = ("shoulder_pitch", "shoulder_roll", "elbow_roll", "gripper_roll")
_JOINTS = tuple(
    f"{side}_{joint}"
    for side, joints in (("right", _LEG), ("left", _LEG), ("left", _ARM), ("right", _ARM))
    for joint in joints
)
_LIMBS = ("arm", "hand", "thigh", "knee", "shin", "foot")


def _other_side(joint: str) -> str:
    side, part = joint.split("_", 1)
    return f"{'left' if side == 'right' else 'right'}_{part}"


_KEEPS_SIGN = ("hip_pitch", "knee_pitch", "ankle_pitch")
_HEIGHT = 0.220  # of the center of mass [m]

# Atalante has walked at 0.15 m/s with its wearers (Gurriet et al. 2018), 0.07 m/s for this robot.
_WALK = {
    "step_time": 0.3,
    "double_support": 0.03,
    "half_width": 0.055,
    "lift": 0.012,
    "com_height": _HEIGHT,
}
_GAITS = {
    **{f"forward_{v:.2f}": {"speed": v, **_WALK} for v in (0.05, 0.10, 0.15, 0.20)},
    **{f"backward_{v:.2f}": {"speed": -v, **_WALK} for v in (0.05, 0.10)},
    **{f"turn_left_{r:.1f}": {"turn_rate": r, **_WALK} for r in (0.5, 1.0)},
    **{f"turn_right_{r:.1f}": {"turn_rate": -r, **_WALK} for r in (0.5, 1.0)},
}

ZEROTH01 = Robot(
    name="zeroth01",
    mjcf=str(_ASSETS / "zeroth01.xml"),
    look=str(_ASSETS / "zeroth01_look.xml"),
    joints=_JOINTS,
    stand={
        "right_hip_roll": -0.1,
        "right_hip_pitch": -0.4,
        "right_knee_pitch": -0.8,
        "right_ankle_pitch": -0.4,
        "right_ankle_roll": -0.1,
        "left_hip_roll": 0.1,
        "left_hip_pitch": -0.4,
        "left_knee_pitch": -0.8,
        "left_ankle_pitch": -0.4,
        "left_ankle_roll": 0.1,
        "left_shoulder_roll": 0.2,
        "left_elbow_roll": -0.2,
        "right_shoulder_roll": -0.2,
        "right_elbow_roll": 0.2,
    },
    postures={
        "kneel": {  # rests on the right knee, torso upright; keyframe of the MJCF
            "right_hip_roll": -0.014,
            "right_hip_pitch": 0.49,
            "right_knee_pitch": -1.33,
            "right_ankle_pitch": -0.458,
            "left_hip_roll": 0.014,
            "left_hip_pitch": -1.561,
            "left_knee_pitch": -0.433,
            "left_ankle_pitch": 0.275,
            "left_shoulder_roll": 0.2,
            "left_elbow_roll": -0.2,
            "right_shoulder_roll": -0.2,
            "right_elbow_roll": 0.2,
        },
    },
    feet=("left", "right"),
    corners=("front_left", "front_right", "rear_left", "rear_right"),
    sole_half_size=(0.051723, 0.037),
    regions=("head", "torso", *(f"{side}_{limb}" for limb in _LIMBS for side in ("left", "right"))),
    push_points={
        "torso": PushPoint(body="Top_Brace"),
        "pelvis": PushPoint(body="floating_base_link", offset=(0.0, 0.0, -0.089)),
        "chest": PushPoint(body="floating_base_link", offset=(0.0, 0.0, 0.026)),
        "elbow": PushPoint(body="R_ARM_MIRROR_1", offset=None),  # its frame is the left elbow
    },
    mirror={joint: _other_side(joint) for joint in _JOINTS},
    mirror_keeps_sign=_KEEPS_SIGN,
    com_height=_HEIGHT,
    mass=3.3494,
    legs=tuple(f"{side}_{joint}" for side in ("right", "left") for joint in _LEG),
    gaits=_GAITS,
)
