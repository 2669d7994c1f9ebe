"""Files that are written whole or not at all."""

import pytest

from zfall.files import written_whole


def half_written(path):
    with written_whole(path) as new:
        new.write_text("sec")
        raise OSError("the disk is full")


def test_a_file_that_is_not_written_to_its_end_leaves_the_old_one_alone(tmp_path):
    path = tmp_path / "report.html"
    with written_whole(path) as new:
        new.write_text("first")
    with pytest.raises(OSError, match="full"):
        half_written(path)
    assert path.read_text() == "first"
    assert [entry.name for entry in tmp_path.iterdir()] == ["report.html"]
