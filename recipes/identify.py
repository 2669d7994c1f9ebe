"""Fits a servo to logs of what it was sent and did: ``python -m recipes.identify log=steps.csv``.

``servo=identified`` takes ``servo/identified.yaml``; ``estimates.csv`` has 95 % intervals, and
``fit.png`` the logs next to the fitted servo.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, ListConfig

from zfall.commands import shell_line, shown_path
from zfall.configs import plain_containers
from zfall.errors import named
from zfall.values import Name, Names, NotNegative, Positive

from .shell import check_recipe, one_line_errors, start

if TYPE_CHECKING:
    from rich.table import Table

    from zfall.robots.servos.logs import Load
    from zfall.simulation.identification import Estimate

EACH = ("mass", "arm", "inertia", "down")


class Keys(TypedDict):
    """The keys of ``identify.yaml``."""

    log: Name | Names
    sheet: Mapping[str, Any]
    voltage: Positive | None
    mass: NotNegative | Sequence[NotNegative]
    arm: NotNegative | Sequence[NotNegative]
    inertia: NotNegative | Sequence[NotNegative]
    down: float | Sequence[float]
    joints: Names | None
    physics_dt: Positive


@hydra.main(version_base=None, config_path=".", config_name="identify")
def main(cfg: DictConfig) -> None:
    """Writes what was found into hydra's folder and prints it."""
    output = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
        from rich.console import Console

        from zfall.evaluation.identified import joints_of, servo_yaml, write_estimates
        from zfall.evaluation.plots import fit_plot
        from zfall.robots.servos import servo
        from zfall.robots.servos.logs import read_log
        from zfall.simulation.identification import identify

        console = Console()
        with named("sheet"):
            sheet = servo(**plain_containers(cfg.sheet))
        joints = joints_of(sheet.name, cfg.joints)
        files = [Path(each) for each in (cfg.log if is_list(cfg.log) else [cfg.log])]
        voltage = sheet.voltage if cfg.voltage is None else cfg.voltage
        files_loads = zip(files, loads_of(cfg, len(files)), strict=True)
        logs = [read_log(file, load=load, voltage=voltage) for file, load in files_loads]
        with console.status("fitting, half a minute for some logs of 10 s"):
            found = identify(logs, sheet, physics_dt=cfg.physics_dt)
    console.print(table_of(found.estimates))
    fitted = found.unit.servo
    law = f"stiffness {fitted.stiffness():.4g} N m/rad, damping {fitted.damping:.3g} N m s/rad"
    console.print(f"at {fitted.voltage:g} V and kp {fitted.kp}: {law}")
    for log, rms in zip(logs, found.rms(logs), strict=True):
        share = rms / sheet.resolution
        more = ": more than the law has, do not trust the intervals" if share > 2 else ""
        console.print(f"{log.name}: {1e3 * rms:.2f} mrad rms off, {share:.1f} encoder steps{more}")
    write_estimates(found.estimates, output / "estimates.csv")
    fit_plot(logs, found.positions, output / "fit.png", resolution=sheet.resolution)
    (output / "servo").mkdir(exist_ok=True)
    place, text = shown_path(output), servo_yaml(found, plain_containers(cfg.sheet), joints, logs)
    (output / "servo" / "identified.yaml").write_text(text)
    console.print(f"wrote {place}/estimates.csv, fit.png, servo/identified.yaml", soft_wrap=True)
    line = shell_line("train", f"--config-dir {place}", "servo=identified", *delay(found.estimates))
    console.print(f"to train with it: {line}", soft_wrap=True, highlight=False, markup=False)


def delay(estimates: "Sequence[Estimate]") -> list[str]:
    """What gives an env the latency, if the logs determine it."""
    found = [x.value for x in estimates if x.name == "latency" and x.determined]
    return [f"'env.transforms.delay.delay=[{late:.4f},{late:.4f}]'" for late in found]


def is_list(value: Any) -> bool:
    """Whether a key has one value for each log."""
    return isinstance(value, ListConfig)


def loads_of(cfg: DictConfig, count: int) -> "list[Load]":
    """The load of each log.

    Raises:
        ValueError: on a list of another length than that of the logs, or a load that cannot be.
    """
    from zfall.robots.servos.logs import Load

    columns = {}
    for key in EACH:
        values = [*cfg[key]] if is_list(cfg[key]) else [cfg[key]] * count
        if len(values) != count:
            raise ValueError(f"{key} must be one number or {count}, as the logs, got {values}.")
        columns[key] = values
    return [Load(**{key: columns[key][i] for key in EACH}) for i in range(count)]


def table_of(estimates: "Sequence[Estimate]") -> "Table":
    """The estimates as they are printed."""
    from rich.table import Table

    table = Table("", "fitted", "95 %", "sheet", "", box=None)
    for each in estimates:
        half = f"+-{each.high - each.value:.2g}" if each.determined else "wide"
        sheet = "" if each.sheet is None else f"{each.sheet:.4g}"
        about = each.verdict.removeprefix("determined").removeprefix(", ")
        table.add_row(f"{each.name}, {each.unit}", f"{each.value:.4g}", half, sheet, about)
    return table


if __name__ == "__main__":
    start(main)
