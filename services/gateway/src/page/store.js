// Data of the page: the rows of the gateway, in chronological order.

// Columns of a state row and of a plan row.
const S = { t: 0, x: 1, y: 2, yaw: 3, speed: 4, fallbackLevel: 5, reason: 6 };
const P = {
  t: 0,
  rx: 1,
  ry: 2,
  error: 3,
  residual: 4,
  innovation: 5,
  residualYaw: 6,
  innovationYaw: 7,
  tick: 8,
  version: 9,
  fallbackLevel: 10,
};
// Charts show the last minute; the path is longer, with fewer points.
const KEPT_S = 60;
const PATH_MAX = 4000;
const ENTRIES_MAX = 100;

const store = {
  hello: null, run: null, arrived: 0,
  states: [], plans: [], path: [], without: [],
  horizon: null, model: null, goal: null, obstacles: [], compared: null,
  processes: [], entries: [],
};

// A new epoch of the plant: its time starts at zero.
function startRun(run) {
  const none = { horizon: null, goal: null, obstacles: [], compared: null };
  Object.assign(store, { run, states: [], plans: [], path: [], ...none });
}

function append(rows, more) {
  const last = rows.length ? rows[rows.length - 1][0] : -Infinity;
  const fresh = more.filter((row) => row[0] > last);
  rows.push(...fresh);
  const newest = rows.length ? rows[rows.length - 1][0] : 0;
  let old = 0;
  while (old < rows.length && newest - rows[old][0] > KEPT_S) old += 1;
  rows.splice(0, old);
  return fresh;
}

function take(message) {
  if (message.run !== store.run && message.run !== null) startRun(message.run);
  const fresh = append(store.states, message.states);
  if (fresh.length) store.arrived = performance.now();
  for (const row of fresh) store.path.push([row[S.x], row[S.y]]);
  if (store.path.length > PATH_MAX) store.path = store.path.filter((_, index) => index % 2 === 0);
  append(store.plans, message.plans);
  for (const part of ["horizon", "model", "goal", "obstacles", "compared", "processes"]) {
    if (message[part]) store[part] = message[part];
  }
  for (const entry of message.entries || []) note(entry);
}

// Handles the first message of a connection.
function takeHello(hello) {
  const before = store.hello;
  const isSameGateway = before && before.gateway === hello.gateway;
  store.hello = hello;
  store.without = hello.without;
  if (!isSameGateway) store.entries = store.entries.filter((entry) => entry.who === "page");
  take(hello);
}

function note(entry) {
  if (entry.n && store.entries.some((other) => other.n === entry.n)) return;
  store.entries.push(entry);
  store.entries.splice(0, store.entries.length - ENTRIES_MAX);
}

const latest = (rows) => rows[rows.length - 1];
const now = () => (store.states.length ? latest(store.states)[S.t] : 0);

function rms(rows, column, since) {
  let sum = 0;
  let count = 0;
  for (let index = rows.length - 1; index >= 0 && rows[index][0] > since; index -= 1) {
    const value = rows[index][column];
    if (value === null) continue;
    sum += value * value;
    count += 1;
  }
  return count ? Math.sqrt(sum / count) : null;
}

