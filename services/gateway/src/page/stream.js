// The connection to the gateway: reconnects automatically, and reports its state.

const SILENT_MS = 3000;
const GIVEN_UP_MS = 8000;

function listen(said) {
  let source = null;
  let heard = performance.now();
  let state = "waiting";

  const become = (next) => {
    if (next !== state) {
      if (next === "lost") note({ t: now(), sort: "fault", who: "page", text: "the connection is lost" });
      if (next === "live" && state === "lost") note({ t: now(), sort: "mended", who: "page", text: "connected again" });
    }
    state = next;
    said(state);
  };
  const hear = (what) => (event) => {
    heard = performance.now();
    what(JSON.parse(event.data));
    become("live");
  };
  const open = () => {
    if (source) source.close();
    heard = performance.now();
    source = new EventSource("events");
    source.addEventListener("hello", hear(greet));
    source.addEventListener("news", hear((message) => store.hello && take(message)));
    // A browser retries automatically unless the request was refused.
    source.addEventListener("error", () => {
      become("lost");
      if (source.readyState === EventSource.CLOSED) setTimeout(open, 1000);
    });
  };
  setInterval(() => {
    const silence = performance.now() - heard;
    if (silence > SILENT_MS) become("lost");
    if (silence > GIVEN_UP_MS) open();
  }, 500);
  open();
}

