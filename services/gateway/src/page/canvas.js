// Common parts of all drawings: sharp pixels, the colours of the style, formatted numbers.

const dark = matchMedia("(prefers-color-scheme: dark)");
let colours = {};

function readColours() {
  const style = getComputedStyle(document.documentElement);
  const names = ["card", "ink", "quiet", "line", "grid", "with", "without", "reference", "horizon",
    "good", "bad"];
  for (const name of names) {
    colours[name] = style.getPropertyValue(`--${name}`).trim();
  }
}

// Returns a cleared context in CSS pixels.
function sheet(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.clientWidth;
  const height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
  pen.lineJoin = "round";
  return { pen, width, height };
}

// Draws a line through points that may have gaps.
function line(pen, points, colour, width, dash = []) {
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.setLineDash(dash);
  pen.beginPath();
  let drawing = false;
  for (const [x, y] of points) {
    if (x === null || y === null) {
      drawing = false;
    } else if (drawing) {
      pen.lineTo(x, y);
    } else {
      pen.moveTo(x, y);
      drawing = true;
    }
  }
  pen.stroke();
  pen.setLineDash([]);
}

function metres(value) {
  if (value === null) return "–";
  if (value < 0.0995) return `${(value * 1000).toFixed(value < 0.00995 ? 1 : 0)} mm`;
  return `${value.toFixed(2)} m`;
}

const small = (value) => (value === null ? "–" : value < 0.1 ? value.toFixed(3) : value.toFixed(2));
function duration(micros) {
  if (micros < 1000) return `${micros.toFixed(0)} µs`;
  return `${(micros / 1000).toFixed(micros < 10000 ? 1 : 0)} ms`;
}

const times = (ratio) => (ratio >= 10 ? ratio.toFixed(0) : ratio.toFixed(1));

