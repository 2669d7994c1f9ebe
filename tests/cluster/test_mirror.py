"""Files between disks, without a cluster."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from zfall.cluster.mirror import Keeper, Sender, contents, write


class Handle:
    """Calls a keeper as Ray's handle does, in this process."""

    def __init__(self, keeper: Keeper):
        self.keep = SimpleNamespace(remote=keeper.keep)


@pytest.fixture
def disks(tmp_path) -> tuple[Path, Path]:
    for name in ("home", "node"):
        (tmp_path / name).mkdir()
    return tmp_path / "home", tmp_path / "node"


def keeper_of(home: Path, **reads: list[str]) -> Keeper:
    named = {0: "seed=0", 1: "seed=1"}
    return Keeper(home, home / "index", {0: reads.get("reads", []), 1: []}, named)


def test_what_a_job_writes_comes_home_and_what_it_removes_goes(disks):
    home, node = disks
    sender = Sender(node, 0, Handle(keeper_of(home)), lambda value: value)
    write(node, {"run/metrics.csv": b"1\n", "run/half.csv": b"x", "run/.lock": b""})
    sender.send()
    assert (home / "run" / "metrics.csv").read_bytes() == b"1\n"
    assert not (home / "run" / ".lock").exists()
    (node / "run" / "half.csv").unlink()
    (node / "run" / "metrics.csv").write_bytes(b"1\n2\n")
    sender.send()
    assert (home / "run" / "metrics.csv").read_bytes() == b"1\n2\n"
    assert not (home / "run" / "half.csv").exists()


def test_a_job_that_begins_again_is_sent_what_it_wrote_and_what_it_reads(disks):
    """Also by a later sweep; not what another job wrote."""
    home, _ = disks
    write(home, {"policy/a.pt": b"a", "other/b": b"b"})
    keeper_of(home).keep(0, {"run/last.pt": b"p"}, [])
    again = keeper_of(home, reads=["policy"])
    assert again.files_for(0) == {"run/last.pt": b"p", "policy/a.pt": b"a"}
    assert again.files_for(1) == {}


def test_a_checkpoint_is_read_before_what_belongs_to_it_and_written_after(disks, monkeypatch):
    """A cut in between leaves rows without their checkpoint, which are dropped; never the reverse."""
    home, node = disks
    write(node, {"a/metrics.csv": b"", "checkpoints/best.pt": b"", "checkpoints/last.pt": b""})
    files = contents(node, [path for path in node.rglob("*") if path.is_file()])
    assert next(iter(files)) == "checkpoints/last.pt"
    written: list[str] = []
    write_bytes = Path.write_bytes
    monkeypatch.setattr(
        Path, "write_bytes", lambda path, data: (written.append(path.stem), write_bytes(path, data))
    )
    keeper_of(home).keep(0, files, [])
    assert written[-1] == "last.pt"


def test_lines_of_two_jobs_are_put_together(disks):
    home, _ = disks
    write(home, {"r.jsonl": b"one\ntwo\n"})
    write(home, {"r.jsonl": b"one\nthree\n"})
    assert (home / "r.jsonl").read_bytes() == b"one\ntwo\nthree\n"
