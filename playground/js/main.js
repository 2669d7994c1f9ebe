// The page: a world in real time, buttons, score.
import { letPush } from "./drag.js";
import { Game } from "./game.js";
import { load } from "./load.js";
import { Scene } from "./scene.js";
import { Script } from "./script.js";
import { NOMINAL } from "./world.js";

const TWIN = { latency: 0.028, torque: 0.7, friction: 0.3 }; // of the switches [s], factor, of the feet
const SIDES = [ // names, and where a push from there goes to [turns to the left of ahead]
  ["front left", 0.625], ["front", 0.5], ["front right", 0.375],
  ["left", 0.75], null, ["right", 0.25],
  ["back left", 0.875], ["back", 0], ["back right", 0.125],
];
const DURATION = 0.1; // of a push [s]
const LATEST = 0.1; // of the clock that is caught up with [s]
const SHOWN = 0.4; // an arrow stays [s]

const find = (id) => document.getElementById(id);

class Page {
  constructor({ world, policy, look }) {
    Object.assign(this, { world, policy, game: new Game(), running: true, busy: Promise.resolve(), clock: null });
    this.scene = new Scene(find("view"), world, look);
    this.script = new Script(world, policy, {
      stop: async () => { this.running = false; await this.busy; },
      go: () => { this.running = true; this.reset(); },
    });
    find("about").textContent = `Policy ${world.about.policy}, ${Math.round(1 / world.about.control_dt_s)} decisions per second, in your browser. ` +
      `Latency, torque and friction are the nominal ones unless switched.`;
    this.buttons = SIDES.map((side) => this._side(side)).filter(Boolean);
    find("size").addEventListener("input", () => this._size());
    find("reset").addEventListener("click", () => this.reset());
    for (const id of Object.keys(TWIN)) find(id).addEventListener("change", () => this.switchTwin());
    letPush(this.scene, find("arrow-size"), { text: (size) => this.text(size), push: (drag) => this.push(drag) });
    this._size();
    this.reset();
    requestAnimationFrame((now) => this._frame(now));
  }

  text(size) {
    return `I = ${size.toFixed(2)}, ${((size * this.world.robot.impulse_unit_ns) / DURATION).toFixed(0)} N`;
  }

  switchTwin() {
    const on = Object.keys(TWIN).filter((id) => find(id).checked);
    this.world.setTwin({ ...NOMINAL, ...Object.fromEntries(on.map((id) => [id, TWIN[id]])) });
    this.game.begin();
    this._score();
  }

  reset() {
    this.world.reset();
    this.policy.reset();
    this.game.begin();
    this._score();
    this.clock = null;
    this._message("");
  }

  // A push at a place of a body, or at the torso.
  push({ impulse, direction, body = null, place = null }) {
    if (this.world.fell) return;
    find("hint").hidden = true;
    this.world.push({ impulse, heading: direction, duration: DURATION, body, place });
    this.game.pushed(impulse, this.world.time);
    const torso = this.world.points.torso;
    this.scene.show({ impulse, direction, place: place ?? Array.from(this.world.data.xipos.slice(3 * torso, 3 * torso + 3)) });
    this.hide = this.world.time + SHOWN;
  }

  // From a side of the robot, as it faces now.
  pushFrom(turn) {
    const [w, x, y, z] = this.world.data.qpos.slice(3, 7);
    const ahead = Math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z));
    const heading = ahead + 2 * Math.PI * turn;
    this.push({ impulse: Number(find("size").value), direction: [Math.cos(heading), Math.sin(heading), 0] });
  }

  _side(side) {
    if (!side) {
      find("compass").append(find("reset")); // in the middle
      return null;
    }
    const button = document.createElement("button");
    button.textContent = side[0];
    button.addEventListener("click", () => this.pushFrom(side[1]));
    find("compass").append(button);
    return button;
  }

  _size() {
    find("size-text").textContent = this.text(Number(find("size").value));
  }

  _score() {
    const { row, record, largest } = this.game;
    find("row").textContent = row;
    find("record").textContent = record;
    find("largest").textContent = largest ? largest.toFixed(2) : "–";
  }

  _message(text, fell = false) {
    find("message").textContent = text;
    find("message").classList.toggle("fell", fell);
    for (const button of this.buttons) button.disabled = fell;
  }

  _frame(now) {
    if (this.running && !this.working) {
      this.working = true;
      this.busy = this._catchUp(now).catch((error) => { this.running = false; tell(error); }).finally(() => { this.working = false; });
    }
    if (this.hide && this.world.time >= this.hide) {
      this.scene.show(null);
      this.hide = null;
    }
    if (this.running) this.scene.draw();
    requestAnimationFrame((next) => this._frame(next));
  }

  async _catchUp(now) {
    const { world, policy } = this;
    this.clock ??= now / 1000 - world.time;
    this.clock = Math.max(this.clock, now / 1000 - world.time - LATEST);
    while (this.running && this.clock !== null && world.time < now / 1000 - this.clock) {
      if (world.substep === 0) {
        const targets = await policy.act((name) => world.read(name));
        if (!this.running || this.clock === null) return; // put up again meanwhile
        world.act(targets);
      }
      world.advance();
    }
    if (this.game.update(world)) this._score();
    if (world.fell && !find("message").textContent) this._message("It fell. Let it stand up again.", true);
  }
}

function tell(error) {
  find("message").textContent = error.message ?? String(error);
  find("hint").hidden = true;
  for (const element of document.querySelectorAll("aside button, aside input")) element.disabled = true;
}

// For scripts: window.zfall.ready, then window.zfall.run({seconds, angles, pushes, twin, record}).
window.zfall = {
  ready: load().then((parts) => {
    const page = new Page(parts);
    Object.assign(window.zfall, { page, run: (trial) => page.script.run(trial) });
  }),
};
window.zfall.ready.catch(tell);
