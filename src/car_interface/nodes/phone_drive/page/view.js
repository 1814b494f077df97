// Shows what the car reports: the groups of teleop/phone_messages.py. Each text goes in as text; nothing that arrives
// becomes markup. A number that isn't known is a dash.

const SVG = "http://www.w3.org/2000/svg";
const SHOWN_M = 1.2;  // of a sonar's range: twice the car's length, so that the car stays large
const NEAR_M = 0.3, MID_M = 0.7;
const STALE_S = 1;  // a sonar's report
const WORDS = [["who", "deadman"], ["throttle", "throttle"], ["steering", "steering"], ["planner", "planner"],
  ["esc", "ESC"], ["board", "board"], ["teensy", "Teensy"], ["battery", "battery"], ["worst", "worst of all"]];

export const $ = (id) => document.getElementById(id);

// Change a text only where it differs: a page that is laid out anew 5 times a second costs a phone's battery.
export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function putClass(element, text) {
  if (element.getAttribute("class") !== text) element.setAttribute("class", text);
}

export const number = (value, digits = 2) => Number.isFinite(value) ? value.toFixed(digits).replace("-", "−") : "–";

export function showState(kind, who, why) {
  putClass($("state"), kind);
  put($("who"), who);
  put($("why"), why);
}

// Show all groups of the car's state; car: group by name.
export function showCar(car, status) {
  const throttle = car.throttle || {}, steering = car.steering || {};
  put($("speed-value"), number(car.speed, 1));
  showBar("throttle", throttle, 1);
  showBar("steering", steering, -1);  // left is positive, and left of the middle
  const limits = [throttle, steering].filter((one) => one.limit).map((one) => one.limit_text).join("; ");
  put($("limit"), limits || (car.worst && car.worst.level ? car.worst.text : ""));
  put($("scale"), Number.isFinite(throttle.scale) ? `× ${number(throttle.scale, 2)}` : "–");
  showChips(car, status);
  showWords(car);
}

function showBar(name, {asked, granted}, sign) {
  const halfPx = $(`${name}-asked`).parentElement.clientWidth / 2;
  $(`${name}-granted`).style.transform = `scaleX(${sign * (granted || 0)})`;
  $(`${name}-asked`).style.transform = `translateX(${sign * (asked || 0) * halfPx}px)`;
  put($(`${name}-value`), number(granted));
}

function showChips(car, status) {
  const esc = car.esc || {}, battery = car.battery || {};
  const volts = /[\d.]+ V/.exec(battery.text || "");
  showChip("esc", esc.state ? esc.state.toLowerCase() : "ESC", esc.state ? 0 : null);
  showChip("board", "board", (car.board || {level: null}).level);
  showChip("teensy", "Teensy", (car.teensy || {level: null}).level);
  showChip("battery", volts ? volts[0] : "battery", volts ? battery.level : null);
  const delay = status && status.delay;
  showChip("link", Number.isFinite(delay) ? `${Math.round(1000 * delay)} ms` : "link",
    Number.isFinite(delay) ? (delay < 0.15 ? 0 : delay < 0.25 ? 1 : 2) : null);
}

function showChip(name, text, level) {
  put($(`chip-${name}`), text);
  putClass($(`chip-${name}`), level === null || level === undefined ? "unknown" : `level${level}`);
}

function showWords(car) {
  const list = $("words");
  if (!list.children.length) {
    for (const [, label] of WORDS) {
      put(list.appendChild(document.createElement("dt")), label);
      list.append(document.createElement("dd"));
    }
  }
  WORDS.forEach(([name], index) => {
    const group = car[name], element = list.children[2 * index + 1];
    put(element, group ? [group.text, group.remedy].filter(Boolean).join(". ") || "fine" : "–");
    putClass(element, group && group.level ? `level${group.level}` : "");
  });
}

// Make a list's items those of ``texts``, each an element by ``make(text)``; only where they changed.
export function showList(list, texts, make) {
  const key = JSON.stringify(texts);
  if (list.dataset.key === key) return;
  list.dataset.key = key;
  list.replaceChildren(...texts.map(make));
}

function draw(kind, attributes, parent) {
  const element = document.createElementNS(SVG, kind);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  parent.append(element);
  return element;
}

// The sector of a sonar: the car's x, ahead, is up in the picture, and its y, to the left, is left.
function sector(x, y, yaw, opening, range) {
  const end = (angle) => `${(-y - range * Math.sin(angle)).toFixed(3)} ${(-x - range * Math.cos(angle)).toFixed(3)}`;
  return `M${-y} ${-x}L${end(yaw - opening / 2)}A${range} ${range} 0 0 0 ${end(yaw + opening / 2)}Z`;
}

// The car and what its sonars see, to scale.
export class Around {
  constructor(svg) {
    this.svg = svg;
    this.key = "";
    this.sonars = {};
    svg.setAttribute("viewBox", `-1.1 ${-0.5 - SHOWN_M} 2.2 ${0.8 + 2 * SHOWN_M}`);
  }

  show(layout, sonars) {
    if (!layout) return;
    const key = JSON.stringify(layout);
    if (key !== this.key) {
      this.key = key;
      this.lay(layout);
    }
    for (const [name, [x, y, yaw]] of Object.entries(layout.sonars)) {
      const [reported, age] = (sonars || {})[name] || [null, null];
      const isKnown = reported !== null && age !== null && age <= STALE_S;
      const range = reported === "-inf" ? 0 : reported === "inf" ? Infinity : reported;
      const isFree = isKnown && range > SHOWN_M;
      putClass(this.sonars[name], !isKnown ? "unknown" : isFree ? "free" : range < NEAR_M ? "near"
        : range < MID_M ? "mid" : "far");
      this.sonars[name].setAttribute("d", sector(x, y, yaw, layout.field_of_view,
        isKnown && !isFree ? Math.max(range, 0.06) : SHOWN_M));
    }
  }

  lay({sonars, front, rear, width}) {
    this.svg.replaceChildren();
    for (const metres of [0.5, 1]) {  // away from the car
      draw("rect", {class: "ring", x: -width / 2 - metres, y: -front - metres, width: width + 2 * metres,
        height: front + rear + 2 * metres, rx: metres}, this.svg);
    }
    for (const name of Object.keys(sonars)) this.sonars[name] = draw("path", {}, this.svg);
    const w = width / 2, inner = 0.6 * w;
    for (const [x, side] of [[0, 1], [0, -1], [front - rear + 0.04, 1], [front - rear + 0.04, -1]]) {
      draw("rect", {class: "wheel", x: side * (w - 0.03) - 0.03, y: -x - 0.05, width: 0.06, height: 0.1, rx: 0.02},
        this.svg);
    }
    draw("path", {class: "body", d: `M${-inner} ${rear}L${-w * 0.75} ${-front * 0.6}L${-inner} ${-front}H${inner}`
      + `L${w * 0.75} ${-front * 0.6}L${inner} ${rear}Z`}, this.svg);
  }
}
