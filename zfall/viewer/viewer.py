"""The live viewer: worlds that run in real time, shown in the browser and moved from its panel."""

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from math import ceil

import numpy as np
import torch

from zfall.errors import in_one_line
from zfall.viewer.casting import NOBODY, Casting, WatchedFile
from zfall.viewer.controls import Controls, Push, Told
from zfall.viewer.geometry import body_meshes
from zfall.viewer.page import Page
from zfall.viewer.player import Player
from zfall.viewer.scene import COMPARED, RobotView
from zfall.viewer.signals import Plots, read_signals
from zfall.viewer.stage import ROOT, Stage, offsets

FRAMES = 30.0  # a second that are shown at least, if the machine can
ARROW_SECONDS = 1.0  # for which a push stays visible
LYING_SECONDS = 1.5  # after a fall, before the robot is put back
PLOT_SECONDS = 1.0  # between two drawings of the plots
WATCH_SECONDS = 1.0  # between two looks at files


@dataclass
class Robot:
    """A robot in the browser: world ``row`` of a player."""

    player: Player
    row: int
    label: str
    view: RobotView
    arrow_until: float = 0.0
    lying_since: float | None = None


class Viewer:
    """Runs players in real time and shows them.

    What the browser asks for is put into a queue, which the loop empties between two steps.

    Args:
        casting: how policies are loaded.
        run: the policy or baseline that is shown first.
        compare: with whom; ``nobody`` for none.
        host: address to listen at.
        port: of the page; 0 for a free one.

    Attributes:
        robots: in the order in which they stand.
        frames: number of frames shown.
        busy: processor time of this process while it steps and shows [s]; ``frames / busy`` are
            the frames a second that one free core can do.

    Raises:
        ValueError: if the port is taken, or as ``Casting.players``.
    """

    def __init__(
        self,
        casting: Casting,
        run: str,
        compare: str = NOBODY,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
    ):
        self.casting, self.run_name, self.compare_name = casting, run, compare
        self._asked: queue.Queue[Callable[[], None]] = queue.Queue()
        self._stopped = threading.Event()
        self.frames, self.busy = 0, 0.0
        self._file = WatchedFile(casting.file_of(run))
        self._players = casting.players(run, compare)
        first = self._players[0]
        self._page = Page(host, port)
        self.server, self.port = self._page.server, self._page.port
        self.server.gui.configure_theme(control_layout="fixed", control_width="medium")
        self.stage = Stage(self.server, casting.worlds)
        self.controls = Controls(
            self.server,
            Told(
                choose=lambda *names: self._ask(lambda: self._choose(*names)),
                push=lambda push: self._ask(lambda: self.push(push)),
                reset=lambda: self._ask(self.reset),
                world=lambda *values: self._ask(self._set_world),
            ),
            self._choices(run),
            [NOBODY, *self._choices(compare)],
            run=run,
            compare=compare,
            unit=first.env.base_env.robot.impulse_unit,
            points=first.points,
        )
        self.plots = Plots(self.server)
        self.robots: list[Robot] = []
        self._show_players(self._players)

    def run(self) -> None:
        """Steps and shows until ``stop``, at the speed that the panel says."""
        due = watched = plotted = time.monotonic()
        while not self._stopped.is_set():
            self._do_what_is_asked()
            now = time.monotonic()
            if now - watched > WATCH_SECONDS:
                watched = now
                self._look_at_files()
            if self.controls.paused.value:
                time.sleep(0.02)
                due = time.monotonic()
                continue
            began = time.process_time()
            length = self._players[0].control_dt / self.controls.speed.value  # [s] of the clock
            self._step()
            if now - plotted > PLOT_SECONDS:
                plotted = now
                self._report()
            states = [player.states for player in self._players]
            shown = ceil(length * FRAMES)
            for frame in range(1, shown + 1):
                due += length / shown
                if frame < shown and time.monotonic() > due:
                    continue  # late: only the last one counts
                self._show(states, frame / shown)
                self.busy += time.process_time() - began
                self._stopped.wait(max(0.0, due - time.monotonic()))
                began = time.process_time()
            due = max(due, time.monotonic() - length)  # slower than real time rather than behind

    def stop(self) -> None:
        """Ends ``run``, which may be in another thread."""
        self._stopped.set()

    def close(self) -> None:
        """Ends the page, and frees its port."""
        self._page.close()

    def push(self, push: Push) -> None:
        """Pushes robots with the coming step, and shows arrows."""
        for player in self._players:
            robots = [r for r in self.robots if r.player is player]
            robots = [r for r in robots if push.who in ("everybody", r.label)]
            rows = torch.zeros(player.num_envs, dtype=torch.bool)
            rows[[r.row for r in robots]] = True
            impulse = push.impulse(player.env.base_env.robot.impulse_unit)
            player.push(rows, push.point, impulse, push.duration)
            for robot in robots:
                robot.view.show_push(push.point, (impulse / push.duration).double().numpy())
                robot.arrow_until = player.time + ARROW_SECONDS

    def reset(self) -> None:
        """Puts all robots back to where they began."""
        for player in self._players:
            player.reset()
        for robot in self.robots:
            robot.view.hide_push()
            robot.lying_since = None
        self.stage.reset()
        self._show([player.states for player in self._players], 1.0)

    def say(self, text: str) -> None:
        """Shows a line at the top of the panel."""
        self.controls.status.content = text

    def _ask(self, what: Callable[[], None]) -> None:
        self._asked.put(what)

    def _do_what_is_asked(self) -> None:
        while not self._asked.empty():
            try:
                self._asked.get()()
            except Exception as error:  # the page shows it, and what ran goes on
                self.say(f"**error:** {in_one_line(error)}")

    def _choices(self, name: str) -> list[str]:
        there = self.casting.choices()
        return there if name in there or name == NOBODY else [*there, name]

    def _choose(self, run: str, compare: str) -> None:
        if (run, compare) == (self.run_name, self.compare_name):
            return
        self.say(f"loading {run} ...")
        file = WatchedFile(self.casting.file_of(run))
        players = self.casting.players(run, compare)
        self._file = file
        self.run_name, self.compare_name = run, compare
        self._show_players(players)

    def _show_players(self, players: list[Player]) -> None:
        self._players = players
        with self.server.atomic():
            for node in [f"{ROOT}/robots/{i}" for i in range(len(self.robots))]:
                self.server.scene.remove_by_name(node)
            robots: list[Robot] = []
            places = iter(offsets(sum(player.num_envs for player in players)))
            for number, player in enumerate(players):
                model = player.env.base_env.camera.model  # as in pictures and films
                meshes = body_meshes(model, COMPARED if number > 0 else None)
                for row in range(player.num_envs):
                    name = player.candidate.label
                    label = f"{name} {row + 1}" if player.num_envs > 1 else name
                    node = f"{ROOT}/robots/{len(robots)}"
                    view = RobotView(self.server, node, model, meshes, next(places), label)
                    robots.append(Robot(player, row, label, view))
        self.robots = robots
        self.plots.clear()
        self.controls.name_robots([robot.label for robot in self.robots])
        self._set_world()
        self.reset()
        self._say_who()

    def _set_world(self) -> None:
        latency, moved = self.controls.world()
        for player in self._players:
            player.set_latency(latency)
            player.set_physics(moved)

    def _step(self) -> None:
        for player in self._players:
            player.step()
            robots = [robot for robot in self.robots if robot.player is player]
            again = torch.zeros(player.num_envs, dtype=torch.bool)
            for robot in robots:
                if robot.view.pushed and player.time > robot.arrow_until:
                    robot.view.hide_push()
                if not player.fell[robot.row]:
                    continue
                if robot.lying_since is None:
                    robot.lying_since = player.time
                lying = player.time - robot.lying_since
                if self.controls.rise.value and lying > LYING_SECONDS:
                    again[robot.row], robot.lying_since = True, None
            if again.any():
                player.reset(again)
        watched = self._watched()
        if self.controls.plotted.value:
            self.plots.add(watched.player.time, read_signals(watched.player.seen, watched.row))

    def _watched(self) -> Robot:
        label = self.controls.watched.value
        robot = next((r for r in self.robots if r.label == label), self.robots[0])
        self.plots.watch(label)
        return robot

    def _show(self, states: list[np.ndarray], share: float) -> None:
        """Shows where all are once a share of the last control step has passed."""
        with self.server.atomic():
            for robot in self.robots:
                own = states[self._players.index(robot.player)][robot.row]
                robot.view.show(own[max(0, round(share * len(own)) - 1)])
                fallen = bool(robot.player.fell[robot.row])
                mode = robot.player.mode(robot.row)
                note = "fell" if fallen else mode if mode != "recover" else None
                robot.view.say(f"{robot.label}: {note}" if note else robot.label)
            if self.controls.follow.value:
                self.stage.follow(self._watched().view.place)
        self.frames += 1

    def _report(self) -> None:
        watched = self._watched()
        if self.controls.plotted.value:
            self.plots.draw()
        mode = watched.player.mode(watched.row)
        lines = [f"time {watched.player.time:.1f} s"]
        if mode is not None:
            lines.append(f"mode {mode}")
        if "fall_probability" in watched.player.seen.keys():
            probability = float(watched.player.seen["fall_probability"][watched.row])
            lines.append(f"probability of a fall {100 * probability:.0f} %")
        self.controls.readout.content = ", ".join(lines)

    def _look_at_files(self) -> None:
        choices = self._choices(self.run_name)
        if tuple(choices) != tuple(self.controls.run.options):
            self.controls.run.options = tuple(choices)
            self.controls.compare.options = (NOBODY, *self._choices(self.compare_name))
        if self.controls.reload.value and self._file.changed():
            self._ask(self._carry_on)

    def _carry_on(self) -> None:
        self._players[0].carry_on(self.casting.reload(self.run_name))
        self._say_who(f", weights of {time.strftime('%H:%M:%S')}")

    def _say_who(self, more: str = "") -> None:
        against = "" if self.compare_name == NOBODY else f" and {self.compare_name}"
        self.say(f"{self._players[0].candidate.label}{against}{more}")
