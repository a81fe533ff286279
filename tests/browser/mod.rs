//! A headless Chromium, driven over WebDriver by Debian's chromedriver: what a person's hands would do.

#![allow(dead_code)] // each test takes what it needs

use std::net::TcpListener;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};

/// Keys without a letter, as WebDriver writes them.
pub const ENTER: &str = "\u{e007}";
pub const ESCAPE: &str = "\u{e00c}";
pub const TAB: &str = "\u{e004}";
pub const RIGHT: &str = "\u{e014}";
pub const DOWN: &str = "\u{e015}";
pub const PAGE_DOWN: &str = "\u{e00f}";

/// A browser; closed when it is dropped.
pub struct Browser {
    driver: Child,
    session: String,
    agent: ureq::Agent,
    _profile: tempfile::TempDir,
}

/// A program by a variable, else by its name in `PATH`.
fn program(variable: &str, names: &[&str]) -> Option<PathBuf> {
    if let Some(path) = std::env::var_os(variable) {
        return Some(path.into());
    }
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path).flat_map(|dir| names.iter().map(move |name| dir.join(name))).find(|p| p.is_file())
}

impl Browser {
    /// Starts one; `None`, with a line that says so, on a machine that has none.
    pub fn start() -> Option<Self> {
        let chromium = program("RIGLAB_CHROMIUM", &["chromium", "chromium-browser", "google-chrome"]);
        let driver = program("RIGLAB_CHROMEDRIVER", &["chromedriver"]);
        let (Some(chromium), Some(driver)) = (chromium, driver) else {
            println!(
                "skipped: no Chromium with chromedriver (Debian: chromium chromium-driver; or set RIGLAB_CHROMIUM and RIGLAB_CHROMEDRIVER)"
            );
            return None;
        };
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let quiet = || Stdio::null();
        let mut driver = Command::new(driver);
        let driver = driver.arg(format!("--port={port}")).stdout(quiet()).stderr(quiet()).spawn().unwrap();
        let profile = tempfile::tempdir().unwrap();
        let config = ureq::Agent::config_builder().timeout_global(Some(Duration::from_secs(60)));
        let agent = config.http_status_as_error(false).proxy(None).build().new_agent();
        let mut this = Self { driver, session: format!("http://127.0.0.1:{port}"), agent, _profile: profile };
        this.until("chromedriver is up", |b| b.call("GET", "/status", &Value::Null).is_ok());
        let data = format!("--user-data-dir={}", this._profile.path().display());
        let args = [
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
            "--window-size=1280,937",
            &data,
        ];
        let options = json!({ "binary": chromium, "args": args });
        let logs = json!({ "browser": "ALL" });
        let always = json!({ "browserName": "chrome", "goog:chromeOptions": options, "goog:loggingPrefs": logs });
        let wanted = json!({ "capabilities": { "alwaysMatch": always } });
        let begun = this.call("POST", "/session", &wanted).expect("Chromium starts");
        this.session += &format!("/session/{}", begun["sessionId"].as_str().unwrap());
        Some(this)
    }

    fn call(&self, method: &str, path: &str, body: &Value) -> Result<Value, String> {
        let url = format!("{}{path}", self.session);
        let sent = match method {
            "GET" => self.agent.get(&url).call(),
            "DELETE" => self.agent.delete(&url).call(),
            _ => self.agent.post(&url).content_type("application/json").send(body.to_string()),
        };
        let text = sent.and_then(|mut r| r.body_mut().read_to_string()).map_err(|e| e.to_string())?;
        let answer: Value = serde_json::from_str(&text).map_err(|e| e.to_string())?;
        match answer["value"].get("error") {
            Some(_) => Err(answer["value"].to_string()),
            None => Ok(answer["value"].clone()),
        }
    }

    /// Opens an address, as a person who types it.
    pub fn open(&self, url: &str) {
        self.call("POST", "/url", &json!({ "url": url })).unwrap();
    }

    pub fn reload(&self) {
        self.call("POST", "/refresh", &json!({})).unwrap();
    }

    /// Presses keys one after the other.
    pub fn press(&self, keys: &[&str]) {
        let each = keys
            .iter()
            .flat_map(|key| [json!({"type": "keyDown", "value": key}), json!({"type": "keyUp", "value": key})]);
        let actions = json!({ "actions": [{ "type": "key", "id": "keyboard", "actions": each.collect::<Vec<_>>() }] });
        self.call("POST", "/actions", &actions).unwrap();
    }

    /// Types a text.
    pub fn write(&self, text: &str) {
        let letters: Vec<String> = text.chars().map(String::from).collect();
        self.press(&letters.iter().map(String::as_str).collect::<Vec<_>>());
    }

    /// Moves the mouse to the middle of what a selector finds first, and clicks.
    pub fn click(&self, selector: &str) {
        self.drag(selector, [0, 0]);
    }

    /// Drags by so many pixels from the middle of what a selector finds first.
    pub fn drag(&self, selector: &str, by: [i32; 2]) {
        let found = self.call("POST", "/element", &json!({ "using": "css selector", "value": selector }));
        let element = found.unwrap_or_else(|e| panic!("{selector}: {e}"));
        self.until_still(selector);
        let mut actions = vec![
            json!({ "type": "pointerMove", "origin": element, "x": 0, "y": 0 }),
            json!({ "type": "pointerDown", "button": 0 }),
        ];
        if by != [0, 0] {
            actions.push(json!({ "type": "pointerMove", "origin": "pointer", "x": by[0], "y": by[1] }));
        }
        actions.push(json!({ "type": "pointerUp", "button": 0 }));
        let mouse = json!({ "actions": [{ "type": "pointer", "id": "mouse", "actions": actions }] });
        self.call("POST", "/actions", &mouse).unwrap();
    }

    /// Waits until what a selector finds first has stood still for a while: on a slow machine pictures that come move
    /// what lies below them, and a click would miss.
    fn until_still(&self, selector: &str) {
        let script = format!(
            "const r = document.querySelector({}).getBoundingClientRect(); return [r.x, r.y, r.width, r.height]",
            json!(selector)
        );
        let (mut place, mut since) = (self.script(&script), Instant::now());
        while since.elapsed() < Duration::from_millis(150) {
            std::thread::sleep(Duration::from_millis(30));
            let now = self.script(&script);
            if now != place {
                (place, since) = (now, Instant::now());
            }
        }
    }

    /// What a script returns; a promise is waited for.
    pub fn script(&self, text: &str) -> Value {
        self.call("POST", "/execute/sync", &json!({ "script": text, "args": [] }))
            .unwrap_or_else(|e| panic!("{text}: {e}"))
    }

    /// What the console has said since it was asked last, warnings and errors.
    pub fn complaints(&self) -> Vec<String> {
        let said = self.call("POST", "/se/log", &json!({ "type": "browser" })).unwrap_or_default();
        let bad = |line: &&Value| line["level"] == "SEVERE" || line["level"] == "WARNING";
        said.as_array().into_iter().flatten().filter(bad).map(|line| line["message"].to_string()).collect()
    }

    /// The window's size, in pixels.
    pub fn resize(&self, width: u32, height: u32) {
        self.call("POST", "/window/rect", &json!({ "width": width, "height": height })).unwrap();
    }

    /// A picture of the window, as a PNG file in base64.
    pub fn screenshot(&self) -> String {
        self.call("GET", "/screenshot", &Value::Null).unwrap().as_str().unwrap_or_default().to_owned()
    }

    /// The text of what a selector finds first.
    pub fn text(&self, selector: &str) -> String {
        let script = format!("return document.querySelector({})?.textContent ?? ''", json!(selector));
        self.script(&script).as_str().unwrap_or_default().to_owned()
    }

    /// Waits until something holds.
    pub fn until(&self, what: &str, holds: impl Fn(&Self) -> bool) {
        let begun = Instant::now();
        while !holds(self) {
            assert!(begun.elapsed() < Duration::from_secs(30), "waited for: {what}");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.call("DELETE", "", &Value::Null);
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}
