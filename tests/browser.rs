//! A real Chromium without a window, controlled by its DevTools protocol through a pipe.

use crate::{Outcome, wait_until};
use rustix::process::{Pid, Signal, kill_process_group};
use serde_json::{Value, json};
use std::error::Error;
use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{self, Receiver};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Names of its program, in the order of the search.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
/// Time for an answer. Far longer than needed.
const ANSWERS_WITHIN: Duration = Duration::from_mins(2);
/// Chromium reads descriptor 3 and writes descriptor 4; its errors go into the file `$0`.
const WITH_PIPE: &str = "exec \"$@\" 3<&0 4>&1 0</dev/null 1>\"$0\" 2>&1";
const ARGUMENTS: [&str; 12] = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-default-apps",
    "--mute-audio",
    "--remote-debugging-pipe",
];

/// One tab of a browser of its own; both end with this value.
pub struct Browser {
    child: Child,
    input: ChildStdin,
    answers: Receiver<Value>,
    session: Option<String>,
    calls: u64,
    requested: Vec<String>,
    complaints: Vec<String>,
    profile: TempDir,
}

impl Browser {
    /// Opens an empty tab.
    ///
    /// # Errors
    /// If there is no Chromium, or it does not start.
    pub fn start() -> Result<Self, Box<dyn Error>> {
        let program = program()?;
        let profile = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
        let mut command = Command::new("sh");
        command
            .args(["-c", WITH_PIPE])
            .arg(profile.path().join("complaints.log"))
            .arg(&program)
            .args(ARGUMENTS);
        command.arg(format!("--user-data-dir={}", profile.path().join("profile").display()));
        command.env("HOME", profile.path()).env("TMPDIR", profile.path());
        // A group of its own, which a test may stop or kill.
        command.process_group(0).stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn()?;
        let input = child.stdin.take().ok_or("no input")?;
        let mut output = BufReader::new(child.stdout.take().ok_or("no output")?);
        let (received, answers) = mpsc::channel();
        thread::spawn(move || {
            let mut message = Vec::new();
            while output.read_until(0, &mut message).is_ok_and(|count| count > 0) {
                let parsed = serde_json::from_slice(message.strip_suffix(&[0]).unwrap_or(&message));
                if !parsed.is_ok_and(|parsed: Value| received.send(parsed).is_ok()) {
                    break;
                }
                message.clear();
            }
        });
        let (requested, complaints) = (Vec::new(), Vec::new());
        let mut browser =
            Self { child, input, answers, session: None, calls: 0, requested, complaints, profile };
        let tab = browser.call("Target.createTarget", &json!({"url": "about:blank"}))?;
        let attached = browser.call(
            "Target.attachToTarget",
            &json!({"targetId": tab["targetId"], "flatten": true}),
        )?;
        browser.session = attached["sessionId"].as_str().map(str::to_owned);
        for domain in ["Page", "Runtime", "Network", "Log"] {
            browser.call(&format!("{domain}.enable"), &json!({}))?;
        }
        browser.call("Emulation.setFocusEmulationEnabled", &json!({"enabled": true}))?;
        Ok(browser)
    }

    /// Goes to `url`, in a window of this size.
    ///
    /// # Errors
    /// If the page cannot be opened.
    pub fn open(&mut self, url: &str, width: u32, height: u32) -> Outcome {
        self.resize(width, height, false)?;
        let opened = self.call("Page.navigate", &json!({"url": url}))?;
        if let Some(error) = opened["errorText"].as_str() {
            return Err(format!("{url}: {error}").into());
        }
        self.wait_for("document.readyState === 'complete'")
    }

    /// Sets the size of the window, or the screen of a phone.
    ///
    /// # Errors
    /// If the browser refuses it.
    pub fn resize(&mut self, width: u32, height: u32, phone: bool) -> Outcome {
        let metrics = json!({
            "width": width,
            "height": height,
            "deviceScaleFactor": if phone { 2 } else { 1 },
            "mobile": phone,
        });
        self.call("Emulation.setDeviceMetricsOverride", &metrics).map(drop)
    }

    /// Sets the preferred colour scheme, `dark` or `light`.
    ///
    /// # Errors
    /// If the browser refuses it.
    pub fn prefer(&mut self, scheme: &str) -> Outcome {
        let features = json!({"features": [{"name": "prefers-color-scheme", "value": scheme}]});
        self.call("Emulation.setEmulatedMedia", &features).map(drop)
    }

    /// Presses and releases a key, such as `Tab`, `Enter` or `Space`.
    ///
    /// # Errors
    /// If the browser refuses it.
    pub fn press(&mut self, key: &str) -> Outcome {
        let (key, code, text) = match key {
            "Tab" => ("Tab", 9, ""),
            "Enter" => ("Enter", 13, "\r"),
            "Space" => (" ", 32, " "),
            other => return Err(format!("which key is {other}?").into()),
        };
        let down = if text.is_empty() { "rawKeyDown" } else { "keyDown" };
        self.call(
            "Input.dispatchKeyEvent",
            &json!({"type": down, "key": key, "windowsVirtualKeyCode": code, "text": text}),
        )?;
        self.call(
            "Input.dispatchKeyEvent",
            &json!({"type": "keyUp", "key": key, "windowsVirtualKeyCode": code}),
        )
        .map(drop)
    }

    /// Value of `expression` on the page.
    ///
    /// # Errors
    /// If it throws.
    pub fn ask(&mut self, expression: &str) -> Result<Value, Box<dyn Error>> {
        let mut answer = self.call(
            "Runtime.evaluate",
            &json!({"expression": expression, "returnByValue": true, "awaitPromise": true}),
        )?;
        if answer.get("exceptionDetails").is_some() {
            return Err(format!("{expression}: {}", answer["exceptionDetails"]).into());
        }
        Ok(answer["result"]["value"].take())
    }

    /// The text of the element with this id.
    ///
    /// # Errors
    /// If there is none.
    pub fn text(&mut self, id: &str) -> Result<String, Box<dyn Error>> {
        let text = self.ask(&format!("document.getElementById({id:?}).innerText"))?;
        Ok(text.as_str().ok_or("no text")?.to_owned())
    }

    /// Waits until `condition` is true on the page.
    ///
    /// # Errors
    /// If it never is; the error contains the text of the page.
    pub fn wait_for(&mut self, condition: &str) -> Outcome {
        let mut failed = None;
        let waited = wait_until(condition, || match self.ask(condition) {
            Ok(value) => value == json!(true),
            Err(error) => {
                failed = Some(error.to_string());
                true
            }
        });
        if let Some(error) = failed {
            return Err(error.into());
        }
        waited.map_err(|error| {
            let shown = self.ask("document.body.innerText").unwrap_or_default();
            format!("{error}; the page shows {shown} and complains of {:?}", self.complaints).into()
        })
    }

    /// A picture of the window, as PNG.
    ///
    /// # Errors
    /// If it cannot be taken.
    pub fn picture(&mut self) -> Result<Vec<u8>, Box<dyn Error>> {
        let picture = self.call("Page.captureScreenshot", &json!({"format": "png"}))?;
        decoded(picture["data"].as_str().ok_or("no picture")?).ok_or_else(|| "not base64".into())
    }

    /// Counts the pixels of the element found by `selector` that have the colour called `colour` in
    /// the page's style.
    ///
    /// # Errors
    /// If there is no such element or colour, or no picture can be taken.
    pub fn seen(&mut self, selector: &str, colour: &str) -> Result<u64, Box<dyn Error>> {
        let place = self.ask(&format!(
            "(({{x, y, width, height}}) => \
            ({{x: x + scrollX, y: y + scrollY, width, height, scale: 1}}))
                (document.querySelector({selector:?}).getBoundingClientRect())"
        ))?;
        let picture = self.call(
            "Page.captureScreenshot",
            &json!({"format": "png", "clip": place, "captureBeyondViewport": true}),
        )?;
        let count = self.ask(&format!(
            "(async () => {{
                const wanted = \
                getComputedStyle(document.documentElement).getPropertyValue('--{colour}').trim();
                if (!CSS.supports('color', wanted)) throw new Error('no colour {colour}');
                const image = new Image();
                image.src = 'data:image/png;base64,' + {};
                await image.decode();
                const pen = new OffscreenCanvas(image.width, image.height + 1).getContext('2d');
                pen.drawImage(image, 0, 1);
                pen.fillStyle = wanted;
                pen.fillRect(0, 0, 1, 1);
                const probe = pen.getImageData(0, 0, 1, 1).data;
                const {{data}} = pen.getImageData(0, 1, image.width, image.height);
                let count = 0;
                for (let at = 0; at < data.length; at += 4) count += \
                [0, 1, 2].every((part) => Math.abs(data[at + part] - probe[part]) < 12);
                return count;
            }})()",
            picture["data"]
        ))?;
        count.as_u64().ok_or_else(|| format!("{count} is no number of pixels").into())
    }

    /// Sends a signal to all of its processes.
    ///
    /// # Errors
    /// If they have ended.
    pub fn signal(&self, signal: Signal) -> Outcome {
        let group = Pid::from_raw(i32::try_from(self.child.id())?).ok_or("no such group")?;
        Ok(kill_process_group(group, signal)?)
    }

    /// Every address requested so far.
    pub fn requested(&self) -> &[String] {
        &self.requested
    }

    /// Exceptions, and the errors of the console and of the page's policy.
    pub fn complaints(&self) -> &[String] {
        &self.complaints
    }

    fn call(&mut self, method: &str, parameters: &Value) -> Result<Value, Box<dyn Error>> {
        self.calls += 1;
        let mut message = json!({"id": self.calls, "method": method, "params": parameters});
        if let Some(session) = &self.session {
            message["sessionId"] = json!(session);
        }
        let sent = self
            .input
            .write_all(format!("{message}\0").as_bytes())
            .and_then(|()| self.input.flush());
        sent.map_err(|error| format!("{method}: {error}; {}", self.last_words()))?;
        let begin = Instant::now();
        loop {
            let left = ANSWERS_WITHIN.saturating_sub(begin.elapsed());
            let mut answer = self
                .answers
                .recv_timeout(left)
                .map_err(|error| format!("{method}: {error}; {}", self.last_words()))?;
            if answer["id"] != json!(self.calls) {
                self.note_event(&answer);
            } else if answer.get("error").is_some() {
                return Err(format!("{method}: {}", answer["error"]).into());
            } else {
                return Ok(answer["result"].take());
            }
        }
    }

    fn note_event(&mut self, told: &Value) {
        let parameters = &told["params"];
        match told["method"].as_str() {
            Some("Network.requestWillBeSent") => {
                self.requested.extend(parameters["request"]["url"].as_str().map(str::to_owned));
            }
            Some("Runtime.exceptionThrown") => {
                self.complaints.push(parameters["exceptionDetails"].to_string());
            }
            Some("Log.entryAdded") if parameters["entry"]["level"] == "error" => {
                self.complaints.push(parameters["entry"]["text"].to_string());
            }
            _ => {}
        }
    }

    fn last_words(&self) -> String {
        let text =
            fs::read_to_string(self.profile.path().join("complaints.log")).unwrap_or_default();
        format!("the browser said: {}", text.trim())
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        self.session = None;
        // Its helper processes end with it if it closes in order.
        let asked = self.call("Browser.close", &json!({}));
        let ended = asked.and_then(|_| {
            wait_until("the end of the browser", || !matches!(self.child.try_wait(), Ok(None)))
        });
        if ended.is_err() {
            let _ = self.child.kill();
            let _ = self.child.wait();
        }
    }
}

fn program() -> Result<PathBuf, String> {
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = NAMES
        .iter()
        .flat_map(|name| std::env::split_paths(&folders).map(move |folder| folder.join(name)))
        .find(|path| path.is_file());
    found.ok_or_else(|| {
        format!(
            "the live page is tested in a real browser, but PATH has none of {}: install \
            Debian's chromium",
            NAMES.join(", ")
        )
    })
}

/// Base64.
fn decoded(text: &str) -> Option<Vec<u8>> {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3);
    let (mut held, mut bits) = (0_u32, 0);
    for digit in text.bytes().filter(|&digit| digit != b'=') {
        held = held << 6 | DIGITS.iter().position(|&known| known == digit)? as u32;
        bits += 6;
        if bits >= 8 {
            bits -= 8;
            bytes.push((held >> bits) as u8);
            held &= (1 << bits) - 1;
        }
    }
    Some(bytes)
}
