"""Runs a maker of ``zfall.falling.making`` as a recipe."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import DictConfig

from zfall.commands import shown_path
from zfall.configs import plain_containers

from ..shell import one_line_errors


def maker_of(kind: str, cfg: DictConfig, but: Sequence[str] = ()) -> Any:
    """A maker that takes the keys of a recipe but some, and ``trust``, as keywords."""
    from zfall.falling import making

    given = {k: v for k, v in plain_containers(cfg).items() if k not in ("trust", *but)}
    return getattr(making, kind)(**given)


def make_one(kind: str, cfg: DictConfig, path: Path, but: Sequence[str] = ()) -> None:
    """Has a maker, see ``maker_of``, write its file."""
    with one_line_errors():
        from rich.console import Console

        console = Console()
        maker = maker_of(kind, cfg, but)
        path.parent.mkdir(parents=True, exist_ok=True)
        maker.make(path, console)
    console.print(f"wrote {shown_path(path)}", soft_wrap=True)
