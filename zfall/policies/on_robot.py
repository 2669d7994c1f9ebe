"""All that runs on the robot's computer in a control step, as one network."""

from typing import Any

import torch
from tensordict import NestedKey
from torch import Tensor, nn
from torchrl.envs import TransformedEnv

from zfall.envs.on_robot import Known, OnRobot
from zfall.envs.transforms.observations.vector import vector_spans
from zfall.modules.deployed import deployed, memories_at_start


class RobotPolicy(nn.Module):
    """Sensors and states -> ``action``, ``command`` and the next states, of one robot.

    Inputs, in the order of ``inputs``: ``begin`` ``(1, 1)``, 1 in the first step and else 0; each
    quantity that the robot must measure ``(1, size)``; each state ``(1, ...)``. Outputs, in the
    order of ``outputs``: ``action`` ``(1, J)``; ``command`` ``(1, K, J)`` [rad], the targets of
    the K ticks of the control step; each state for the next step, as ``next_NAME``.

    Args:
        env: of the policy, as it is used.
        actor: the policy.

    Attributes:
        sensors: quantities that the robot must measure, or is given by who operates it.
        starts: states at the begin ``(1, ...)``, by name.
        spans: where each quantity lies in the observation.

    Raises:
        ValueError: if the task's software, or the policy, has no form for a robot.
    """

    def __init__(self, env: TransformedEnv, actor: Any):
        super().__init__()
        steps, self.sensors = software(env)
        self.steps = steps
        self.parts = nn.ModuleList(steps)
        self.shapes = {key: env.observation_spec[key].shape[1:] for key in self.sensors}
        vectors = [step.reads for step in steps if "observation" in step.writes]
        self.spans = vector_spans(env.observation_spec, vectors[-1])
        self.policy = deployed(actor)
        memories = memories_at_start(actor)
        self.memories = list(memories)
        kept = {name: value for step in steps for name, value in step.states.items()}
        if both := sorted(kept.keys() & memories.keys()):
            raise ValueError(f"hidden states must not be called {both[0]} to be exported.")
        self.starts: dict[str, Tensor] = kept | memories

    @property
    def inputs(self) -> dict[str, Tensor]:
        """Names of the inputs, and examples: those of a robot that is switched on."""
        sizes = {name: shape.numel() for name, shape in self.shapes.items()}
        given = {plain_name(key): torch.zeros(1, size) for key, size in sizes.items()}
        return {"begin": torch.ones(1, 1), **given, **self.starts}

    @property
    def outputs(self) -> list[str]:
        """Names of the outputs."""
        return ["action", "command", *(f"next_{name}" for name in self.starts)]

    def forward(self, begin: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
        """One control step."""
        known: Known = {"begin": begin > 0.5}
        for (key, shape), value in zip(self.shapes.items(), values, strict=False):
            known[key] = value.reshape(1, *shape)
        for name, value in zip(self.starts, values[len(self.shapes) :], strict=True):
            known["state", name] = value
        for step in self.steps:
            step.observe(known)
        memories = [known["state", name] for name in self.memories]
        out = self.policy(known["observation"], *memories)
        known["action"], *after = out if isinstance(out, tuple) else (out,)
        for name, value in zip(self.memories, after, strict=True):
            known["next", name] = value
        for step in self.steps:
            step.act(known)
        return known["action"], known["command"], *(known["next", name] for name in self.starts)


def plain_name(key: NestedKey) -> str:
    """A key as one word."""
    return key if isinstance(key, str) else "/".join(key)


def software(env: TransformedEnv) -> tuple[list[OnRobot], list[NestedKey]]:
    """What of an env's transforms a robot needs, and the quantities that it must be given.

    From the observation back: each transform that writes something needed is taken along with
    what it reads. One that declares ``hardware`` only simulates the world, and stays behind.

    Raises:
        ValueError: if something is needed that has no form for a robot.
    """
    steps: list[OnRobot] = []
    needed: dict[NestedKey, None] = {"observation": None}  # in order
    makers = 0
    for transform in reversed(list(env.transform)):
        kind, acts = type(transform).__name__, bool(transform.in_keys_inv)
        ours = getattr(transform, "on_robot", None)
        written = {_name(key) for key in transform.out_keys or ()} & needed.keys()
        if ours is not None and (acts or written):
            step = ours()
            for key in step.writes:
                needed.pop(key, None)
            needed |= dict.fromkeys(step.reads)
            steps.insert(0, step)
            makers += acts
        elif hasattr(transform, "hardware") or hasattr(transform, "replaced_in_batteries"):
            continue
        elif acts:
            raise ValueError(f"run must have no {kind} to be exported: it is not described.")
        elif written - operated(env).keys():
            raise ValueError(
                "run must observe what a robot can know to be exported, got "
                f"{plain_name(min(written, key=str))}, which {kind} writes."
            )
    if not makers or "observation" in needed:
        raise ValueError(
            "run must have targets of position or velocity, and a vector as observation, to be "
            "exported."
        )
    there = env.base_env.observation_spec.keys(True, True)
    unknown = [key for key in needed if key not in there and key not in operated(env)]
    if unknown:
        raise ValueError(
            f"run must observe what a robot can know to be exported, got {plain_name(unknown[0])}."
        )
    return steps, list(needed)


def operated(env: TransformedEnv) -> dict[NestedKey, str]:
    """Quantities that who operates the robot gives, with their units."""
    return {
        key: transform.units[key]
        for transform in env.transform
        for key in getattr(transform, "operator", ())
    }


def _name(key: NestedKey) -> NestedKey:
    """The quantity that a measured value is one of."""
    if isinstance(key, tuple) and key[0] == "measured":
        return key[1] if len(key) == 2 else key[1:]
    return key
