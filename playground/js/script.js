// window.zfall: the page's world under a script's control, faster than real time.

import { NOMINAL } from "./world.js";

export class Script {
  // stop: called before, go: after a run.
  constructor(world, policy, { stop, go }) {
    Object.assign(this, { world, policy, stop, go, last: Promise.resolve() });
  }

  // Runs a trial once those before are over, and tells how it ended.
  run(trial) {
    const result = this.last.then(() => this._run(trial));
    this.last = result.catch(() => null);
    return result;
  }

  // From a reset:
  //   seconds: its length; angles: of the joints at the start [rad], the reference pose without;
  //   pushes: of World.push, start counted from the reset [s]; twin: what differs from NOMINAL;
  //   record: whether qpos after every control step is wanted.
  // Gives {fell, recovered, fall_time_s, seconds of the clock, states}.
  async _run({ seconds = 7, angles = null, pushes = [], twin = {}, record = false } = {}) {
    const { world, policy } = this;
    const begun = performance.now();
    await this.stop();
    const before = world.twin;
    const states = [];
    try {
      world.setTwin({ ...NOMINAL, ...twin });
      world.reset(angles);
      policy.reset();
      for (const push of pushes) world.push(push);
      const steps = Math.round(seconds / world.about.control_dt_s);
      for (let step = 0; step < steps; step++) {
        world.act(await policy.act((name) => world.read(name)));
        for (let s = 0; s < world.substeps; s++) world.advance();
        if (record) states.push(Array.from(world.data.qpos));
      }
      return { fell: world.fell, recovered: world.standing, fall_time_s: world.fallTime,
        clock_s: (performance.now() - begun) / 1000, states };
    } finally {
      world.setTwin(before);
      world.reset();
      policy.reset();
      this.go();
    }
  }
}
