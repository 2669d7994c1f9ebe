// A drag that begins on the robot draws a push: where it begins, where to, and how hard.

const FULL = 200; // length of a drag of size 1 [px]
const LEAST = 0.05, MOST = 1; // sizes

export function letPush(scene, label, { text, push }) {
  let drag = null;
  const { canvas } = scene;
  const at = (event) => {
    const box = canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  };
  const end = (event) => {
    if (!drag || event.pointerId !== drag.pointer) return;
    if (event.type === "pointerup" && drag.impulse >= LEAST) push(drag);
    else scene.show(null);
    drag = null;
    label.hidden = true;
    scene.controls.enabled = true;
  };
  canvas.addEventListener("pointerdown", (event) => {
    const hit = drag ? null : scene.pick(...at(event));
    if (!hit) return;
    drag = { ...hit, pointer: event.pointerId, from: at(event), impulse: 0 };
    scene.controls.enabled = false;
    canvas.setPointerCapture(event.pointerId);
    event.stopImmediatePropagation();
  }, { capture: true });
  canvas.addEventListener("pointermove", (event) => {
    if (!drag || event.pointerId !== drag.pointer) return;
    const [x, y] = at(event), [dx, dy] = [x - drag.from[0], y - drag.from[1]];
    drag.impulse = Math.min(Math.hypot(dx, dy) / FULL, MOST);
    drag.direction = scene.level(dx, dy);
    const large = drag.impulse >= LEAST;
    scene.show(large ? drag : null);
    Object.assign(label, { hidden: !large, textContent: text(drag.impulse) });
    Object.assign(label.style, { left: `${x}px`, top: `${y}px` });
  });
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
}
