// Pushes as zfall has them: a force that holds for a duration, exact at any rate of the physics.

export class Pushes {
  // dt: physics step [s]; substeps: of a control step.
  constructor(dt, substeps) {
    Object.assign(this, { dt, substeps, list: [] });
  }

  // start: from the beginning of the control step now in progress [s].
  add(push) {
    this.list.push(push);
  }

  // Mean forces over a sub-step, of the pushes that act in it.
  acting(substep) {
    const [begin, end] = [substep * this.dt, (substep + 1) * this.dt];
    return this.list.flatMap((push) => {
      const given = (time) => Math.min(Math.max((time - push.start) / push.duration, 0), 1);
      const share = ((given(end) - given(begin)) * push.duration) / this.dt;
      return share > 0 ? [{ ...push, force: push.force.map((x) => share * x) }] : [];
    });
  }

  // A control step is over.
  pass() {
    for (const push of this.list) push.start -= this.substeps * this.dt;
    this.list = this.list.filter((push) => push.start + push.duration > 0);
  }
}
