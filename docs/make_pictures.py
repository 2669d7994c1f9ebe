"""Makes single pictures of docs/pictures: ``.venv/bin/python docs/make_pictures.py kneel``.

In the folder of the clone, with ``MUJOCO_GL=egl``. Names: kneel, walking, video; viewer and
playground need Chromium and playwright, the playground also a built ``site``.
"""

import sys
import threading
import time
from collections.abc import Callable, Sequence
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory

import imageio.v2 as imageio
import mujoco
import numpy as np
from matplotlib import font_manager
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console

PICTURES = Path(__file__).parent / "pictures"
INK, BLUE, GREEN, RED = (40, 46, 54), (0, 114, 178), (0, 128, 92), (213, 94, 0)
KNEEL = {1080: ("recovers", GREEN), 227: ("kneels", BLUE), 324: ("falls", RED)}  # trials
SINCE = (0.02, 0.22, 0.34, 0.5, 0.78, 2.5)  # the push of battery kneel began [s]
CHROMIUM = ["--headless=new", "--no-sandbox", "--disable-quic", "--no-first-run"]
CHROMIUM += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
CHROMIUM += ["--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


def kneel() -> None:
    """Three trials of ``kneel`` in rows; frames since it gave up standing have a frame."""
    from zfall.evaluation.candidate import load_candidate
    from zfall.evaluation.definitions import load_battery
    from zfall.evaluation.single_trial import run_trial

    battery, policy = load_battery("kneel", end_time=3.2), load_candidate("kneel")
    wide, high, left, top = 300, 270, 250, 64
    page = Image.new("RGB", (left + len(SINCE) * wide, top + len(KNEEL) * high), "white")
    draw = ImageDraw.Draw(page)
    for column, since in enumerate(SINCE):
        _write(draw, (left + (column + 0.5) * wide, top / 2), f"{since:g} s", 28, bold=True)
    _write(draw, (left / 2, top / 2), "after the push began", 20)
    for row, (trial, (name, color)) in enumerate(KNEEL.items()):
        replay = run_trial(battery, policy, trial, seed=0, joint="left_hip_pitch")
        gave_up = min(replay.remarks.values(), default=np.inf) - battery.push_time
        lines = [f"I = {replay.row['impulse']:.2f}", f"{replay.row['force_n']:.0f} N for 0.1 s"]
        lines += [f"gives up at {gave_up:.2f} s"] if np.isfinite(gave_up) else []
        print(trial, name, replay.row["kneeled"], replay.row["recovered"], lines)
        y = top + (row + 0.5) * high
        _write(draw, (left / 2, y - 55), name, 30, bold=True, color=color)
        for number, text in enumerate(lines):
            _write(draw, (left / 2, y - 12 + 32 * number), text, 21)
        dt = replay.env.control_dt
        steps = [round((battery.push_time + since) / dt) - 1 for since in SINCE]
        shown = _stills(replay.env.camera.model, replay.states[steps, 0], wide, high)
        for column, (picture, since) in enumerate(zip(shown, SINCE, strict=True)):
            place = left + column * wide, top + row * high
            page.paste(Image.fromarray(picture), place)
            if since >= gave_up:
                corner = place[0] + wide - 5, place[1] + high - 5
                draw.rectangle((place[0] + 4, place[1] + 4, *corner), outline=RED, width=4)
    _save(page, "kneel")


def walking() -> None:
    """Four moments of ``zeroth_fall``, 0.08 s apart."""
    import zfall
    from zfall.evaluation.play import walk

    policy, moments = zfall.load_policy("zeroth_fall"), (1.0, 1.08, 1.16, 1.24)
    env = policy.env(num_envs=64)
    played = walk(env, policy.actor, 1.4, filmed=1)
    steps = [round(moment / env.base_env.control_dt) - 1 for moment in moments]
    shown = _stills(env.base_env.camera.model, played.states[steps, 0], 400, 380)
    page = Image.new("RGB", (400 * len(moments), 44 + 380), "white")
    draw = ImageDraw.Draw(page)
    for column, (moment, picture) in enumerate(zip(moments, shown, strict=True)):
        _write(draw, (400 * column + 200, 22), f"{moment:.2f} s", 26, bold=True)
        page.paste(Image.fromarray(picture), (400 * column, 44))
    _save(page, "walking")


def video() -> None:
    """The film of a training's end at 1.2 s, of the policy ``twin``."""
    from zfall.evaluation import showcase
    from zfall.evaluation.candidate import load_candidate
    from zfall.evaluation.definitions import load_battery

    policy = load_candidate("twin")
    battery = load_battery("planar", impulses=[0.2, 0.4], starts=1).of_size(policy.robot)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "video.mp4"
        showcase.video(battery, policy.env_cfg, policy.actor, path, Console())
        with imageio.get_reader(path) as reader:
            picture = reader.get_data(round(1.2 * reader.get_meta_data()["fps"]))
    _save(Image.fromarray(picture), "video")


def viewer() -> None:
    """Two robots of ``twin`` and two that hold their pose, a third of a second after a push."""
    from zfall.viewer.casting import Casting
    from zfall.viewer.viewer import Viewer

    view = Viewer(Casting(worlds=4), "twin", "pose_hold", port=0)
    running = threading.Thread(target=view.run, daemon=True)
    running.start()

    def frozen() -> None:
        while not view.robots[2].view.pushed:
            time.sleep(0.01)
        begin = view.robots[0].player.time
        while view.robots[0].player.time < begin + 0.32:
            time.sleep(0.005)
        view.controls.paused.value = True

    def shoot(page: object) -> None:
        page.goto(f"http://127.0.0.1:{view.port}", timeout=180_000)
        button = page.get_by_role("button", name="push", exact=True)
        button.wait_for(timeout=180_000)
        while view.robots[0].player.time < 2.0:
            time.sleep(0.1)
        waiting = threading.Thread(target=frozen, daemon=True)
        waiting.start()
        view.controls.speed.value = 0.3
        button.click(timeout=180_000)
        waiting.join(180)
        time.sleep(3)

    _shoot(shoot, {"viewer": (1280, 800)})
    view.stop()
    running.join(30)
    view.close()


def playground() -> None:
    """The page on a screen and on a phone, 0.3 s after a push; ``site`` was built before."""
    handler = partial(SimpleHTTPRequestHandler, directory="site")
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    push = """() => { const q = window.zfall.page, t = q.world.time; window.frozen = false;
      [...document.querySelectorAll('#compass button')].find(
        (b) => b.textContent === 'back right').click();
      const f = () => { if (!window.frozen && q.world.time > t + 0.3) {
          q.running = false; window.frozen = true; }
        if (window.frozen) q.scene.draw(); requestAnimationFrame(f); }; f(); }"""

    def shoot(page: object) -> None:
        page.set_default_timeout(240_000)
        page.goto(f"http://127.0.0.1:{server.server_port}/")
        page.evaluate("() => window.zfall.ready")
        page.wait_for_function("window.zfall.page.world.time > 1.0")
        page.evaluate(push)
        page.wait_for_function("window.frozen")
        time.sleep(2)

    _shoot(shoot, {"playground_1280": (1280, 800), "playground_400": (400, 860)})
    server.shutdown()


def _shoot(prepare: Callable[..., None], pictures: dict[str, tuple[int, int]]) -> None:
    """Opens a page of each size ``(width, height)``, prepares it and keeps a picture of it."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path="/usr/bin/chromium", args=CHROMIUM)
        for name, (width, height) in pictures.items():
            page = browser.new_page(viewport={"width": width, "height": height})
            prepare(page)
            page.screenshot(path=str(PICTURES / f"{name}.png"), timeout=180_000)
        browser.close()


def _stills(
    model: mujoco.MjModel, states: NDArray[np.float64], wide: int, high: int
) -> list[NDArray[np.uint8]]:
    """Pictures of states ``(K, nq)`` as films show them, in half of the renderer's pixels."""
    from zfall.envs.rendering import make_renderer, place

    renderer, data = make_renderer(model, 2 * wide, 2 * high), mujoco.MjData(model)
    option = mujoco.MjvOption()
    option.sitegroup[:] = 0
    out = []
    for state in states:
        place(model, data, state)
        renderer.update_scene(data, camera="track", scene_option=option)
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        picture = Image.fromarray(renderer.render()).resize((wide, high), Image.Resampling.LANCZOS)
        out.append(np.asarray(picture))
    renderer.close()
    return out


def _write(
    draw: ImageDraw.ImageDraw,
    middle: tuple[float, float],
    text: str,
    size: int,
    *,
    bold: bool = False,
    color: tuple[int, int, int] = INK,
) -> None:
    weight = "bold" if bold else "normal"
    look = font_manager.FontProperties(family="DejaVu Sans", weight=weight)
    font = ImageFont.truetype(font_manager.findfont(look), size)
    draw.text(middle, text, color, font, anchor="mm")


def _save(picture: Image.Image, name: str) -> None:
    path = PICTURES / f"{name}.png"
    few = picture.quantize(256, kmeans=1, dither=Image.Dither.FLOYDSTEINBERG)
    few.save(path, optimize=True)
    print(f"wrote {path}: {path.stat().st_size / 1e6:.2f} MB")


def main(names: Sequence[str]) -> None:
    """Makes the pictures with these names."""
    known = {each.__name__: each for each in (kneel, walking, video, viewer, playground)}
    if not names or (unknown := [name for name in names if name not in known]):
        given = unknown[0] if names else "none"
        sys.exit(f"names must be of {', '.join(known)}, got {given}.")
    for name in names:
        known[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
