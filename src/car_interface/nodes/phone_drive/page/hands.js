// What hands ask for: thumbs on pads, held buttons, held keys. All are released together, and count again only when
// they are touched anew: a finger that stayed where it was has no pointerdown.

// As teleop/keyboard.py: steering's rate, and a push's and a slow push's beginning and rate; a pull is whole at once.
const STEERING_PER_S = 4;
const PUSHES = [["forward", "backward", 0.1, 1, 1.8], ["slowly forward", "slowly backward", 0.05, 0.05, 0.07]];
const KEYS = {a: "left", d: "right", w: "forward", s: "backward", arrowleft: "left", arrowright: "right",
  arrowup: "forward", arrowdown: "backward", e: "slowly forward", c: "slowly backward", "+": "more", "=": "more",
  "-": "less", m: "manual", p: "autonomous"};

const isTyped = (event) => event.target.closest("input, select, dialog");
const clamp = (value) => Math.max(-1, Math.min(1, value));

// One thumb. It rests where it lands, so that a touch alone asks for nothing.
class Pad {
  constructor(element, changed) {
    this.element = element;
    this.knob = element.querySelector(".knob");
    this.changed = changed;
    this.release();
    element.addEventListener("pointerdown", (event) => this.press(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      element.addEventListener(end, (event) => this.end(event));
    }
  }

  press(event) {
    if (this.pointer !== null || event.button > 0) return;
    event.preventDefault();
    try { this.element.setPointerCapture(event.pointerId); } catch { /* it was lifted already: pointerup comes */ }
    this.pointer = event.pointerId;
    this.from = [event.clientX, event.clientY];
    this.element.classList.add("held");
    this.changed(true);
  }

  move(event) {
    if (event.pointerId !== this.pointer) return;
    if (event.pointerType !== "touch" && event.buttons === 0) { this.end(event); return; }
    // Full at a thumb's way: a third of the pad, at most 80 px.
    const reach = Math.min(80, Math.min(this.element.clientWidth, this.element.clientHeight) / 3);
    this.left = clamp((this.from[0] - event.clientX) / reach);
    this.up = clamp((this.from[1] - event.clientY) / reach);
    this.show(reach);
    this.changed(false);
  }

  end(event) {
    if (event.pointerId !== this.pointer) return;
    this.release();
    this.changed(true);
  }

  release() {
    this.pointer = null;
    this.left = this.up = 0;
    this.element.classList.remove("held");
    this.show(0);
  }

  show(reach) {
    const role = this.element.dataset.role;
    const x = role === "throttle" ? 0 : -this.left * reach, y = role === "steering" ? 0 : -this.up * reach;
    this.knob.style.transform = `translate(${x}px, ${y}px)`;
  }
}

export class Hands {
  // pads: elements with data-role steering, throttle or both. buttons: elements by what holding them does: autonomous,
  // more, less. changed(isTouch): called when the controls change; true = what is touched did.
  constructor(pads, buttons, changed) {
    this.changed = changed;
    this.pads = pads.map((element) => new Pad(element, changed));
    this.buttons = buttons;
    this.held = new Map();  // by pointer or key code: what it does
    this.ended = new Set();  // codes of keys that were released together, and may be down still
    this.steering = 0;
    this.push = null;
    for (const [does, element] of Object.entries(buttons)) {
      element.addEventListener("pointerdown", (event) => {
        if (event.button > 0 || element.disabled) return;
        event.preventDefault();
        try { element.setPointerCapture(event.pointerId); } catch { return; }
        this.hold(event.pointerId, does);
      });
      for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
        element.addEventListener(end, (event) => this.let(event.pointerId));
      }
    }
    addEventListener("keydown", (event) => this.keyDown(event));
    addEventListener("keyup", (event) => {
      if (["Meta", "Control", "Alt"].includes(event.key)) this.release();  // keys held with them end unseen
      this.ended.delete(event.code);
      this.let(event.code);
      // Firefox clicks a button that has the focus as the space bar comes up.
      if (event.key === " " && !isTyped(event)) event.preventDefault();
    });
    // No finger touches the screen: whatever pointer is held, its end was lost.
    for (const end of ["touchend", "touchcancel"]) {
      addEventListener(end, (event) => { if (!event.touches.length) this.releasePointers(); });
    }
    for (const lost of ["blur", "pagehide", "orientationchange"]) addEventListener(lost, () => this.release());
    document.addEventListener("visibilitychange", () => this.release());
    document.addEventListener("freeze", () => this.release());
    matchMedia("(orientation: portrait)").addEventListener("change", () => this.release());
  }

  keyDown(event) {
    if (isTyped(event)) return;
    const does = KEYS[event.key.toLowerCase()];
    if (event.key === " " || event.ctrlKey || event.metaKey || event.altKey) {
      if (event.key === " ") event.preventDefault();
      this.release();
    } else if (does) {
      event.preventDefault();
      // Chromium on X11 marks no repeat after 2 s in which another window had the keys.
      if (!event.repeat && !this.ended.has(event.code)) this.hold(event.code, does);
    }
  }

  hold(what, does) {
    this.held.set(what, does);
    this.afterHeld();
  }

  let(what) {
    if (this.held.delete(what)) this.afterHeld();
  }

  afterHeld() {
    const held = new Set(this.held.values());
    for (const [does, element] of Object.entries(this.buttons)) element.classList.toggle("held", held.has(does));
    if (!this.isMoving && this.held.size) {
      this.isMoving = true;
      this.movedMs = performance.now();
      requestAnimationFrame(() => this.moveKeys());
    }
    this.stepKeys();
    this.changed(true);
  }

  // A held key moves its stick from frame to frame.
  moveKeys() {
    this.isMoving = this.held.size > 0;
    if (!this.isMoving) return;
    const before = [this.steering, this.push && this.push.size].join();
    this.stepKeys();
    if ([this.steering, this.push && this.push.size].join() !== before) this.changed(false);
    requestAnimationFrame(() => this.moveKeys());
  }

  stepKeys() {
    const now = performance.now(), elapsedS = Math.min(0.1, (now - (this.movedMs || now)) / 1000);
    const held = new Set(this.held.values()), step = STEERING_PER_S * elapsedS;
    this.movedMs = now;
    if (!held.has("manual") && !held.has("autonomous")) {
      this.steering = 0;
      this.push = null;
      return;
    }
    const target = held.has("left") - held.has("right");
    this.steering = Math.max(this.steering - step, Math.min(this.steering + step, target));
    const pushed = PUSHES.find(([ahead, back]) => held.has(ahead) || held.has(back));
    if (!pushed) { this.push = null; return; }
    const [ahead, back, pushFrom, pullFrom, perS] = pushed;
    const sign = held.has(ahead) - held.has(back), which = `${ahead}${sign}`;
    const size = this.push && this.push.which === which ? Math.min(1, this.push.size + perS * elapsedS)
      : sign > 0 ? pushFrom : pullFrom;
    this.push = {which, sign, size};
  }

  release() {
    for (const what of this.held.keys()) if (typeof what === "string") this.ended.add(what);
    this.held.clear();
    this.releasePointers();
  }

  releasePointers() {
    for (const pad of this.pads) pad.release();
    for (const what of this.held.keys()) if (typeof what === "number") this.held.delete(what);
    this.afterHeld();
  }

  // What an echo tells.
  get controls() {
    const held = new Set(this.held.values());
    const pads = this.pads.filter((pad) => pad.pointer !== null);
    const touch = held.has("autonomous") ? "autonomous" : held.has("manual") || pads.length ? "manual" : "";
    const scale = held.has("more") - held.has("less");
    if (!touch) return {touch, steering: 0, throttle: 0, scale};
    const steers = pads.find((pad) => pad.element.dataset.role !== "throttle");
    const pushes = pads.find((pad) => pad.element.dataset.role !== "steering");
    return {touch, scale, steering: steers ? steers.left : this.steering,
      throttle: pushes ? pushes.up : this.push ? this.push.sign * this.push.size : 0};
  }
}
