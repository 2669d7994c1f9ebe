// The exported network with its memories.

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
    this.memories = Object.fromEntries(
      Object.entries(this.about.memories).map(([name, shape]) => {
        const size = shape.reduce((product, n) => product * n, 1);
        return [name, new this.ort.Tensor("float32", new Float32Array(size), shape)];
      }),
    );
  }

  async act(observation) {
    const { memories } = this; // others after a reset meanwhile
    const input = new this.ort.Tensor("float32", observation, [1, observation.length]);
    const out = await this.session.run({ observation: input, ...memories });
    for (const name of Object.keys(memories)) memories[name] = out[`next_${name}`];
    return out.action.data;
  }
}
