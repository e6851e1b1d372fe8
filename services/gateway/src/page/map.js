// The robot on its path, seen from above: x to the right, y up.

// Size of the visible world across the shorter side [m].
const SPANS = { follow: 4, close: 1 };
const SIGMAS = 2;
const MAGNIFIED = [1, 2, 5, 10, 20, 50, 100];
const LARGE_PX = 9;

// The current pose of the robot: between two states, it follows the predicted poses.
function poseNow(still) {
  const state = latest(store.states);
  const measured = [state[S.x], state[S.y], state[S.yaw]];
  const { horizon, hello } = store;
  if (still || !horizon || horizon.predicted.length < 2) return measured;
  if (Math.abs(horizon.t - state[S.t]) > 1e-6) return measured;
  const share = Math.min(1, (performance.now() - store.arrived) / 1000 / hello.period);
  const [from, to] = horizon.predicted;
  return measured.map((value, index) => value + share * (to[index] - from[index]));
}

function bounds(points) {
  const box = [Infinity, Infinity, -Infinity, -Infinity];
  for (const [x, y] of points) {
    if (x === null || y === null) continue;
    box[0] = Math.min(box[0], x);
    box[1] = Math.min(box[1], y);
    box[2] = Math.max(box[2], x);
    box[3] = Math.max(box[3], y);
  }
  return box;
}

function camera(view, pose, width, height) {
  let centre = pose;
  let scale = Math.min(width, height) / (SPANS[view] || 4);
  if (view === "whole") {
    const references = store.plans.map((row) => [row[P.rx], row[P.ry]]);
    const [left, bottom, right, top] = bounds([...store.path, ...references, pose]);
    centre = [(left + right) / 2, (bottom + top) / 2];
    scale = Math.min(width / (right - left + 2), height / (top - bottom + 2));
  }
  const to = ([x, y]) => [
    width / 2 + (x - centre[0]) * scale,
    height / 2 - (y - centre[1]) * scale,
  ];
  return { scale, to, centre };
}

// 1, 2 or 5 times a power of ten, at least `minimum`.
function roundStep(minimum) {
  const power = 10 ** Math.floor(Math.log10(minimum));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= minimum * 0.999);
}

function grid(pen, eye, width, height) {
  const step = roundStep(60 / eye.scale);
  const [cx, cy] = eye.centre;
  const across = width / 2 / eye.scale;
  const up = height / 2 / eye.scale;
  for (let x = Math.ceil((cx - across) / step) * step; x < cx + across; x += step) {
    const [px] = eye.to([x, cy]);
    line(pen, [[px, 0], [px, height]], colours.grid, 1);
  }
  for (let y = Math.ceil((cy - up) / step) * step; y < cy + up; y += step) {
    const [, py] = eye.to([cx, y]);
    line(pen, [[0, py], [width, py]], colours.grid, 1);
  }
  line(pen, [[12, height - 12], [12 + step * eye.scale, height - 12]], colours.ink, 2);
  pen.fillStyle = colours.ink;
  pen.fillText(step >= 1 ? `${step} m` : `${Math.round(step * 1000)} mm`, 12, height - 18);
}

// The reference, moved to the left by `offset`.
function beside(points, offset) {
  return points.map(([x, y], index) => {
    const [x0, y0] = points[Math.max(0, index - 1)];
    const [x1, y1] = points[Math.min(points.length - 1, index + 1)];
    const length = Math.hypot(x1 - x0, y1 - y0) || 1;
    return [x - (offset * (y1 - y0)) / length, y + (offset * (x1 - x0)) / length];
  });
}

function ellipses(pen, eye, horizon) {
  const largest = Math.max(...horizon.deviation.map((axes) => Math.max(axes[0], axes[1])));
  const size = SIGMAS * largest * eye.scale;
  const factor = largest > 0 ? MAGNIFIED.find((m) => m * size >= LARGE_PX) || 100 : 1;
  horizon.deviation.forEach(([ahead, aside], index) => {
    const [x, y, yaw] = horizon.predicted[index];
    if (!(ahead > 0 && aside > 0)) return;
    const [px, py] = eye.to([x, y]);
    pen.beginPath();
    const [long, wide] = [ahead, aside].map((axis) => factor * SIGMAS * axis * eye.scale);
    pen.ellipse(px, py, long, wide, -yaw, 0, 2 * Math.PI);
    pen.globalAlpha = 0.22;
    pen.fillStyle = colours.horizon;
    pen.fill();
    pen.globalAlpha = 1;
  });
  return largest > 0 ? `± 2σ${factor > 1 ? ` (× ${factor})` : ""}` : "";
}

function robot(pen, eye, [x, y, yaw], colour) {
  const scale = Math.max(eye.scale, 60);
  const [px, py] = eye.to([x, y]);
  pen.save();
  pen.translate(px, py);
  pen.rotate(-yaw);
  pen.scale(scale, scale);
  const { half_extent_m: [ahead, aside], wheels } = store.hello.about;
  const largest = Math.max(0, ...wheels.map((wheel) => wheel[3]));
  const [length, width] = [2 * ahead + 2.2 * largest, 2 * aside - largest];
  pen.fillStyle = colour;
  pen.fillRect(-length / 2, -width / 2, length, width);
  pen.fillStyle = colours.ink;
  for (const [forward, left, direction, radius] of wheels) {
    pen.save();
    pen.translate(forward, -left);
    pen.rotate(-direction);
    pen.fillRect(-radius, -radius / 2, 2 * radius, radius);
    pen.restore();
  }
  pen.fillStyle = colours.card;
  pen.beginPath();
  pen.moveTo(length * 0.36, 0);
  pen.lineTo(-length * 0.12, width * 0.3);
  pen.lineTo(-length * 0.12, -width * 0.3);
  pen.fill();
  pen.restore();
}

// Draws the path and current position of the robot without learning.
function drawWithout(pen, eye) {
  const time = now();
  const path = store.without.filter((row) => row[0] <= time + 1e-6);
  if (!path.length) return;
  line(pen, path.map((row) => eye.to([row[1], row[2]])), colours.without, 2, [6, 5]);
  if (path.length === store.without.length) return;
  const [, x, y] = latest(path);
  const [px, py] = eye.to([x, y]);
  pen.strokeStyle = colours.without;
  pen.lineWidth = 2.5;
  pen.beginPath();
  pen.arc(px, py, 6, 0, 2 * Math.PI);
  pen.stroke();
}

// Draws the pose of the goal, and how far the robot is.
function drawGoal(pen, eye) {
  const { id, kind, phase, target, progress, left_m: way, left_s: time } = store.goal;
  const [px, py] = eye.to(target);
  const radius = Math.max(10, 0.25 * eye.scale);
  pen.strokeStyle = phase === "active" ? colours.reference : colours.quiet;
  pen.lineWidth = 3;
  pen.beginPath();
  pen.arc(px, py, radius, 0, 2 * Math.PI);
  pen.moveTo(px, py);
  pen.lineTo(px + 1.5 * radius * Math.cos(target[2]), py - 1.5 * radius * Math.sin(target[2]));
  pen.stroke();
  pen.fillStyle = colours.ink;
  const rest = `${Math.round(100 * progress)} %, ${way.toFixed(2)} m, ${time.toFixed(1)} s left`;
  pen.fillText(`goal ${id} (${kind}): ${phase === "active" ? rest : phase}`, 12, 22);
}

// The line around a shape of corners x, y, …, moved by [dx, dy]: as wide as the shape's radius.
function outline(pen, eye, radius, corners, [dx, dy] = [0, 0]) {
  pen.lineJoin = pen.lineCap = "round";
  pen.lineWidth = Math.max(2, 2 * radius * eye.scale);
  pen.beginPath();
  for (let i = 0; i < corners.length; i += 2) {
    pen.lineTo(...eye.to([corners[i] + dx, corners[i + 1] + dy]));
  }
  pen.closePath();
}

// Draws the known obstacles, the zones and the border.
function drawKnown(pen, eye) {
  const { obstacles, zones, fence } = store.hello.about.map;
  const kinds = [[zones, colours.reference, 0.25], [obstacles, colours.ink, 0.6]];
  for (const [shapes, colour, alpha] of kinds) {
    pen.globalAlpha = alpha;
    pen.strokeStyle = pen.fillStyle = colour;
    for (const [radius, ...corners] of shapes) {
      outline(pen, eye, radius, corners);
      pen.fill();
      pen.stroke();
    }
  }
  pen.globalAlpha = 1;
  pen.strokeStyle = colours.bad;
  for (const [, ...corners] of fence) {
    outline(pen, eye, 0, corners);
    pen.stroke();
  }
}

// Draws each obstacle that is seen, and where it will be in 1 s.
function drawObstacles(pen, eye) {
  for (const [vx, vy, radius, ...corners] of store.obstacles) {
    for (const seconds of vx || vy ? [1, 0] : [0]) {
      pen.globalAlpha = seconds ? 0.2 : 0.75;
      pen.strokeStyle = pen.fillStyle = colours.bad;
      outline(pen, eye, radius, corners, [vx * seconds, vy * seconds]);
      pen.fill();
      pen.stroke();
    }
  }
  pen.globalAlpha = 1;
}

// Draws the map. Returns a text with the scale of the uncertainty.
function drawMap(canvas, view, still) {
  const { pen, width, height } = sheet(canvas);
  if (!store.states.length) {
    pen.fillStyle = colours.quiet;
    pen.fillText("waiting for the robot", 12, 22);
    return "";
  }
  const pose = poseNow(still);
  const eye = camera(view, pose, width, height);
  grid(pen, eye, width, height);
  // A plan older than three periods is not drawn: its controller has ended.
  const isFresh = store.horizon && now() - store.horizon.t < 3 * store.hello.period;
  const horizon = isFresh ? store.horizon : null;
  const past = store.plans.map((row) => [row[P.rx], row[P.ry]]);
  const reference = horizon ? past.concat(horizon.reference) : past;
  const { corridor_left_m: left, corridor_right_m: right } = store.hello.about;
  for (const offset of [left, right && -right].filter((room) => room)) {
    line(pen, beside(reference, offset).map(eye.to), colours.bad, 1.5);
  }
  line(pen, reference.map(eye.to), colours.reference, 9);
  drawKnown(pen, eye);
  drawObstacles(pen, eye);
  if (store.goal) drawGoal(pen, eye);
  else drawWithout(pen, eye);
  line(pen, [...store.path.map(eye.to), eye.to(pose)], colours.with, 2.5);
  let spread = "";
  if (horizon) {
    spread = ellipses(pen, eye, horizon);
    const ahead = horizon.predicted.map(eye.to);
    line(pen, ahead, colours.horizon, 2.5);
    pen.fillStyle = colours.horizon;
    for (const [x, y] of ahead) {
      pen.beginPath();
      pen.arc(x, y, 3, 0, 2 * Math.PI);
      pen.fill();
    }
  }
  robot(pen, eye, pose, colours.with);
  return spread;
}

