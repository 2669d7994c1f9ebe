"""What is written of a servo that was fitted to logs."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pandas as pd
from omegaconf import OmegaConf

from zfall.configs import compose_config
from zfall.robots.servos import servo
from zfall.robots.servos.logs import ServoLog
from zfall.simulation.identification import Estimate, Identification


def joints_of(name: str, joints: Collection[str] | None) -> list[str]:
    """The joints that get a fitted servo: those given, or that have its kind by ``datasheet``.

    Raises:
        ValueError: on an unknown joint, or if no joint has that servo.
    """
    there = _datasheet()
    if joints is None:
        same = [joint for joint, node in there.items() if node["name"] == name]
        if not same:
            raise ValueError(
                f"joints must be given for a {name}, which servo=datasheet has on no joint."
            )
        return same
    for joint in joints:
        if joint not in there:
            raise ValueError(f"joints must be of {', '.join(there)}, got {joint}.")
    return list(joints)


def write_estimates(estimates: Sequence[Estimate], path: Path) -> None:
    """Writes a row for each value."""
    rows = [asdict(each) | {"given": " ".join(each.given)} for each in estimates]
    pd.DataFrame(rows).to_csv(path, index=False)


def servo_yaml(
    found: Identification,
    sheet: Mapping[str, Any],
    joints: Collection[str],
    logs: Sequence[ServoLog],
) -> str:
    """A file of ``recipes/servo``: some joints with the fitted servo, the others by datasheet.

    Args:
        found: the fit.
        sheet: arguments of ``servo`` at which it began.
        joints: that get it.
        logs: that it was fitted to.
    """
    fitted = found.unit.servo
    names = [each.name for each in found.estimates if each.determined and each.name != "latency"]
    node = {"_target_": "zfall.robots.servos.servo", **sheet}
    node |= {name: float(f"{getattr(fitted, name):.5g}") for name in names}
    if (servo(**sheet).viscous_friction or 0.0) >= fitted.damping:
        node["viscous_friction"] = None  # that of the sheet would be more than all of the damping
    kind, files = sheet["name"], ", ".join(log.name for log in logs)
    lines = ["# @package env.base_env", f"# {kind} fitted to {files}; other joints by datasheet."]
    for each in found.estimates:
        if not each.determined:
            lines.append(f"# {each.name} is not determined by the logs.")
        elif each.name == "latency":
            lines.append(
                f"# Its latency, {1e3 * each.value:.1f} ms, is env.transforms.delay.delay."
            )
    lines.append("servos:")
    for joint, other in _datasheet().items():
        lines.append(f"  {joint}: {json.dumps(node if joint in joints else other)}")  # is yaml
    return "\n".join(lines) + "\n"


def _datasheet() -> dict[str, dict[str, Any]]:
    """The table of ``servo=datasheet``."""
    cfg = compose_config(["servo=datasheet"])
    return OmegaConf.to_container(cfg.env.base_env.servos)  # type: ignore[return-value]
