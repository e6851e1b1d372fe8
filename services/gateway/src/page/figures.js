// Numbers, processes and events, as text. The content of a message is always shown as text and
// never as markup.

const byId = (id) => document.getElementById(id);
const SHORT_S = 5;
// Access of unauthenticated peers on the network, by its code.
const EXPOSURES = ["", "insecure: unauthenticated peers on the network can watch this robot", "insecure: unauthenticated peers on the network can drive this robot"];

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
  const exposed = EXPOSURES[Math.max(0, ...store.processes.map((process) => process.exposure))];
  show("insecure", exposed);
  byId("insecure").hidden = !exposed;
  document.title = `${hello.robot} · Coxswain`;
  const limits = [
    about.heading_rad && `heading ± ${Math.round((about.heading_rad * 180) / Math.PI)}°`,
    about.speed_mps && `speed ${about.speed_mps} m/s`,
    about.corridor_left_m && `${metres(about.corridor_left_m)} left`,
    about.corridor_right_m && `${metres(about.corridor_right_m)} right`,
  ].filter((limit) => limit);
  const told = limits.length ? ` Limits: ${limits.join(", ")}.` : "";
  show("scenario", `${about.scenario}${about.description ? `: ${about.description}` : ""}${told}`, "quiet");
  show("time", store.states.length ? `${now().toFixed(1)}${about.duration_s ? ` of ${about.duration_s}` : ""} s` : "not driving yet", "quiet");
  for (const part of document.querySelectorAll("[data-compared]")) part.hidden = !store.without.length;
}

// RMS without learning over the time of the last rows.
function showCompared(since) {
  const { compared, without, plans } = store;
  if (!compared) return;
  const end = without.length ? latest(without)[0] : 0;
  const both = plans.filter((row) => row[P.t] <= end + 1e-6);
  const [ours, theirs] = [rms(both, P.error, since), rms(without.filter((row) => row[0] <= now() + 1e-6), 3, since)];
  const ratio = (one, other) => (one > 0 ? other / one : null);
  const start = compared.since * store.hello.period;
  const soFar = `RMS ${start < 1 ? "so far" : `since ${start.toFixed(0)} s`} ${metres(compared.with)}, without ${metres(compared.without)}`;
  const [short, whole] = [ours !== null && theirs !== null ? ratio(ours, theirs) : null, ratio(compared.with, compared.without)];
  const best = short === null ? whole : short;
  const tell = best === null ? "–" : best >= 1 ? `${times(best)} × less error` : `${times(1 / best)} × more error`;
  show("compared", tell, best !== null && best >= 1.05 ? "good" : "");
  show("compared-more", `${short === null ? "" : `last ${SHORT_S} s. `}${soFar}${whole === null ? "" : ` (${times(whole)} ×)`}`);
}

function showFigures() {
  const { plans, states, model, hello } = store;
  if (!states.length) return;
  const state = latest(states);
  const names = (list, code) => (list && list[code]) || "?";
  const driving = state[S.fallbackLevel] <= 1;
  show("fallback-level", names(hello.fallback_levels, state[S.fallbackLevel]), driving ? "" : "bad");
  show("fallback-level-more", state[S.reason] ? names(hello.reasons, state[S.reason]) : "normal");
  show("place", `x ${state[S.x].toFixed(2)} m, y ${state[S.y].toFixed(2)} m, ${state[S.speed].toFixed(2)} m/s`, "quiet");
  if (!plans.length) return;
  const plan = latest(plans);
  const since = plan[P.t] - SHORT_S;
  show("error", metres(plan[P.error]));
  show("error-more", `RMS ${metres(rms(plans, P.error, since))} in the last ${SHORT_S} s`);
  showCompared(since);
  show("residual", `${small(rms(plans, P.residual, since))} → ${small(rms(plans, P.innovation, since))} m/s`);
  show("model", plan[P.version] ? `version ${plan[P.version]}` : "none yet");
  if (model) {
    const plane = (score) => Math.hypot(score[0] || 0, score[1] || 0);
    const scored = model.samples ? `held out: ${small(plane(model.learned))} instead of ${small(plane(model.main))} m/s` : "not yet scored";
    show("model-more", `${scored}; ${model.points} points`);
  }
  const period = hello.period * 1e6;
  const worst = Math.max(...plans.map((row) => row[P.tick]));
  show("tick", duration(plan[P.tick]), plan[P.tick] > period ? "bad" : "");
  show("tick-more", `of ${duration(period)}; ${duration(worst)} at most in the last minute`);
}

function showProcesses() {
  const list = byId("processes");
  const told = JSON.stringify(store.processes);
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  const total = (key) => store.processes.reduce((sum, process) => sum + process[key], 0);
  show("losses", `messages lost ${total("lost")}, malformed ${total("refused")}`, total("lost") + total("refused") ? "bad" : "quiet");
  list.replaceChildren(...store.processes.map((process) => {
    const item = document.createElement("li");
    const alive = process.silent ? `silent ${process.silence.toFixed(0)} s` : process.phase;
    const well = !process.silent && process.phase !== "degraded";
    const counts = [`pid ${process.pid}`];
    if (process.starts > 1) counts.push(`started ${process.starts} times`);
    counts.push(`lost ${process.lost}`);
    if (process.met || process.missed) counts.push(`${process.missed} of ${process.met + process.missed} periods missed`);
    item.append(element("b", process.who), element("span", alive, well ? "good" : "bad"), element("span", counts.join(" · "), "quiet"));
    if (process.text) item.append(element("span", process.text, "says"));
    return item;
  }));
}

function showLog() {
  const list = byId("log");
  const newest = latest(store.entries);
  const told = `${store.entries.length} ${newest ? `${newest.n} ${newest.t} ${newest.text}` : ""}`;
  if (list.dataset.told === told) return;
  list.dataset.told = told;
  list.replaceChildren(...store.entries.slice().reverse().map((entry) => {
    const item = document.createElement("li");
    item.dataset.sort = entry.sort;
    item.append(element("span", `${entry.t.toFixed(1)} s`, "quiet"), element("span", entry.who), element("span", entry.text));
    return item;
  }));
  if (!newest) list.replaceChildren(element("li", "no events yet", "quiet"));
}

