"""How far a search has come."""

import pytest

from zfall.falling.making.progress import Progress


def saving(text):
    return lambda path: path.write_text(text)


def test_a_search_goes_on_after_the_last_part_that_is_over(tmp_path):
    progress = Progress(tmp_path)
    assert (progress.lines, progress.found) == ([], None)
    progress.add("one", saving("1"))
    progress.add("two", saving("12"))
    again = Progress(tmp_path)
    assert again.lines == ["one", "two"]
    assert again.found.read_text() == "12"


def test_a_part_that_was_cut_while_it_was_saved_is_not_over(tmp_path):
    def cut(path):
        path.write_text("1")
        raise KeyboardInterrupt

    progress = Progress(tmp_path)
    progress.add("one", saving("1"))
    with pytest.raises(KeyboardInterrupt):
        progress.add("two", cut)
    again = Progress(tmp_path)
    assert again.lines == ["one"]
    assert again.found.read_text() == "1"


def test_what_came_of_it_is_left_at_the_end(tmp_path):
    progress = Progress(tmp_path)
    progress.add("one", saving("1"))
    progress.add("two", saving("2"))
    progress.end(tmp_path / "outcomes.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["outcomes.txt"]
    assert (tmp_path / "outcomes.txt").read_text() == "one\ntwo\n"
