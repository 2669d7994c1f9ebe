"""Learning curves over seeds: ``python -m recipes.systems.curves 'runs={icub: [A, B]}'``.

Figure 2 of Ferigo et al. 2021 and figure 4 of Duburcq et al. 2022: return and length of episodes
over control steps, mean over runs, from their ``metrics.csv``. Runs need not be over.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import shown_path
from zfall.errors import SPOKEN
from zfall.values import Rule

from ..shell import Run, check_recipe, one_line_errors, start

_SOME = Rule("name at least one run", lambda x: len(x) > 0)


class Keys(TypedDict):
    """The keys of ``curves.yaml``."""

    runs: Annotated[Mapping[str, Annotated[Sequence[Run], _SOME]], _SOME]


@hydra.main(version_base=None, config_path=".", config_name="curves")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Writes ``curves.csv`` and a figure each of return and length of episodes."""
    folder = Path(HydraConfig.get().runtime.output_dir)
    with one_line_errors():
        check_recipe(cfg, Keys)
        from rich.console import Console

        from zfall.evaluation.plots import learning_bands
        from zfall.evaluation.plots.curves import learning_table
        from zfall.evaluation.run_files import read_table
        from zfall.evaluation.writers import write_figures, write_table

        groups = {
            str(name): [read_table(Path(run) / "metrics.csv") for run in runs]
            for name, runs in cfg.runs.items()
        }
    folder.mkdir(parents=True, exist_ok=True)
    written = write_table(folder, "curves", learning_table(groups))
    for key, label in (
        ("episode_return", "return of an episode"),
        ("episode_seconds", "length of an episode [s]"),
    ):
        draw = partial(learning_bands, groups, key=key, label=label)
        written += write_figures(folder, key, draw)
    Console().print(f"wrote {shown_path(folder)}/{', '.join(written)}", soft_wrap=True)


if __name__ == "__main__":
    start(main)
