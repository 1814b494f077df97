// The connection to the car: who is admitted, the newest token, and the emergency stop until the car confirms it.
// The messages are those of teleop/phone_messages.py.

const SILENT_MS = 1500;  // tokens come 20 times a second; a dead network closes nothing by itself
const RETRY_MS = 500;
const CHECK_MS = 200;

export class Link {
  // seen: functions of the page that are called with what arrives.
  constructor(seen) {
    this.seen = seen;
    this.key = sessionStorage.getItem("key") || "";
    this.pin = "";
    this.token = "";
    this.number = 0;
    this.isAdmitted = false;
    this.stopShown = false;  // the car's e-stop, as it was last shown here
    this.stopWanted = false;  // pressed here, and not confirmed yet
    this.socket = null;
    this.mayConnect = false;
    this.heardMs = 0;
    setInterval(() => this.check(), CHECK_MS);
  }

  // Ask to be admitted: by a PIN, by the key of an earlier connection of this tab, or as a guest.
  open(pin) {
    this.pin = pin;
    this.mayConnect = true;
    this.connect();
  }

  connect() {
    this.drop();
    this.heardMs = performance.now();
    const scheme = location.protocol === "https:" ? "wss" : "ws";
    const socket = this.socket = new WebSocket(`${scheme}://${location.host}/ws`);
    const ifCurrent = (handle) => (event) => { if (socket === this.socket) handle(event); };
    socket.onopen = ifCurrent(() => this.send(this.pin ? {type: "pin", pin: this.pin}
      : this.key ? {type: "key", key: this.key} : {type: "watch"}));
    socket.onmessage = ifCurrent((event) => this.receive(JSON.parse(event.data)));
    socket.onclose = ifCurrent(() => this.lose());
  }

  drop() {
    const socket = this.socket;
    this.socket = null;
    if (socket) socket.close();
    this.lose();
  }

  lose() {
    const wasAdmitted = this.isAdmitted;
    this.isAdmitted = false;
    this.token = "";
    this.number = 0;
    if (wasAdmitted) this.seen.lost();
  }

  check() {
    const silentMs = performance.now() - this.heardMs;
    const isOpen = this.socket && this.socket.readyState <= WebSocket.OPEN;
    if (this.mayConnect && silentMs > (isOpen ? SILENT_MS : RETRY_MS)) this.connect();
    if (this.stopWanted && this.isAdmitted) this.send({type: "e_stop"});
  }

  receive(message) {
    this.heardMs = performance.now();
    if ("token" in message) {
      this.token = message.token;
      this.seen.token();
    } else if ("key" in message) {
      this.key = message.key;
      sessionStorage.setItem("key", this.key);
      this.pin = "";
      this.admit();
    } else if ("refused" in message) {
      const wasAdmitted = this.isAdmitted;
      if (!wasAdmitted) {
        this.key = "";
        sessionStorage.removeItem("key");
        this.giveUp();
      }
      this.seen.refused(message.refused, wasAdmitted);
    } else if ("closed" in message) {
      if (message.closed === "replaced") this.giveUp();
      this.seen.closed(message.closed);
    } else if ("status" in message) {
      if (!this.isAdmitted) this.admit();  // a guest, who gets no key
      this.stopShown = message.status.e_stop;
      if (this.stopShown) this.stopWanted = false;
      this.seen.status(message.status);
    } else {
      this.seen.other(message);
    }
  }

  // Only a stop that was pressed here and not confirmed is sent: one that was shown here may have been cleared since.
  admit() {
    if (this.isAdmitted) return;
    this.isAdmitted = true;
    if (this.stopWanted) this.stop();
    this.seen.admitted();
  }

  giveUp() {
    this.pin = "";
    this.mayConnect = false;
    this.drop();
  }

  // Send what counts at any time.
  send(message) {
    if (this.socket && this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  // Send what counts only while its token is fresh.
  sendEvidence(message) {
    if (this.isAdmitted && this.token) this.send({...message, token: this.token, n: ++this.number});
  }

  stop() {
    this.stopWanted = true;
    if (this.isAdmitted) this.send({type: "e_stop"});
  }
}
