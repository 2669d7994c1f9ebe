"""Stages that make a file in place of training: ``stages.NAME: {make: {_target_: ..., ...}}``."""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from hydra.utils import instantiate
from omegaconf import OmegaConf
from rich.console import Console

from zfall.errors import named, object_at
from zfall.training.interrupts import Stopped, first_ctrl_c
from zfall.training.links import filled
from zfall.training.own_draws import own_draws
from zfall.training.ranks import Ranks


class Maker(Protocol):
    """What a stage names as its ``make``: a class, given the other values there as keywords.

    It is made when the files of the stages before are there, and once before the first stage
    begins, from what ``stand_in`` wrote for them. So its constructor checks all that it can.

    Attributes:
        suffix: of the file, ``.npz``; one of the class.
        is_policy: whether the file is the checkpoint of a policy; one of the class.
    """

    suffix: str
    is_policy: bool

    def make(self, path: Path, console: Console) -> None:
        """Writes the file.

        Args:
            path: the file, in a folder of its own. What else is written there stays, reports for
                instance; a maker that was cut finds it there again, and may go on from it.
            console: where progress is shown.
        """

    def stand_in(self, path: Path) -> None:
        """Writes a file of the same form within seconds, by which later stages are tried."""


def file_of(make: Mapping[str, Any], name: str) -> str:
    """Where what a stage makes is kept, within the folder of the run.

    Raises:
        ValueError: if ``make`` names no maker.
    """
    place = f"stages.{name}.make"
    if not isinstance(make, Mapping) or not isinstance(make.get("_target_"), str):
        raise ValueError(f"{place} must be a table with the _target_ of a maker, got {make}.")
    kind = object_at(make["_target_"], f"{place}._target_")
    if not all(hasattr(kind, each) for each in ("suffix", "is_policy", "make", "stand_in")):
        raise ValueError(
            f"{place}._target_ must name a class with suffix, is_policy, make and stand_in, "
            f"got {make['_target_']}."
        )
    return f"checkpoints/{name}.pt" if kind.is_policy else f"made/{name}{kind.suffix}"


def maker_of(make: Mapping[str, Any], name: str, folder: Path, files: Mapping[str, str]) -> Maker:
    """The maker of a stage.

    Args:
        make: plain containers, with ``stage:NAME``.
        name: of the stage.
        folder: of the run.
        files: of the stages before, by name, within the folder.

    Raises:
        ValueError: on arguments that it cannot have.
    """
    given = OmegaConf.create(filled(make, folder, files))
    with named(f"stages.{name}.make"):
        maker: Maker = instantiate(given, _convert_="all", _recursive_=False)
    return maker


def make_file(
    make: Mapping[str, Any],
    name: str,
    folder: Path,
    files: Mapping[str, str],
    ranks: Ranks,
    console: Console,
) -> None:
    """Makes the file of a stage unless it is there; the leading rank does, the others wait.

    Other arguments as of ``maker_of``.

    Args:
        ranks: the processes that share the training.
        console: where progress is shown.

    Raises:
        Stopped: on ctrl-c.
        ValueError: if nothing was made.
    """
    path, stopped = folder / file_of(make, name), False
    if ranks.leads:
        if not path.exists():
            console.print(f"makes {name}", soft_wrap=True)
        try:
            if not path.exists():
                with own_draws():
                    _make_whole(maker_of(make, name, folder, files), name, path, folder, console)
        except KeyboardInterrupt:
            stopped = True
        ranks.wait()
    else:
        with first_ctrl_c() as pressed:
            ranks.wait()
        stopped = pressed.is_set()
    if ranks.any(stopped):
        raise Stopped


def _make_whole(maker: Maker, name: str, path: Path, folder: Path, console: Console) -> None:
    """Has a file made in a folder of its own, ``made/NAME``, and puts it where it belongs."""
    place = folder / "made" / name
    new = place / path.name
    place.mkdir(parents=True, exist_ok=True)
    new.unlink(missing_ok=True)
    maker.make(new, console)
    if not new.is_file():
        raise ValueError(f"stages.{name}.make must write {path.name}, there is no such file.")
    path.parent.mkdir(exist_ok=True)
    new.replace(path)
    with suppress(OSError):  # of which there is a report
        place.rmdir()
