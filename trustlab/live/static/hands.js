// Who drives: hands on keyboard, gamepad, mouse or finger.
import { clamp, gamepad, keepKeys, stick } from "./page.js";

const KEYS = {
  ArrowUp: [0, 1],
  KeyW: [0, 1],
  ArrowDown: [0, -1],
  KeyS: [0, -1],
  ArrowLeft: [1, 1],
  KeyA: [1, 1],
  ArrowRight: [1, -1],
  KeyD: [1, -1],
};

// The hands on keyboard, gamepad, mouse or finger; whichever was used last drives.
export class Hands {
  constructor(root, ramp, onBlur, signal) {
    this.down = new Set();
    this.levers = [0, 0];
    this.ramp = ramp;
    this.pointer = null;
    this.source = "keyboard";
    this.toggles = 0;
    keepKeys(root);
    const listen = (target, type, act) => target.addEventListener(type, act, { signal });
    listen(root, "keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey || event.code === "Tab") return;
      // A notebook has shortcuts of its own: an x beside the keys would cut the cell
      event.stopPropagation();
      if (event.code === "Space") this.toggles += event.repeat ? 0 : 1;
      else if (event.code in KEYS) {
        this.down.add(event.code);
        this.source = "keyboard";
      } else return;
      event.preventDefault();
    });
    listen(root, "keyup", (event) => {
      this.down.delete(event.code);
      event.stopPropagation();
    });
    listen(root, "blur", (event) => {
      if (root.contains(event.relatedTarget)) return; // its own button
      this.clear();
      onBlur();
    });
    listen(root, "pointerdown", (event) => {
      if (event.target.closest("button")) return;
      root.focus({ preventScroll: true });
      this.pointer = {
        id: event.pointerId,
        x: event.clientX,
        y: event.clientY,
        forward: 0,
        left: 0,
      };
      this.source = "pointer";
    });
    listen(window, "pointermove", (event) => {
      if (this.pointer?.id !== event.pointerId) return;
      this.pointer.forward = clamp((this.pointer.y - event.clientY) / 80, -1, 1);
      this.pointer.left = clamp((this.pointer.x - event.clientX) / 80, -1, 1);
    });
    for (const type of ["pointerup", "pointercancel"])
      listen(window, type, (event) => {
        if (this.pointer?.id === event.pointerId) this.pointer = null;
      });
  }

  clear() {
    this.down.clear();
    this.pointer = null;
    this.levers = [0, 0];
  }

  // Where forward and left stand now, each in [−1, 1]; one call per sample.
  read(seconds) {
    const pad = gamepad(),
      [right, forward] = stick(pad),
      pressed = pad?.buttons[0]?.pressed ?? false;
    if (right || forward) this.source = "gamepad";
    if (pressed && !this.pressed) this.toggles += 1;
    this.pressed = pressed;
    if (pad && this.source === "gamepad") return [forward, -right];
    if (this.source === "pointer")
      return this.pointer ? [this.pointer.forward, this.pointer.left] : [0, 0];
    const wanted = [0, 0];
    for (const code of this.down) wanted[KEYS[code][0]] += KEYS[code][1];
    this.levers = this.levers.map((now, i) => {
      const want = clamp(wanted[i], -1, 1);
      const most = (Math.abs(want) > Math.abs(now) ? this.ramp.rise : this.ramp.fall) * seconds;
      return now + clamp(want - now, -most, most);
    });
    return this.levers;
  }
}
