// The connection to the gateway: reconnects automatically, and reports its state.

// Time without a message after which the connection counts as lost, and is opened again.
const LOST_MS = 3000;
const REOPEN_MS = 8000;

function subscribe(onState) {
  let source = null;
  let received = performance.now();
  let state = "waiting";

  const report = (sort, code, text) => note({ t: now(), sort, code, who: "page", text });
  const setState = (next) => {
    if (next !== state) {
      if (next === "lost") report("fault", "disconnected", "the connection is lost");
      if (next === "live" && state === "lost") report("mended", "connected", "connected again");
    }
    state = next;
    onState(state);
  };
  const receive = (handle) => (event) => {
    received = performance.now();
    handle(JSON.parse(event.data));
    setState("live");
  };
  const open = () => {
    if (source) source.close();
    received = performance.now();
    source = new EventSource("events");
    source.addEventListener("stop", (event) => Object.assign(stopping, JSON.parse(event.data)));
    source.addEventListener("hello", receive(takeHello));
    source.addEventListener("news", receive((message) => store.hello && take(message)));
    // A browser retries automatically unless the request was refused.
    source.addEventListener("error", () => {
      setState("lost");
      if (source.readyState === EventSource.CLOSED) setTimeout(open, 1000);
    });
  };
  setInterval(() => {
    const silence = performance.now() - received;
    if (silence > LOST_MS) setState("lost");
    if (silence > REOPEN_MS) open();
  }, 500);
  open();
}

