"""Whether a folder holds the run that is to go on in it."""

from pathlib import Path

from omegaconf import DictConfig, OmegaConf

from zfall.configs import plain_containers
from zfall.meaning import differences, meaning
from zfall.training.stages import written_out

AUTO = "auto"  # in place of a folder to go on from: the one of the run, if it was begun


def check_same_run(stored: DictConfig, given: DictConfig, folder: Path) -> None:
    """Refuses to go on with a run of another config, but for its length.

    Raises:
        ValueError: naming the first key that differs.
    """
    configs = (stored, OmegaConf.create(written_out(given)))
    before, now = ({str(k): v for k, v in plain_containers(each).items()} for each in configs)
    for config in (before, now):
        for table in (config, *(stage for stage in (config.get("stages") or {}).values() if stage)):
            table["total_frames"] = 0  # there: without it a config counts as none of a training
        for key in ("resume", "trust"):
            config.pop(key, None)
    if differing := differences(meaning(before), meaning(now)):
        raise ValueError(
            f"{differing[0]} must be that of the run in {folder}, which goes on; another folder "
            "begins a run."
        )
