// The stop button, and its outcome. The gateway sends the token of the button to pages on the
// robot's own machine; other pages have no button.

// Time without a reply after which the page names other ways to stop.
const STOP_SLOW_MS = 3000;
const LATCHED_STOP = "latched stop";
const OTHER_WAYS = "Use the emergency stop, or run `coxswain stop` in a terminal.";
const RESUME = "To resume, run `coxswain resume` in a terminal.";

const stopping = { token: null, state: "idle", text: "" };

function setStopping(state, text) {
  Object.assign(stopping, { state, text });
}

async function stopRobot() {
  setStopping("stopping", "Stopping…");
  const late = () => setStopping("failed", `No reply yet. ${OTHER_WAYS}`);
  const timer = setTimeout(late, STOP_SLOW_MS);
  try {
    const headers = { "X-Stop-Token": stopping.token };
    const answer = await fetch("stop", { method: "POST", headers });
    const text = (await answer.text()).trim();
    if (answer.ok) setStopping("stopping", `Order accepted: ${text}.`);
    else setStopping("failed", `Not stopped: ${text}. ${OTHER_WAYS}`);
  } catch {
    setStopping("failed", `Not stopped: no connection to the gateway. ${OTHER_WAYS}`);
  } finally {
    clearTimeout(timer);
  }
}

// Whether the gate is stopped comes from the state of the robot, not from the reply.
function showStop() {
  const { hello, states } = store;
  const state = latest(states);
  if (state && hello.fallback_levels[state[S.fallbackLevel]] === LATCHED_STOP) {
    setStopping("stopped", `Stopped: ${hello.reasons[state[S.reason]]}. ${RESUME}`);
  } else if (stopping.state === "stopped") {
    setStopping("idle", "");
  }
  byId("stop").hidden = !stopping.token;
  byId("stop-bar").hidden = !stopping.token && !stopping.text;
  byId("stop-bar").dataset.state = stopping.state;
  show("stop-state", stopping.text);
}
