"""The page in a real browser: it loads, its controls act, and it is quick enough."""

import shutil
import threading
import time
from collections.abc import Callable

import pytest
import torch

pytest.importorskip("viser", reason="the extra [view] is not installed")

from zfall import checkpoint
from zfall.policies.load import POLICIES
from zfall.viewer.casting import Casting, WatchedFile
from zfall.viewer.viewer import Viewer

pytestmark = pytest.mark.long

api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")

FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed")


@pytest.fixture
def viewer():
    view = Viewer(Casting(worlds=4), "twin", "pose_hold", port=0)
    thread = threading.Thread(target=view.run, daemon=True)
    thread.start()
    yield view
    view.stop()
    thread.join(30)
    view.close()


def wait_for(true: Callable[[], object], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "it did not come about in time"
        time.sleep(0.02)


class Noticed(threading.Thread):
    """Remembers that something came about, which may be over when a slow browser answers."""

    def __init__(self, true: Callable[[], object]):
        super().__init__(daemon=True)
        self.true, self.over, self.came = true, threading.Event(), False
        self.start()

    def run(self) -> None:
        while not (self.came or self.over.wait(0.02)):
            self.came = bool(self.true())


@needs_chromium
def test_the_page_pushes_and_swaps(viewer):
    """A button's push of I = 2 fells held servos; another policy takes over while all runs."""
    wrong = []
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=FLAGS)
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.on("pageerror", lambda error: wrong.append(str(error)))
        page.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
        page.goto(f"http://127.0.0.1:{viewer.port}", timeout=120_000)
        button = page.get_by_role("button", name="push", exact=True)
        button.wait_for(timeout=120_000)
        held = viewer.robots[2].player
        assert not held.fell.any()
        viewer.controls.size.value = 2.0
        arrow, fall = Noticed(lambda: viewer.robots[2].view.pushed), Noticed(held.fell.all)
        button.click(timeout=120_000)
        wait_for(lambda: arrow.came)
        wait_for(lambda: fall.came)
        for noticed in (arrow, fall):
            noticed.over.set()
        viewer.controls.run.value = "best"
        wait_for(lambda: viewer.robots[0].label == "best 1", 120)
        before = viewer.robots[0].player.time
        wait_for(lambda: viewer.robots[0].player.time > before)
        browser.close()
    # Fonts from elsewhere are missed without the net, and nothing depends on them.
    assert [text for text in wrong if "ERR_NAME_NOT_RESOLVED" not in text] == []


def test_four_worlds_leave_time_for_25_frames_a_second(viewer):
    """By processor time: a busy machine has the same capacity, and less of it to give."""
    wait_for(lambda: viewer.frames > 10)
    viewer.frames, viewer.busy = 0, 0.0
    wait_for(lambda: viewer.frames > 100)
    assert viewer.frames / viewer.busy >= 25


def test_new_weights_of_a_run_take_over_while_it_is_shown(tmp_path):
    """The ``last.pt`` of a training is written anew, as a training does: the old one is replaced."""
    last = tmp_path / "checkpoints" / "last.pt"
    last.parent.mkdir()
    content = checkpoint.load(POLICIES / "best.pt")
    checkpoint.save(last, content)
    view = Viewer(Casting(worlds=1), str(tmp_path), port=0)
    thread = threading.Thread(target=view.run, daemon=True)
    thread.start()
    try:
        name, old = next(iter(view.robots[0].player.actor.state_dict().items()))
        newer = {key: value + 0.5 for key, value in content["policy"].items()}
        checkpoint.save(last, content | {"policy": newer})
        wait_for(lambda: "weights of" in view.controls.status.content)
        now = view.robots[0].player.actor.state_dict()[name]
        assert torch.allclose(now, old + 0.5)
    finally:
        view.stop()
        thread.join(30)
        view.close()


def test_a_file_is_new_once_and_may_not_be_there_yet(tmp_path):
    path = tmp_path / "last.pt"
    watched = WatchedFile(path)
    assert not watched.changed()
    path.write_text("1")
    assert watched.changed()
    assert not watched.changed()
    path.unlink()
    assert not watched.changed()
    assert not WatchedFile(None).changed()


def test_a_name_that_is_none_leaves_the_others_running(viewer):
    viewer._ask(lambda: viewer._choose("nowhere", "nobody"))
    wait_for(lambda: "there is no folder nowhere" in viewer.controls.status.content)
    assert viewer.robots[0].label == "twin 1"
