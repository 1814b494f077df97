// The page: what a person does goes to the car, what the car reports is shown. Who may, who drives, and whether a touch
// counts is decided by the car.

import {Hands} from "./hands.js";
import {Link} from "./link.js";
import {Tools} from "./tools.js";
import {$, Around, put, showCar, showState} from "./view.js";

const MIN_PERIOD_MS = 10;  // between two echoes of a moving thumb: the car takes 150 messages a second
const CONFIRMED_MS = 1000;
const ANSWER_MS = 4000;  // an answer is shown
const PIN_TEXT = "It is in the terminal in which the car was started.";

const around = new Around($("around"));
let status = null;
let car = {};
let answer = {text: "", isRefusal: false, atMs: -ANSWER_MS};
let sentMs = 0;
let isDue = false;

const link = new Link({
  token() { if (document.visibilityState === "visible") echo(); },  // a page that nobody sees keeps no seat
  admitted() { $("gate").close(); keepAwake(); show(); },
  lost() { status = null; hands.release(); buzz(300); show(); },
  status(newest) {
    const before = status;
    status = newest;
    if (before && (newest.e_stop && !before.e_stop || newest.why && !before.why)) buzz(newest.e_stop ? 600 : 200);
    show();
  },
  refused(why, wasAdmitted) { wasAdmitted ? note(why, true) : openGate(why === "enter the PIN" ? PIN_TEXT : why); },
  closed(why) { why === "replaced" ? openGate("This page was opened elsewhere.") : note(why, true); },
  other(message) {
    if ("car" in message) Object.assign(car, message.car);
    if ("done" in message) note(message.done, false);
    if ("file" in message) tools.fetch(message.file);
    if ("car" in message) show();
  },
});
const tools = new Tools(link);
const hands = new Hands([$("pad-left"), $("pad-right")],
  {autonomous: $("autonomous"), more: $("more"), less: $("less")}, (isTouch) => {
    if (isTouch || performance.now() - sentMs >= MIN_PERIOD_MS) {
      echo();
    } else if (!isDue) {
      isDue = true;
      setTimeout(() => { isDue = false; echo(); }, MIN_PERIOD_MS);
    }
    if (isTouch) show();
  });

// --- to the car ---

function isMine() {
  return link.isAdmitted && status !== null && status.driver === "you";
}

function echo() {
  sentMs = performance.now();
  link.sendEvidence({type: "echo", ...hands.controls});
}

// Ask for what the car drops without an answer where the token came back too late.
function ask(type, isDone) {
  const askedMs = performance.now();
  link.sendEvidence({type});
  setTimeout(() => {
    if (!isDone() && link.isAdmitted && answer.atMs < askedMs) note("The network is too slow: press again.", true);
  }, CONFIRMED_MS);
}

function stop() {
  hands.release();
  link.stop();
  show();
}

$("seat").addEventListener("click", () => {
  hands.release();
  if (status && status.guest) openGate(PIN_TEXT);
  else if (isMine()) link.send({type: "leave"});
  else ask("drive", isMine);
  $("seat").blur();  // its key, space, lets go of everything
});
$("stop").addEventListener("pointerdown", stop);
$("stop").addEventListener("click", (event) => { if (event.detail === 0) stop(); });  // by Enter
$("clear").addEventListener("click", () => ask("clear", () => !link.stopShown));
addEventListener("keydown", (event) => { if (event.key === "Escape" && !$("gate").open) stop(); });
addEventListener("contextmenu", (event) => event.preventDefault());

// --- what is shown ---

function note(text, isRefusal) {
  answer = {text, isRefusal, atMs: performance.now()};
  show();
}

function show() {
  const mine = isMine(), isStopped = link.stopWanted || link.stopShown;
  document.body.classList.toggle("mine", mine);
  document.body.classList.toggle("apart", !link.isAdmitted);
  $("stop").classList.toggle("on", isStopped);
  $("clear").disabled = !(mine && link.stopShown);
  $("seat").disabled = !link.isAdmitted;
  $("seat").classList.toggle("mine", mine);
  put($("seat"), mine ? "Leave" : status && status.guest ? "PIN" : "Drive");
  for (const name of ["autonomous", "more", "less"]) $(name).disabled = !mine;
  const isRecent = performance.now() - answer.atMs < ANSWER_MS;
  put($("answer"), isRecent ? answer.text : "");
  showState(...stateOf(mine, isStopped, isRecent && answer.isRefusal ? answer.text : ""));
  showCar(car, status);
  around.show(car.layout, car.sonars);
  tools.show(car, mine);
}

// How the state looks, who drives, and why: in the words of the nodes.
function stateOf(mine, isStopped, refusal) {
  const {throttle, steering} = car, who = car.who || {text: ""};
  const decisive = throttle || steering || {source: "", text: ""};
  if (!link.isAdmitted) {
    return ["off", "No contact", link.stopWanted ? "The stop is sent once contact is back." : refusal
      || (link.stopShown ? "Its emergency stop was on." : "Without a phone the car stops by itself.")];
  }
  if (isStopped) {
    const isFree = status && status.driver === "nobody" && !status.guest;
    const next = mine ? "Clear it, then touch again." : isFree ? "Press Drive, then clear it."
      : "Only the driver's phone can clear it.";
    return ["stop", link.stopShown ? "Emergency stop" : "Stopping", refusal || next];
  }
  if (refusal) return ["wait", "Not now", refusal];
  if (decisive.source === "locked") return ["stop", "Locked", decisive.text];
  const sources = [throttle, steering].map((one) => one && one.source);
  if (sources.includes("planner")) return ["go", "The planner drives", decisive.text];
  if (sources.includes("teleop")) {
    const byPhone = who.text.startsWith("phone:");
    return ["go", byPhone ? mine ? "You drive" : "A phone drives" : "The gamepad drives", decisive.text];
  }
  if (mine && status.why && hands.controls.touch) return ["wait", "Let go", status.why];
  if (mine) return ["wait", hands.controls.touch ? "It stands" : "Touch to drive", decisive.text || who.text];
  return ["off", status && status.driver === "another" ? "Another has the seat" : "Nobody drives",
    decisive.text || who.text];
}

function buzz(ms) {
  if (navigator.vibrate && navigator.userActivation && navigator.userActivation.hasBeenActive) navigator.vibrate(ms);
}

// Only a page by https may keep a phone's screen on.
function keepAwake() {
  if (!navigator.wakeLock || document.visibilityState !== "visible") return;
  navigator.wakeLock.request("screen").catch(() => {});  // a battery that is low refuses it
}
document.addEventListener("visibilitychange", keepAwake);

// --- settings ---

function arrange() {
  const order = localStorage.getItem("thumbs") || "left";
  hands.release();
  document.body.classList.toggle("one", order === "one");
  const roles = {left: ["steering", "throttle"], right: ["throttle", "steering"], one: ["both", "throttle"]}[order];
  [$("pad-left"), $("pad-right")].forEach((pad, index) => {
    pad.dataset.role = roles[index];
    put(pad.querySelector(".label"), roles[index] === "both" ? "throttle and steering" : roles[index]);
  });
  $("thumbs").value = order;
}
$("thumbs").addEventListener("change", (event) => {
  localStorage.setItem("thumbs", event.target.value);
  arrange();
});
$("open-tools").addEventListener("click", () => {
  hands.release();
  const isOpen = document.body.classList.toggle("tools");
  $("open-tools").setAttribute("aria-expanded", isOpen);
  put($("open-tools"), isOpen ? "Back" : "More");
});
put($("network"), location.protocol === "https:" ? "" : "This page came by http: in a WLAN whoever knows its password "
  + "can read along, and take the seat. Drive in the car's own WLAN, or give phone_drive a certificate.");

// --- admission ---

function openGate(why) {
  const isElsewhere = why.startsWith("This page");
  put($("gate-text"), why);
  $("pin").hidden = isElsewhere;
  put($("gate-title"), isElsewhere ? "Opened elsewhere" : "PIN of this car");
  put($("gate-go"), isElsewhere ? "Use it here" : "Open");
  if (!$("gate").open) $("gate").showModal();
  show();
}
$("gate").addEventListener("cancel", (event) => { if (!link.isAdmitted) event.preventDefault(); });  // a guest's
$("gate-form").addEventListener("submit", (event) => {
  event.preventDefault();
  if ($("pin").hidden) {
    $("gate").close();
    link.open("");
  } else if (/^\d{6}$/.test($("pin").value)) {
    link.open($("pin").value);
  }
  $("pin").value = "";
});

arrange();
// Open by the PIN in the address, and take it out: it would stand in the browser's history, and on pictures.
function openByAddress() {
  const pin = /^#(\d{6})$/.exec(location.hash);
  history.replaceState(null, "", location.pathname);
  if (!link.isAdmitted || status && status.guest) link.open(pin ? pin[1] : "");
}
addEventListener("hashchange", openByAddress);  // of a new start of the car, in a tab that is open
openByAddress();
setInterval(show, 1000);
