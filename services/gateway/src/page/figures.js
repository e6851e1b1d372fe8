// Numbers, processes and events, as text. The content of a message is always shown as text and
// never as markup.

const byId = (id) => document.getElementById(id);
const SHORT_S = 5;
// Access of unauthenticated peers on the network, by its code.
const EXPOSURES = [
  "",
  "insecure: unauthenticated peers on the network can watch this robot",
  "insecure: unauthenticated peers on the network can drive this robot",
];

function show(id, text, kind = "") {
  const place = byId(id);
  if (place.textContent !== text) place.textContent = text;
  if (place.className !== kind) place.className = kind;
}

function element(name, text, kind) {
  const made = document.createElement(name);
  made.textContent = text;
  if (kind) made.className = kind;
  return made;
}

function showHead() {
  const { hello } = store;
  if (!hello) return;
  const { about } = hello;
  show("robot", hello.robot);
  const exposure = Math.max(0, ...store.processes.map((process) => process.exposure));
  const exposed = EXPOSURES[exposure];
  show("insecure", exposed);
  byId("insecure").dataset.exposure = exposure;
  byId("insecure").hidden = !exposed;
  document.title = `${hello.robot} · Coxswain`;
  const limits = [
    about.heading_rad && `heading ± ${Math.round((about.heading_rad * 180) / Math.PI)}°`,
    about.speed_mps && `speed ${about.speed_mps} m/s`,
    about.corridor_left_m && `${metres(about.corridor_left_m)} left`,
    about.corridor_right_m && `${metres(about.corridor_right_m)} right`,
  ].filter((limit) => limit);
  const limitsText = limits.length ? ` Limits: ${limits.join(", ")}.` : "";
  const description = about.description ? `: ${about.description}` : "";
  show("scenario", `${about.scenario}${description}${limitsText}`, "quiet");
  const end = about.duration_s ? ` of ${about.duration_s}` : "";
  const time = store.states.length ? `${now().toFixed(1)}${end} s` : "not driving yet";
  show("time", time, "quiet");
  for (const part of document.querySelectorAll("[data-compared]")) {
    part.hidden = !store.without.length;
  }
}

// RMS without learning over the time of the last rows.
function showCompared(since) {
  const { compared, without, plans } = store;
  if (!compared) return;
  if (store.goal) {
    // The run without learning has no goal.
    show("compared", "–", "");
    show("compared-more", "the robot follows a goal, which the run without learning has not");
    return;
  }
  const end = without.length ? latest(without)[0] : 0;
  const both = plans.filter((row) => row[P.t] <= end + 1e-6);
  const past = without.filter((row) => row[0] <= now() + 1e-6);
  const [ours, theirs] = [rms(both, P.error, since), rms(past, 3, since)];
  const ratio = (one, other) => (one > 0 ? other / one : null);
  const start = compared.since * store.hello.period;
  const span = start < 1 ? "so far" : `since ${start.toFixed(0)} s`;
  const soFar = `RMS ${span} ${metres(compared.with)}, without ${metres(compared.without)}`;
  const short = ours !== null && theirs !== null ? ratio(ours, theirs) : null;
  const whole = ratio(compared.with, compared.without);
  const shown = short === null ? whole : short;
  let text = "–";
  if (shown !== null) {
    text = shown >= 1 ? `${times(shown)} × less error` : `${times(1 / shown)} × more error`;
  }
  show("compared", text, shown !== null && shown >= 1.05 ? "good" : "");
  byId("compared").dataset.ratio = shown;
  const before = short === null ? "" : `last ${SHORT_S} s. `;
  const after = whole === null ? "" : ` (${times(whole)} ×)`;
  show("compared-more", `${before}${soFar}${after}`);
}

function showFigures() {
  const { plans, states, model, hello } = store;
  if (!states.length) return;
  const state = latest(states);
  const names = (list, code) => (list && list[code]) || "?";
  const driving = state[S.fallbackLevel] <= 1;
  const level = names(hello.fallback_levels, state[S.fallbackLevel]);
  show("fallback-level", level, driving ? "" : "bad");
  byId("fallback-level").dataset.level = state[S.fallbackLevel];
  const reason = state[S.reason] ? names(hello.reasons, state[S.reason]) : "no fault";
  show("fallback-level-more", reason);
  const [x, y, speed] = [S.x, S.y, S.speed].map((column) => state[column].toFixed(2));
  show("place", `x ${x} m, y ${y} m, ${speed} m/s`, "quiet");
  if (!plans.length) return;
  const plan = latest(plans);
  const since = plan[P.t] - SHORT_S;
  show("error", metres(plan[P.error]));
  show("error-more", `RMS ${metres(rms(plans, P.error, since))} in the last ${SHORT_S} s`);
  showCompared(since);
  const [main, whole] = [P.residual, P.innovation].map((column) => rms(plans, column, since));
  show("residual", `${small(main)} → ${small(whole)} m/s`);
  show("model", plan[P.version] ? `version ${plan[P.version]}` : "none yet");
  byId("model").dataset.version = plan[P.version];
  if (model) {
    const plane = (score) => Math.hypot(score[0] || 0, score[1] || 0);
    const [learned, nominal] = [small(plane(model.learned)), small(plane(model.main))];
    const heldOut = `held out: ${learned} instead of ${nominal} m/s`;
    byId("model-more").dataset.samples = model.samples;
    show("model-more", `${model.samples ? heldOut : "not yet scored"}; ${model.points} points`);
  }
  const period = hello.period * 1e6;
  const worst = Math.max(...plans.map((row) => row[P.tick]));
  show("tick", duration(plan[P.tick]), plan[P.tick] > period ? "bad" : "");
  show("tick-more", `of ${duration(period)}; ${duration(worst)} at most in the last minute`);
}

function showProcesses() {
  const list = byId("processes");
  const shown = JSON.stringify(store.processes);
  if (list.dataset.shown === shown) return;
  list.dataset.shown = shown;
  const total = (key) => store.processes.reduce((sum, process) => sum + process[key], 0);
  const [lost, malformed] = [total("lost"), total("refused")];
  const kind = lost + malformed ? "bad" : "quiet";
  show("losses", `messages lost ${lost}, malformed ${malformed}`, kind);
  list.replaceChildren(...store.processes.map((process) => {
    const item = document.createElement("li");
    const phase = process.silent ? `silent ${process.silence.toFixed(0)} s` : process.phase;
    const healthy = !process.silent && process.phase !== "degraded";
    const counts = [`pid ${process.pid}`];
    if (process.starts > 1) counts.push(`started ${process.starts} times`);
    counts.push(`lost ${process.lost}`);
    const periods = process.met + process.missed;
    if (periods) counts.push(`${process.missed} of ${periods} periods missed`);
    item.append(
      element("b", process.who),
      element("span", phase, healthy ? "good" : "bad"),
      element("span", counts.join(" · "), "quiet"),
    );
    if (process.text) item.append(element("span", process.text, "process-error"));
    return item;
  }));
}

function showLog() {
  const list = byId("log");
  const newest = latest(store.entries);
  const last = newest ? `${newest.n} ${newest.t} ${newest.text}` : "";
  const shown = `${store.entries.length} ${last}`;
  if (list.dataset.shown === shown) return;
  list.dataset.shown = shown;
  list.replaceChildren(...store.entries.slice().reverse().map((entry) => {
    const item = document.createElement("li");
    Object.assign(item.dataset, { sort: entry.sort, who: entry.who, code: entry.code });
    const time = element("span", `${entry.t.toFixed(1)} s`, "quiet");
    item.append(time, element("span", entry.who), element("span", entry.text));
    return item;
  }));
  if (!newest) list.replaceChildren(element("li", "no events yet", "quiet"));
}

