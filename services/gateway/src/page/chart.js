// Curves over time on a logarithmic scale.

const MARGIN = { left: 58, right: 10, top: 8, bottom: 20 };
const SMOOTH_S = 2;

// Running RMS of a column over the last seconds.
function running(rows, column) {
  let sum = 0;
  let count = 0;
  let first = 0;
  return rows.map((row) => {
    const square = (other) => (other[column] === null ? null : other[column] ** 2);
    const value = square(row);
    if (value !== null) {
      sum += value;
      count += 1;
    }
    while (row[0] - rows[first][0] > SMOOTH_S) {
      const old = square(rows[first]);
      if (old !== null) {
        sum -= old;
        count -= 1;
      }
      first += 1;
    }
    return [row[0], count ? Math.sqrt(Math.max(sum, 0) / count) : null];
  });
}

// Whole decades around all shown values.
function decades(series, from, level, minimum) {
  let low = Infinity;
  let high = level || 0;
  for (const { points } of series) {
    for (const [t, value] of points) {
      if (t < from || value === null || !(value > minimum)) continue;
      low = Math.min(low, value);
      high = Math.max(high, value);
    }
  }
  if (!(low < Infinity)) [low, high] = [minimum * 10, Math.max(high, minimum * 100)];
  const bottom = Math.floor(Math.log10(low) + 1e-9);
  return [bottom, Math.max(Math.ceil(Math.log10(high) - 1e-9), bottom + 1)];
}

// `series`: points, colour, width, dash, alpha. `level`: a horizontal line, such as a deadline.
// `marks`: times of events.
function drawChart(canvas, { series, seconds, label, level = 0, minimum = 1e-5, marks = [] }) {
  const { pen, width, height } = sheet(canvas);
  const until = Math.max(now(), seconds);
  const from = until - seconds;
  const [bottom, top] = decades(series, from, level, minimum);
  const inner = {
    width: width - MARGIN.left - MARGIN.right,
    height: height - MARGIN.top - MARGIN.bottom,
  };
  const across = (t) => MARGIN.left + ((t - from) / seconds) * inner.width;
  const up = (value) => {
    const share = (Math.log10(Math.max(value, minimum)) - bottom) / (top - bottom);
    return MARGIN.top + (1 - Math.max(share, 0)) * inner.height;
  };
  pen.fillStyle = colours.quiet;
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  for (let power = bottom; power <= top; power += 1) {
    const y = up(10 ** power);
    line(pen, [[MARGIN.left, y], [width - MARGIN.right, y]], colours.grid, 1);
    pen.fillText(label(10 ** power), MARGIN.left - 6, y);
  }
  pen.textBaseline = "alphabetic";
  pen.textAlign = "center";
  const step = seconds / 3;
  for (let t = Math.ceil(from / step - 1e-6) * step; t <= until + 1e-6; t += step) {
    const x = across(t);
    line(pen, [[x, MARGIN.top], [x, MARGIN.top + inner.height]], colours.grid, 1);
    const place = Math.min(Math.max(x, MARGIN.left + 8), width - 16);
    pen.fillText(`${Math.round(t)} s`, place, height - 5);
  }
  pen.textAlign = "left";
  pen.save();
  pen.beginPath();
  pen.rect(MARGIN.left, 0, inner.width, height);
  pen.clip();
  const base = MARGIN.top + inner.height;
  for (const t of marks) line(pen, [[across(t), base], [across(t), base - 6]], colours.quiet, 1);
  if (level) line(pen, [[MARGIN.left, up(level)], [width, up(level)]], colours.bad, 1.5, [6, 4]);
  for (const { points, colour, width: weight, dash, alpha = 1 } of series) {
    pen.globalAlpha = alpha;
    const place = ([t, value]) => [across(t), value === null || value <= 0 ? null : up(value)];
    line(pen, points.map(place), colour, weight, dash);
  }
  pen.restore();
}

function drawCharts(canvases, { window: seconds, axis }) {
  const { plans, without, hello } = store;
  const curve = (column) => plans.map((row) => [row[P.t], row[column]]);
  const time = now();
  const errorWithout = without.filter((row) => row[0] <= time).map((row) => [row[0], row[3]]);
  drawChart(canvases.error, {
    seconds,
    label: (value) => (value < 0.1 ? `${+(value * 1000).toPrecision(1)} mm` : `${value} m`),
    series: [
      { points: errorWithout, colour: colours.without, width: 2, dash: [5, 4] },
      { points: curve(P.error), colour: colours.with, width: 2 },
    ],
  });
  const isYaw = axis === "yaw";
  const main = isYaw ? P.residualYaw : P.residual;
  const whole = isYaw ? P.innovationYaw : P.innovation;
  const isNewModel = (row, index) => index && row[P.version] !== plans[index - 1][P.version];
  drawChart(canvases.residual, {
    seconds,
    label: (value) => `${+value.toPrecision(1)}`,
    minimum: 1e-4,
    marks: plans.filter(isNewModel).map((row) => row[P.t]),
    series: [
      { points: curve(main), colour: colours.without, width: 1, alpha: 0.35 },
      { points: curve(whole), colour: colours.with, width: 1, alpha: 0.35 },
      { points: running(plans, main), colour: colours.without, width: 2.5 },
      { points: running(plans, whole), colour: colours.with, width: 2.5 },
    ],
  });
  drawChart(canvases.tick, {
    seconds,
    label: (value) => (value < 1000 ? `${value} µs` : `${value / 1000} ms`),
    level: hello ? hello.period * 1e6 : 0,
    minimum: 1,
    series: [{ points: curve(P.tick), colour: colours.with, width: 2 }],
  });
}

