// What is done with the car beside driving it: recordings, trim, and the drive that calibrates the steering.

import {$, number, put, showList} from "./view.js";

const CONFIRM_MS = 4000;
const DUTY_STEP = 16;  // one of the servo board's 4096 steps

export class Tools {
  constructor(link) {
    this.link = link;
    this.car = {};
    const evidence = (id, message) => $(id).addEventListener("click", () => link.sendEvidence(message()));
    evidence("record", () => ({type: "record", on: !this.records}));
    this.twice("save", "Press again to change the car's files", () => ({type: "save"}));
    this.twice("calibrate-begin", "Again: replace the table", () => ({type: "calibrate", what: "begin"}));
    evidence("calibrate-finish", () => ({type: "calibrate", what: "finish"}));
    evidence("calibrate-give-up", () => ({type: "calibrate", what: "give up"}));
    for (const name of ["center", "neutral"]) {
      for (const button of $(`trim-${name}`).querySelectorAll("button")) {
        button.addEventListener("click", () => this.trim(name, Math.sign(Number(button.value)) * DUTY_STEP));
      }
    }
  }

  // What a second press within CONFIRM_MS does; the first one asks for it.
  twice(id, question, message) {
    const button = $(id), label = button.textContent;
    let timer = null;
    button.addEventListener("click", () => {
      const isConfirmed = timer !== null;
      clearTimeout(timer);
      timer = isConfirmed ? null : setTimeout(() => { timer = null; put(button, label); }, CONFIRM_MS);
      put(button, isConfirmed ? label : question);
      if (isConfirmed) this.link.sendEvidence(message());
    });
  }

  get records() {
    return ["starting", "on"].includes((this.car.recording || {}).state);
  }

  trim(name, step) {
    const trim = (this.car.trims || {})[name];
    if (!trim) return;
    const value = Math.max(trim.low, Math.min(trim.high, trim.value + step));
    this.link.sendEvidence({type: "trim", name, value: Math.round(value)});
  }

  show(car, isMine) {
    this.car = car;
    const recording = car.recording || {state: "off", text: ""};
    put($("record"), this.records ? "End the recording" : "Begin a recording");
    $("record").disabled = !isMine || !car.recording || ["closing", "report"].includes(recording.state);
    put($("recording-text"), this.records && Number.isFinite(recording.age)
      ? `${number(recording.age, 0)} s, ${number(recording.size, 1)} MB. ${recording.text}` : recording.text || "");
    showList($("recordings"), car.recordings || [], (one) => this.row(one));
    const trims = car.trims || {};
    for (const name of ["center", "neutral"]) {
      const trim = trims[name], box = $(`trim-${name}`);
      put(box.querySelector("output"), trim ? `${trim.value}` : "–");
      for (const button of box.querySelectorAll("button")) {
        button.disabled = !isMine || !trim || (button.value < 0 ? trim.value <= trim.low : trim.value >= trim.high);
      }
    }
    $("save").disabled = !isMine || !(trims.center || trims.neutral);
    this.showCalibration(car.calibration || {state: "off"}, isMine && Boolean(car.calibration));
  }

  showCalibration({state, text, fraction, known, missing, driven, left}, isPossible) {
    const isOn = ["starting", "on"].includes(state);
    const times = isOn && Number.isFinite(left) ? ` ${number(driven, 0)} s driven, ${number(left, 0)} s left.` : "";
    put($("calibration-text"), (text || "In a free area the car drives circles by itself while you hold the planner's "
      + "button. The steering's table is replaced; the old one is kept beside it.") + times);
    $("calibration-progress").value = fraction || 0;
    $("calibrate-begin").disabled = !isPossible || isOn;
    $("calibrate-finish").disabled = $("calibrate-give-up").disabled = !isPossible || !isOn;
    showList($("calibration-known"), [...(known || []), ...(missing || [])], (line) => {
      const item = document.createElement("li");
      put(item, line);
      return item;
    });
  }

  row({name, size, report}) {
    const item = document.createElement("li");
    put(item.appendChild(document.createElement("span")), `${name.replace(/\.bag$/, "")}, ${number(size, 1)} MB`);
    for (const [label, file] of [["report", report], ["bag", name]]) {
      const button = item.appendChild(document.createElement("button"));
      put(button, label);
      button.disabled = !file;
      button.addEventListener("click", () => this.link.send({type: "open", name: file}));
    }
    return item;
  }

  // Get a file that the car has made ready: a report in a tab of its own, a recording to be saved.
  fetch(path) {
    const anchor = document.createElement("a");
    anchor.href = path;
    if (path.endsWith(".html")) {
      anchor.target = "_blank";
      anchor.rel = "noopener";
    } else {
      anchor.download = "";
    }
    anchor.click();
  }
}
