// The exported policy: from what sensors measure and its states to the targets of the servos.

// Shape of nested lists, and their numbers in a row.
const shapeOf = (value) => (Array.isArray(value) ? [value.length, ...shapeOf(value[0])] : []);

export class Policy {
  // ort: onnxruntime-web; session: of policy.onnx; about: content of policy.json.
  constructor(ort, session, about) {
    Object.assign(this, { ort, session, about });
    this.reset();
  }

  static async load(ort, bytes, about) {
    const session = await ort.InferenceSession.create(bytes, { executionProviders: ["wasm"] });
    return new Policy(ort, session, about);
  }

  reset() {
    this.states = Object.fromEntries(
      Object.entries(this.about.states).map(([name, start]) => [name, this._tensor([start].flat(Infinity), shapeOf(start))]),
    );
    this.begin = true;
  }

  // The targets of the K ticks of a control step, one after the other [rad]; read: a sensor by its name.
  async act(read) {
    const { states, begin } = this; // others after a reset meanwhile
    const sensors = this.about.sensors.map(({ name, size }) => [name, this._tensor(read(name), [1, size])]);
    this.begin = false;
    const inputs = { begin: this._tensor([Number(begin)], [1, 1]), ...Object.fromEntries(sensors), ...states };
    const out = await this.session.run(inputs);
    for (const name of Object.keys(states)) states[name] = out[`next_${name}`];
    return out.command.data;
  }

  _tensor(values, shape) {
    return new this.ort.Tensor("float32", Float32Array.from(values), shape);
  }
}
