"""Shows robots in the browser, live, to be pushed by hand: ``recipes.view run=NAME``."""

from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any, NotRequired, TypedDict

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.commands import remove_if_empty
from zfall.errors import SPOKEN
from zfall.trust import trusting
from zfall.values import Name, Rule, Seed

from .shell import (
    Changes,
    Checkpoint,
    Run,
    check_recipe,
    loading,
    one_line_errors,
    start,
)

NEEDED = ("viser", "trimesh", "plotly")


class Keys(TypedDict):
    """The keys of ``view.yaml``."""

    run: Run
    compare: Run
    checkpoint: Checkpoint
    battery: Name | None
    env: NotRequired[Mapping[str, Any] | None]  # servo=NAME alone gives a part of one
    worlds: Annotated[int, Rule("lie in 1 to 16", lambda x: 1 <= x <= 16)]
    host: Name
    port: Annotated[int, Rule("lie in 0 to 65535", lambda x: 0 <= x <= 65535)]
    seed: Seed
    trust: Changes
    change: Changes
    servo: NotRequired[Any]


@hydra.main(version_base=None, config_path=".", config_name="view")
@one_line_errors(SPOKEN)
def main(cfg: DictConfig) -> None:
    """Serves the page until Ctrl-C; writes no files."""
    with one_line_errors():
        check_recipe(cfg, Keys)
        missing = [name for name in NEEDED if find_spec(name) is None]
        if missing:
            raise ValueError(f"view needs {', '.join(missing)}: pip install zfall[view]")
    with one_line_errors(), trusting(cfg.trust):
        from zfall.viewer.casting import Casting
        from zfall.viewer.viewer import Viewer

        casting = Casting(
            worlds=cfg.worlds,
            seed=cfg.seed,
            battery=cfg.battery,
            **loading(cfg),
        )
        viewer = Viewer(casting, cfg.run, cfg.compare, host=cfg.host, port=cfg.port)
    remove_if_empty(Path(HydraConfig.get().runtime.output_dir))  # nothing is written
    print(f"open http://{cfg.host}:{viewer.port} in a browser; Ctrl-C ends it", flush=True)
    with trusting(cfg.trust):
        try:
            viewer.run()
        finally:
            viewer.close()


if __name__ == "__main__":
    start(main)
