// The robot in MuJoCo: sub-steps, pushes, late commands and quantities, as zfall has them in Python.
// Knows no page: it runs in node as well.
import { Pushes } from "./pushes.js";

const KEPT = 1000; // control steps whose targets are kept for late commands, at least

export const NOMINAL = { latency: 0, torque: 1, friction: null }; // [s], factor, of the feet

const float32 = Math.fround;
const dot = (matrix, vector) =>
  [0, 1, 2].map((i) => [0, 1, 2].reduce((sum, j) => sum + matrix[3 * i + j] * vector[j], 0));

// A vector of the world in the axes of a body that a quaternion (w, x, y, z) turns.
function turnedBack([w, a, b, c], [x, y, z]) {
  const [u, v, n] = [2 * (b * z - c * y), 2 * (c * x - a * z), 2 * (a * y - b * x)];
  return [x - w * u + (b * n - c * v), y - w * v + (c * u - a * n), z - w * n + (a * v - b * u)];
}

export class World {
  // mujoco: the loaded module; mjcf: text; robot, about: contents of robot.json and policy.json.
  constructor(mujoco, mjcf, robot, about) {
    Object.assign(this, { mujoco, robot, about });
    this.model = mujoco.MjModel.from_xml_string(mjcf);
    this.data = new mujoco.MjData(this.model);
    for (const [name, values] of Object.entries(robot.fields)) this.model[name].set(values);
    mujoco.mj_setConst(this.model, this.data);
    this.substeps = Math.round(about.control_dt_s / about.physics_dt_s);
    this.dt = about.physics_dt_s;
    this.model.opt.timestep = this.dt;
    const find = (kind, name) => mujoco.mj_name2id(this.model, mujoco.mjtObj[kind].value, name);
    const joints = robot.joints.map((name) => find("mjOBJ_JOINT", name));
    this.at = {
      qpos: joints.map((j) => this.model.jnt_qposadr[j]),
      qvel: joints.map((j) => this.model.jnt_dofadr[j]),
      ctrl: robot.joints.map((name) => find("mjOBJ_ACTUATOR", name)),
      soles: robot.soles.map((name) => find("mjOBJ_SITE", name)),
    };
    this.sensors = {};
    for (let i = 0; i < this.model.nsensor; i++) {
      const name = mujoco.mj_id2name(this.model, mujoco.mjtObj.mjOBJ_SENSOR.value, i);
      const start = this.model.sensor_adr[i];
      this.sensors[name] = [start, start + this.model.sensor_dim[i]];
    }
    this.points = Object.fromEntries(
      Object.entries(robot.push_points).map(([name, body]) => [name, find("mjOBJ_BODY", body)]),
    );
    this.limits = Array.from(this.model.actuator_forcerange);
    this.friction = this.model.geom_friction[3 * robot.foot_geoms[0]];
    this.reference = about.reference_rad.map(float32);
    this.setTwin(NOMINAL);
    this.reset();
  }

  // latency of the commands [s], factor on the largest torque, sliding friction of the feet.
  setTwin({ latency, torque, friction }) {
    this.twin = { latency, torque, friction };
    this.lag = Math.round(latency / this.dt);
    this.model.actuator_forcerange.set(this.limits.map((limit) => limit * torque));
    for (const geom of this.robot.foot_geoms)
      this.model.geom_friction[3 * geom] = friction ?? this.friction;
  }

  // Soles on the floor, joints in the reference pose or at angles [rad].
  reset(angles = null) {
    const { mujoco, model, data, at } = this;
    mujoco.mj_resetDataKeyframe(model, data, 0); // stand
    data.ctrl.fill(0);
    at.ctrl.forEach((actuator, j) => (data.ctrl[actuator] = this.reference[j]));
    if (angles) {
      at.qpos.forEach((place, j) => (data.qpos[place] = float32(angles[j])));
      mujoco.mj_kinematics(model, data);
      const lowest = at.soles.map((site) => {
        const [length, width] = this.robot.sole_half_size_m;
        const up = data.site_xmat.slice(9 * site + 6, 9 * site + 8).map(Math.abs);
        return data.site_xpos[3 * site + 2] - up[0] * length - up[1] * width;
      });
      data.qpos[2] -= Math.min(...lowest);
    }
    mujoco.mj_forward(model, data);
    this.felt = this.sensor("base_acceleration");
    this.start = at.qpos.map((place) => float32(data.qpos[place])); // commands before the first
    this.commands = []; // targets of the ticks of the control steps
    this.forgotten = 0; // of them, from the first
    this.pushes = new Pushes(this.dt, this.substeps);
    Object.assign(this, { time: 0, substep: 0, fell: false, fallTime: null });
  }

  // A push of dimensionless size that begins in `start` seconds. heading: 0 forward, pi/2 to the
  // left; or a unit vector of the world. The body, at its center of mass, is a push point, or any
  // with a place [world] where it acts.
  push({ impulse, heading, duration = 0.1, start = 0, point = "torso", body = null, place = null }) {
    const unit = Array.isArray(heading) ? heading : [Math.cos(heading), Math.sin(heading), 0];
    const newtons = (impulse * this.robot.impulse_unit_ns) / duration;
    const acting = body ?? this.points[point];
    const arm = place && this._inBody(acting, place);
    this.pushes.add({ start: start + this.substep * this.dt, duration, body: acting, arm, impulse,
      force: unit.map((share) => float32(newtons * share)) });
    return newtons;
  }

  // Gives the servos the targets of the ticks of a control step [rad], one after the other; to be called before the first of S
  // sub-steps.
  act(targets) {
    const joints = this.reference.length;
    const ticks = Array.from({ length: targets.length / joints }, (_, k) => Array.from(targets.slice(k * joints, (k + 1) * joints)));
    this.commands.push(ticks);
    if (this.commands.length > 2 * KEPT) this.forgotten += this.commands.splice(0, KEPT).length;
    this.data.qacc_warmstart.fill(0); // as in Python: a step depends on the state alone
  }

  // One step of the physics.
  advance() {
    const { mujoco, model, data } = this;
    const newest = this.forgotten + this.commands.length - 1;
    const since = newest * this.substeps + this.substep - this.lag;
    const step = Math.floor(since / this.substeps);
    const ticks = step < 0 ? [this.start] : this.commands[step - this.forgotten];
    const command = ticks[Math.floor(((since - step * this.substeps) * ticks.length) / this.substeps)];
    this.at.ctrl.forEach((actuator, j) => (data.ctrl[actuator] = command[j]));
    data.xfrc_applied.fill(0);
    for (const { body, force, arm } of this.pushes.acting(this.substep)) {
      const torque = arm ? this._torque(body, arm, force) : [0, 0, 0];
      [...force, ...torque].forEach((value, k) => (data.xfrc_applied[6 * body + k] += value));
    }
    mujoco.mj_step(model, data);
    this.time += this.dt;
    if (this.substep === 0) this.felt = [0, 0, 0];
    this.sensor("base_acceleration").forEach((x, k) => (this.felt[k] += x / this.substeps));
    if (!this.fell && this._touched()) Object.assign(this, { fell: true, fallTime: this.time });
    this.substep = (this.substep + 1) % this.substeps;
    if (this.substep === 0) this.pushes.pass();
  }

  // Whether it stands: not fallen, upright and high enough, by the bounds of a battery.
  get standing() {
    const { max_tilt_rad: tilt, min_height: height } = this.robot.standing;
    const [, x, y] = this.data.qpos.slice(3, 6);
    const upright = 1 - 2 * (x * x + y * y) > Math.cos(tilt);
    return !this.fell && upright && this.sensor("com_position")[2] > height * this.robot.com_height_m;
  }

  sensor(name) {
    return Array.from(this.data.sensordata.slice(...this.sensors[name]));
  }

  // A quantity by its name: positions and velocities are new, those of sensors a sub-step old.
  read(name) {
    const { qpos, qvel } = this.data;
    const feet = (key) => this.robot.feet.flatMap((foot) => this.sensor(`${key}/${foot}`));
    const contacts = this.robot.feet.map((foot) => this.sensor(`feet_contact/${foot}`));
    switch (name) {
      case "projected_gravity": return turnedBack(qpos.slice(3, 7), [0, 0, -1]);
      case "base_position": return Array.from(qpos.slice(0, 3));
      case "base_orientation": return Array.from(qpos.slice(3, 7));
      case "imu_orientation": return Array.from(qpos.slice(3, 7), (x) => (qpos[3] < 0 ? -x : x));
      case "base_linear_velocity": return Array.from(qvel.slice(0, 3));
      case "base_angular_velocity": return Array.from(qvel.slice(3, 6));
      case "joint_position": return this.at.qpos.map((place) => qpos[place]);
      case "joint_velocity": return this.at.qvel.map((place) => qvel[place]);
      case "base_acceleration": return Array.from(this.felt); // mean over the control step
      case "command": return [0, 0, 0, 0, 0, 0];
      case "feet_contact": return contacts.map((contact) => (contact[0] > 0 ? 1 : 0));
      case "feet_force": return contacts.flatMap((contact) => contact.slice(1, 4).map((x) => -x));
      case "feet_position":
      case "feet_velocity":
      case "feet_orientation": return feet(name);
      case "com_position":
      case "com_velocity":
      case "angular_momentum": return this.sensor(name);
    }
    throw new Error(`The policy reads ${name}, which this page does not know.`);
  }

  _touched() {
    const values = this.data.sensordata;
    return this.robot.falls.some((name) => {
      const [start, end] = this.sensors[name];
      return values.slice(start, end).some((force) => force !== 0);
    });
  }

  // A place of the world in the axes of a body, from its center of mass.
  _inBody(body, place) {
    const turn = this.data.ximat.slice(9 * body, 9 * body + 9);
    const arm = place.map((x, k) => x - this.data.xipos[3 * body + k]);
    return [0, 1, 2].map((i) => [0, 1, 2].reduce((sum, j) => sum + turn[3 * j + i] * arm[j], 0));
  }

  _torque(body, arm, [x, y, z]) {
    const [a, b, c] = dot(this.data.ximat.slice(9 * body, 9 * body + 9), arm);
    return [b * z - c * y, c * x - a * z, a * y - b * x];
  }
}
