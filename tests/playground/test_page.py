"""The playground: the robot, pushed in a browser, does what it does in Python."""

import json

import numpy as np
import pytest

from zfall.evaluation.battery import battery_env, run_battery, start_positions
from zfall.evaluation.candidate import load_candidate
from zfall.evaluation.definitions import load_battery
from zfall.evaluation.plans import plan_trials

LATE, WEAK, SLIPPERY = 0.028, 0.7, 0.3  # of the page's switches
HARDER = {  # the same in Python
    "_target_": "zfall.envs.transforms.randomization.DomainRandomization",
    "params": {
        "servo_torque_limit": {"uniform": [WEAK, WEAK]},
        "foot_friction": {"uniform": [SLIPPERY, SLIPPERY]},
    },
}


def test_the_page_loads_from_a_file_server_and_asks_nobody_else(open_page, site):
    page = open_page()
    page.evaluate("zfall.ready")
    page.wait_for_function("zfall.page.world.time > 0.1")
    assert page.said == []
    assert all(url.startswith((site, "data:")) for url, _ in page.asked)
    assert {status for _, status in page.asked} == {200}
    assert page.inner_text("#message") == ""


@pytest.mark.parametrize("width", [400, 1280])
def test_nothing_is_wider_than_the_screen(open_page, width):
    page = open_page(width)
    page.evaluate("zfall.ready")
    assert page.evaluate("document.documentElement.scrollWidth") == width
    assert page.locator("#compass button").count() == 9


@pytest.mark.parametrize("switched", [False, True], ids=["nominal", "switched"])
def test_it_stands_steps_and_falls_as_in_python(open_page, compose_config, switched):
    """Its estimators are part of the network. Two seconds at rest to 1e-4, and 20 pushes."""
    change = list(compose_config("out=here", recipe="playground").change)
    policy, twin = load_candidate("twin", checkpoint="last", change=change), {}
    if switched:
        policy.env_cfg.transforms.latency.delay = [LATE, LATE]
        policy.env_cfg.transforms.physics = HARDER
        policy = policy.keep(["latency", "physics"])
        twin = {"latency": LATE, "torque": WEAK, "friction": SLIPPERY}
    fell = pushed_in_both(open_page(), policy, 20, twin)
    if switched:  # else all are recovered from
        assert 3 <= fell <= 17


@pytest.mark.parametrize(
    "directions", [4, pytest.param(20, marks=pytest.mark.slow)], ids=["few", "all"]
)
@pytest.mark.parametrize("name", ["best", "best_gru"])
def test_other_policies_act_there_as_in_python(open_page, build_site, name, directions):
    """One that reads forces of the feet, and one with hidden states."""
    page = open_page(url=build_site(f"run={name}", "change=[]"))
    pushed_in_both(page, load_candidate(name), directions, {})


def pushed_in_both(page, policy, directions, twin):
    """Pushes of I = 0.5 by page and by Python, of which at least 19 of 20 end the same way.

    Returns how many of them Python's robot fell from.
    """
    battery = load_battery("planar", impulses=[0.5], starts=1, directions=directions)
    env, _, _ = battery_env(battery, policy.env_cfg, 1)
    trials = plan_trials(battery, env.base_env.robot.impulse_unit, 0)
    pushed = trials[trials["impulse"] > 0]
    states = []
    ours = run_battery(
        battery,
        policy.env_cfg,
        policy.actor,
        num_envs=64,
        only=pushed["trial"].tolist(),
        watch=lambda base, td: states.append(base.simulation.qpos[0].numpy().copy()),
    )
    angles = start_positions(battery, pushed, env.base_env)
    page.evaluate("zfall.ready")
    theirs = []
    for start, heading in zip(angles.tolist(), pushed["direction_rad"].tolist(), strict=True):
        push = {"impulse": 0.5, "heading": heading, "start": battery.push_time}
        trial = {"angles": start, "pushes": [push], "seconds": battery.end_time, "twin": twin}
        theirs.append(page.evaluate("trial => zfall.run(trial)", trial | {"record": not theirs}))
    steps = round(2.0 / env.base_env.control_dt)
    there, here = np.array(theirs[0]["states"][:steps]), np.array(states[:steps])
    assert np.abs(here[-1, 7:] - here[0, 7:]).max() > 1e-3  # it does something
    assert np.abs(there - here).max() < 1e-4
    outcomes = [(each["recovered"], each["fell"]) for each in theirs]
    expected = list(zip(ours["recovered"].tolist(), ours["fell"].tolist(), strict=True))
    same = sum(a == b for a, b in zip(outcomes, expected, strict=True))
    assert same >= 0.95 * len(expected)
    seconds = len(expected) * battery.end_time
    assert sum(each["clock_s"] for each in theirs) < seconds  # faster than life
    return int(ours["fell"].sum())


def test_a_drag_on_the_robot_pushes_it_and_one_next_to_it_does_not(open_page):
    """200 px are I = 1, from the left of the screen to its right, at the place that is touched."""
    page = open_page()
    page.evaluate("zfall.ready")
    box = page.locator("#view").bounding_box()
    page.evaluate("""() => {
        zfall.pushed = [];
        const { world, scene } = zfall.page, push = world.push.bind(world);
        world.push = (given) => { zfall.pushed.push({ ...given, right: scene.level(1, 0) }); push(given); };
    }""")
    middle = (box["x"] + box["width"] / 2, box["y"] + 0.45 * box["height"])
    for x, length in ((box["x"] + 10, 5), (middle[0], 60)):
        page.mouse.move(x, middle[1])
        page.mouse.down()
        page.mouse.move(x + length, middle[1], steps=3)
        page.mouse.up()
    (push,) = page.evaluate("zfall.pushed")
    assert push["impulse"] == pytest.approx(0.3)
    assert push["heading"] == pytest.approx(push["right"], abs=0.01)
    assert page.evaluate("zfall.page.world.model.body_mass")[push["body"]] > 0
    assert np.linalg.norm(push["place"][:2]) < 0.2
    assert 0.0 < push["place"][2] < 0.5
    page.wait_for_function("zfall.page.game.row === 1")  # two seconds later it counts


def test_a_push_is_a_force_along_its_direction_of_its_impulse(open_page):
    """J = I m sqrt(g h0), that is 4.92 N s for I = 1, over 0.1 s."""
    page = open_page()
    page.evaluate("zfall.ready")
    force = page.evaluate("""async () => {
        await zfall.page.script.stop();
        zfall.page.world.reset();
        zfall.page.world.push({ impulse: 0.3, heading: [0.6, 0.8, 0] });
        return zfall.page.world.pushes.list.map(({ force }) => force);
    }""")
    assert force == [pytest.approx([0.3 * 49.2 * 0.6, 0.3 * 49.2 * 0.8, 0.0], rel=2e-3)]


def test_the_force_of_a_push_gives_its_impulse_wherever_it_begins(open_page):
    """sum F dt = J, also where it begins and ends within steps of the physics."""
    page = open_page()
    total = page.evaluate("""async () => {
        const { Pushes } = await import("./js/pushes.js");
        const pushes = new Pushes(0.004, 10);
        pushes.add({ start: 0.0371, duration: 0.1, force: [49, 0, -3] });
        const total = [0, 0, 0];
        for (let step = 0; step < 50; step++) {
            for (const { force } of pushes.acting(step % 10)) force.forEach((x, k) => (total[k] += 0.004 * x));
            if (step % 10 === 9) pushes.pass();
        }
        return [...total, pushes.list.length];
    }""")
    assert total == pytest.approx([4.9, 0.0, -0.3, 0])


def test_a_push_counts_two_seconds_after_it_began_unless_the_robot_fell(open_page):
    page = open_page()
    told = page.evaluate("""async () => {
        const { Game } = await import("./js/game.js");
        const game = new Game(), told = [];
        const look = (time, fell) => { game.update({ time, fell }); told.push([game.row, game.record, game.largest]); };
        game.pushed(0.4, 1); game.pushed(0.2, 2);
        look(2.9, false); look(3, false); look(4, false);
        game.pushed(0.9, 4); look(5, true); look(9, true);
        return told;
    }""")
    assert told == [[0, 0, 0], [1, 1, 0.4], [2, 2, 0.4], [0, 2, 0.4], [0, 2, 0.4]]


def other_robot(page):
    def answer(route):
        about = route.fetch().json()
        route.fulfill(body=json.dumps(about | {"robot": "somebody"}))

    page.route("**/policy.json", answer)


@pytest.mark.parametrize(
    ("before", "words"),
    [
        (lambda page: page.add_init_script("delete window.WebAssembly"), "needs WebAssembly"),
        (
            lambda page: page.add_init_script(
                "HTMLCanvasElement.prototype.getContext = () => null"
            ),
            "needs WebGL",
        ),
        (other_robot, "The policy is of the robot somebody, and this page shows zeroth01."),
        (lambda page: page.route("**/robot.json", lambda route: route.abort()), "robot.json is missing"),
    ],
    ids=["webassembly", "webgl", "robot", "file"],
)  # fmt: skip
def test_what_is_missing_is_said_in_one_sentence(open_page, before, words):
    page = open_page(before=before)
    page.wait_for_function("document.querySelector('#message').textContent.includes('page')")
    text = page.inner_text("#message")
    assert words in text
    assert text.count(".") - text.count(".json") == 1
    assert not [line for line in page.said if "Uncaught" in line or line.startswith("error: Error")]
    assert page.locator("#reset").is_disabled()
