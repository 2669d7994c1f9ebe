"""Whether the state of a base env fits another one."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from zfall.envs.streams import Streams
from zfall.simulation.cpu import Simulation
from zfall.simulation.model import identity_of

_OF_MJCF = "the actuators of the MJCF"
_SOFT = "that of the MJCF"


def made_for(env: Any) -> dict[str, Any]:
    """What a base env is made for, and its state with it."""
    servos = env.servos or {}
    return {
        "num_envs": env.num_envs,
        "robot": identity_of(env.robot),
        "control_dt": env.control_dt,
        "physics_dt": env.physics_dt,
        "servo_dynamics": env.servo_dynamics is not None,
        "servos": {joint: asdict(servo) for joint, servo in servos.items()} or _OF_MJCF,
        "contact": asdict(env.contact) if env.contact else _SOFT,
    }


def _difference(here: Any, there: Any, place: str = "") -> tuple[str, Any, Any] | None:
    """The key of the first value that differs, the value here and the one there.

    What an older version did not write down counts as the same.
    """
    if not (isinstance(here, Mapping) and isinstance(there, Mapping)):
        return None if here == there else (place, _shown(here), _shown(there))
    for key, value in here.items():
        found = _difference(value, there.get(key, value), f"{place}.{key}" if place else key)
        if found:
            return found
    return None


def _shown(value: Any) -> Any:
    """A table of servos by their names; all else as it is."""
    servos = value.values() if isinstance(value, Mapping) else ()
    names = sorted({str(each.get("name")) for each in servos if isinstance(each, Mapping)})
    return " and ".join(names) or value


def check_made_for(
    state: Mapping[str, Any], here: Mapping[str, Any], sim: Simulation, streams: Streams
) -> None:
    """Refuses the state of another env.

    Args:
        state: of a base env, from before ``made_for`` was in it, perhaps.
        here: what this env is made for.
        sim: of this env.
        streams: of this env.

    Raises:
        ValueError: naming the first difference.
    """
    drawn_by = {"streams", "rng"} & state.keys()  # rng: one generator for all worlds, of old
    if not {"simulation", "parameters"} <= state.keys() or not drawn_by:
        raise ValueError(
            "an env's state must be what env.state_dict() gives, "
            f"got {', '.join(map(str, state)) or 'nothing'}."
        )
    made_for = {"servo_dynamics": False, "contact": _SOFT} | state.get("made_for", {})
    if found := _difference(here, made_for):
        key, value, given = found
        raise ValueError(f"an env's state must be of the same {key}, {value}, got {given}.")
    for key, value in sim.state_dict().items():
        given = state["simulation"].get(key)
        if given is None:
            raise ValueError(f"an env's state must have simulation.{key}, got none.")
        if given.shape != value.shape:
            raise ValueError(
                "an env's state must be of as many worlds and of the same robot, ball and push "
                f"points, {key} {tuple(value.shape)}, got {tuple(given.shape)}."
            )
    if "streams" in state:
        streams.check_state(state["streams"])
