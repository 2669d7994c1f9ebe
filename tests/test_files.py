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


def test_files_that_differ_in_their_ending_are_written_at_once(tmp_path):
    with written_whole(tmp_path / "a.md") as one, written_whole(tmp_path / "a.csv") as other:
        one.write_text("one")
        other.write_text("other")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {
        "a.md": "one",
        "a.csv": "other",
    }


def test_a_link_in_the_place_of_what_is_written_first_is_not_followed(tmp_path):
    (tmp_path / "mine").write_text("mine")
    (tmp_path / "a.md.tmp").symlink_to(tmp_path / "mine")
    with written_whole(tmp_path / "a.md") as new:
        new.write_text("new")
    assert (tmp_path / "mine").read_text() == "mine"
    assert (tmp_path / "a.md").read_text() == "new"
