"""Whether the state of a base env fits another one."""

from collections.abc import Mapping
from typing import Any

from zfall.envs.streams import Streams
from zfall.simulation.cpu import Simulation
from zfall.simulation.model import identity_of


def made_for(env: Any) -> dict[str, Any]:
    """What a base env is made for, and its state with it."""
    return {
        "num_envs": env.num_envs,
        "robot": identity_of(env.robot),
        "control_dt": env.control_dt,
        "physics_dt": env.physics_dt,
        "servo_dynamics": env.servo_dynamics is not None,
    }


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
    made_for = {"servo_dynamics": False} | state.get("made_for", {})
    for key, value in here.items():
        if made_for.get(key, value) != value:
            raise ValueError(
                f"an env's state must be of the same {key}, {value}, got {made_for[key]}."
            )
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
