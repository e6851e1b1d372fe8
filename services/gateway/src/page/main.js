// The choices of the user, and the schedule of the drawing.

const MAP_EVERY_MS = 33;
const TEXT_EVERY_MS = 200;

const chosen = { view: "follow", window: 60, axis: "plane" };
const canvases = {
  map: byId("map"),
  error: byId("error-chart"),
  residual: byId("residual-chart"),
  tick: byId("tick-chart"),
};
const reducedMotion = matchMedia("(prefers-reduced-motion: reduce)");
let paused = false;
let mapNext = 0;
let textNext = 0;

function draw(time) {
  showStop();
  if (!paused && time >= mapNext) {
    mapNext = time + MAP_EVERY_MS;
    const spread = drawMap(canvases.map, chosen.view, reducedMotion.matches);
    if (byId("spread").textContent !== spread) byId("spread").textContent = spread;
  }
  if (!paused && time >= textNext) {
    textNext = time + TEXT_EVERY_MS;
    showHead();
    showFigures();
    showProcesses();
    showLog();
    drawCharts(canvases, chosen);
  }
  requestAnimationFrame(draw);
}

function status(state) {
  const plant = store.processes.find((process) => process.who === "plant");
  const finished = plant && plant.phase === "finished";
  const place = byId("status");
  const silent = plant && plant.silent;
  const texts = {
    waiting: "connecting",
    live: silent ? "robot silent" : "live",
    lost: "connection lost, reconnecting",
  };
  const text = finished && state !== "waiting" ? "finished" : texts[state];
  const shown = silent && state === "live" ? "lost" : state;
  place.dataset.state = finished ? "finished" : shown;
  if (place.textContent !== text) place.textContent = text;
}

for (const button of document.querySelectorAll("[data-choose]")) {
  button.addEventListener("click", () => {
    const { choose, value } = button.dataset;
    chosen[choose] = choose === "window" ? Number(value) : value;
    for (const other of document.querySelectorAll(`[data-choose="${choose}"]`)) {
      other.setAttribute("aria-pressed", String(other === button));
    }
    [mapNext, textNext] = [0, 0];
  });
}
byId("stop").addEventListener("click", stopRobot);
byId("pause").addEventListener("click", () => {
  paused = !paused;
  byId("pause").setAttribute("aria-pressed", String(paused));
});
dark.addEventListener("change", () => {
  readColours();
  [mapNext, textNext] = [0, 0];
});
addEventListener("resize", () => {
  [mapNext, textNext] = [0, 0];
});
readColours();
subscribe(status);
requestAnimationFrame(draw);
