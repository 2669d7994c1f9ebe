"""A recipe that counts, with a checkpoint after each step, and imports nothing heavy."""

import os
import time
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from zfall.files import written_whole

STOP = 6  # the step after which a job waits for the file ``waits_for``


@hydra.main(version_base=None, config_path=".", config_name="counting")
def main(cfg: DictConfig) -> int:
    """Writes ``count.txt``, with a row for each step, and ``begins.txt``, where it began."""
    if cfg.fails:
        raise SystemExit("error: fails must be false, got true.")
    folder = Path(HydraConfig.get().runtime.output_dir)
    last, count = folder / "last.pt", 0
    if cfg.resume == "auto" and last.exists():
        count = int(last.read_text())
    with (folder / "begins.txt").open("a") as file:
        file.write(f"{count} {os.environ['OMP_NUM_THREADS']}\n")
    rows = [f"{number}\n" for number in range(1, count + 1)]
    while count < cfg.until:
        time.sleep(cfg.seconds)
        count += 1
        rows.append(f"{count}\n")
        (folder / "count.txt").write_text("".join(rows))
        with written_whole(last) as new:
            new.write_text(str(count))
        print(f"counted {count}")
        while cfg.waits_for and count == STOP and not Path(cfg.waits_for).exists():
            time.sleep(0.01)
    return count
