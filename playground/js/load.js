// Loads what the page is made of; what is missing is one sentence.
import { Policy } from "./policy.js";
import { World } from "./world.js";

async function fetched(name, kind) {
  const answer = await fetch(name).catch(() => null);
  if (!answer?.ok) throw new Error(`The file ${name} is missing next to this page.`);
  return answer[kind]();
}

// The world, the policy and the robot's look of this folder.
export async function load() {
  if (typeof WebAssembly !== "object") throw new Error("This page needs WebAssembly, which this browser does not have.");
  const canvas = document.createElement("canvas");
  if (!canvas.getContext("webgl2")) throw new Error("This page needs WebGL 2, which this browser does not have or has switched off.");
  const [mjcf, robot, look, about, bytes, mujoco, ort] = await Promise.all([
    fetched("robot.xml", "text"), fetched("robot.json", "json"), fetched("look.json", "json"),
    fetched("policy.json", "json"), fetched("policy.onnx", "arrayBuffer"),
    import("../vendor/mujoco/mujoco.js").then((module) => module.default()),
    import("../vendor/onnxruntime/ort.wasm.min.mjs"),
  ]);
  check(robot, about);
  ort.env.wasm.numThreads = 1; // several would need headers of the server
  ort.env.wasm.wasmPaths = new URL("../vendor/onnxruntime/", import.meta.url).href;
  const world = new World(mujoco, mjcf, robot, about);
  const policy = await Policy.load(ort, new Uint8Array(bytes), about);
  const targets = await policy.act((name) => world.read(name)).catch(() => null);
  if (targets?.length !== about.ticks * robot.joints.length)
    throw new Error(`The network policy.onnx does not fit policy.json: it is of another robot than ${robot.robot}.`);
  policy.reset();
  return { world, policy, look };
}

function check(robot, about) {
  const same = robot.joints.length === about.joints.length && robot.joints.every((name, j) => name === about.joints[j]);
  if (robot.robot !== about.robot || !same)
    throw new Error(`The policy is of the robot ${about.robot}, and this page shows ${robot.robot}.`);
}
