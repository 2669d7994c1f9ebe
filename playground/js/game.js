// The score: a push is withstood if the robot still stands two seconds after it began.

const AFTER = 2; // [s]

export class Game {
  constructor() {
    Object.assign(this, { row: 0, record: 0, largest: 0, open: [] });
  }

  // A push of dimensionless size begins at a time [s].
  pushed(impulse, time) {
    this.open.push({ impulse, time });
  }

  // Looks at the world; whether the score has changed.
  update({ time, fell }) {
    if (fell) {
      const had = this.row + this.open.length;
      Object.assign(this, { row: 0, open: [] });
      return had > 0;
    }
    const over = this.open.filter((push) => time >= push.time + AFTER - 1e-9);
    this.open = this.open.filter((push) => !over.includes(push));
    this.row += over.length;
    this.record = Math.max(this.record, this.row);
    this.largest = Math.max(this.largest, ...over.map((push) => push.impulse));
    return over.length > 0;
  }

  // The robot is put up again, or another world begins.
  begin() {
    Object.assign(this, { row: 0, open: [] });
  }
}
