// Draws the robot's look with three.js.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoundedBoxGeometry } from "three/addons/geometries/RoundedBoxGeometry.js";

const SPHERE = 2, CAPSULE = 3, ELLIPSOID = 4, CYLINDER = 5, BOX = 6, MESH = 7; // of mjtGeom

export class Scene {
  // look: content of look.json.
  constructor(place, world, look) {
    Object.assign(this, { place, world });
    this.renderer = new THREE.WebGLRenderer({ antialias: true });
    this.renderer.shadowMap.enabled = true;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.canvas = this.renderer.domElement;
    place.prepend(this.canvas);
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color("#dfe7ef");
    this.scene.fog = new THREE.Fog("#dfe7ef", 3, 9);
    this.camera = new THREE.PerspectiveCamera(32, 1, 0.05, 30);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(1.05, -0.85, 0.52);
    this.controls = new OrbitControls(this.camera, this.canvas);
    Object.assign(this.controls, { enablePan: false, minDistance: 0.5, maxDistance: 4, maxPolarAngle: 1.5 });
    this.controls.target.set(0, 0, 0.22);
    this._light();
    this._floor();
    this.bodies = this._robot(look);
    this.arrow = this._arrow();
    new ResizeObserver(() => this._fit()).observe(place);
    this._fit();
  }

  draw() {
    const { xpos: at, xmat: turn, qpos } = this.world.data;
    for (const [body, group] of this.bodies)
      put(group, turn.subarray(9 * body, 9 * body + 9), at.subarray(3 * body, 3 * body + 3));
    const step = new THREE.Vector3(qpos[0], qpos[1], 0.22).sub(this.controls.target).multiplyScalar(0.05);
    this.controls.target.add(step);
    this.camera.position.add(step);
    this.sun.position.set(qpos[0] + 0.6, qpos[1] - 0.8, 2.2);
    this.sun.target.position.set(qpos[0], qpos[1], 0);
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }

  // The body and the place under a point of the canvas [px], or null.
  pick(x, y) {
    const ray = new THREE.Raycaster();
    const [w, h] = [this.canvas.clientWidth, this.canvas.clientHeight];
    ray.setFromCamera(new THREE.Vector2((2 * x) / w - 1, 1 - (2 * y) / h), this.camera);
    this.scene.updateMatrixWorld();
    const [hit] = ray.intersectObjects([...this.bodies.values()], true);
    return hit ? { body: hit.object.userData.body, place: hit.point.toArray() } : null;
  }

  // Level direction of the world for a move on the screen [px]: up is away from the viewer.
  level(dx, dy) {
    const ahead = new THREE.Vector3();
    this.camera.getWorldDirection(ahead).setZ(0).normalize();
    const right = new THREE.Vector3(ahead.y, -ahead.x, 0);
    return right.multiplyScalar(dx).addScaledVector(ahead, -dy).normalize().toArray();
  }

  // An arrow that ends at a place and shows a push of dimensionless size; none without a push.
  show(push) {
    this.arrow.visible = Boolean(push);
    if (!push) return;
    const along = new THREE.Vector3(...push.direction);
    this.arrow.position.set(...push.place).addScaledVector(along, -0.02);
    this.arrow.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), along);
    this.arrow.children[0].scale.set(1, 0.06 + 0.22 * push.impulse, 1);
  }

  // A shaft and a tip along y; the tip ends at 0, the shaft is scaled to its length.
  _arrow() {
    const look = new THREE.MeshBasicMaterial({ color: "#c8372d", depthTest: false, transparent: true });
    const shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.007, 0.007, 1).translate(0, -0.5, 0), look);
    const tip = new THREE.Mesh(new THREE.ConeGeometry(0.02, 0.045, 24).translate(0, -0.0225, 0), look);
    shaft.position.y = -0.04;
    const arrow = new THREE.Group().add(shaft, tip);
    for (const part of arrow.children) part.renderOrder = 1;
    arrow.visible = false;
    this.scene.add(arrow);
    return arrow;
  }

  _light() {
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#aab4be", 1.7));
    this.sun = new THREE.DirectionalLight("#ffffff", 2.2);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    Object.assign(this.sun.shadow.camera, { left: -0.7, right: 0.7, top: 0.7, bottom: -0.7, far: 4 });
    this.sun.shadow.radius = 4;
    this.scene.add(this.sun, this.sun.target);
  }

  _floor() {
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = 128;
    const pen = canvas.getContext("2d");
    pen.fillStyle = "#eef2f6";
    pen.fillRect(0, 0, 128, 128);
    pen.fillStyle = "#e1e7ed";
    pen.fillRect(0, 0, 64, 64);
    pen.fillRect(64, 64, 64, 64);
    const tiles = new THREE.CanvasTexture(canvas);
    tiles.wrapS = tiles.wrapT = THREE.RepeatWrapping;
    tiles.repeat.set(100, 100); // a pair of tiles is 0.2 m
    tiles.colorSpace = THREE.SRGBColorSpace;
    tiles.anisotropy = 8;
    const floor = new THREE.Mesh(new THREE.PlaneGeometry(20, 20), new THREE.MeshStandardMaterial({ map: tiles, roughness: 1 }));
    floor.receiveShadow = true;
    this.scene.add(floor);
  }

  // A group of meshes for each body that has something to show, by its number.
  _robot({ geoms, meshes }) {
    const { mujoco, model } = this.world;
    const shapes = Object.fromEntries(Object.entries(meshes).map(([name, mesh]) => [name, smooth(mesh)]));
    const bodies = new Map();
    for (const { body: name, type, size, color, place, turn, mesh: of } of geoms) {
      const body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY.value, name);
      if (!bodies.has(body)) {
        bodies.set(body, Object.assign(new THREE.Group(), { matrixAutoUpdate: false }));
        this.scene.add(bodies.get(body));
      }
      const material = new THREE.MeshStandardMaterial({ color: new THREE.Color().setRGB(...color, THREE.SRGBColorSpace), roughness: 0.55 });
      const mesh = new THREE.Mesh(type === MESH ? shapes[of] : shape(type, size), material);
      Object.assign(mesh, { castShadow: true, receiveShadow: true, matrixAutoUpdate: false, frustumCulled: false });
      mesh.userData.body = body;
      put(mesh, turn, place);
      bodies.get(body).add(mesh);
    }
    return bodies;
  }

  _fit() {
    const [w, h] = [this.place.clientWidth, this.place.clientHeight];
    this.renderer.setSize(w, h);
    Object.assign(this.camera, { aspect: w / h, fov: w < h ? 36 : 32 });
    this.camera.updateProjectionMatrix();
  }
}

// Turns (row by row) and places an object.
function put(object, m, p) {
  object.matrix.set(m[0], m[1], m[2], p[0], m[3], m[4], m[5], p[1], m[6], m[7], m[8], p[2], 0, 0, 0, 1);
}

function smooth({ vertices, faces }) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.Float32BufferAttribute(vertices, 3));
  geometry.setIndex(faces);
  geometry.computeVertexNormals();
  return geometry;
}

function shape(type, [a, b, c]) {
  switch (type) {
    case SPHERE: return new THREE.SphereGeometry(a, 24, 16);
    case CAPSULE: return new THREE.CapsuleGeometry(a, 2 * b, 8, 20).rotateX(Math.PI / 2);
    case ELLIPSOID: return new THREE.SphereGeometry(1, 24, 16).scale(a, b, c);
    case CYLINDER: return new THREE.CylinderGeometry(a, a, 2 * b, 32).rotateX(Math.PI / 2);
    case BOX: return new RoundedBoxGeometry(2 * a, 2 * b, 2 * c, 3, 0.25 * Math.min(a, b, c));
  }
  throw new Error(`The robot has a geom of type ${type}, which this page does not draw.`);
}
