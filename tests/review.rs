//! The page of `riglab review` under a person's hands, killed in the middle, and asked by strangers.

mod binary;
mod browser;

use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use binary::{must, refusal, riglab, text};
use browser::{Browser, DOWN, ENTER, ESCAPE, PAGE_DOWN, RIGHT};

/// A corpus of creatures, and one more that was dropped as the first's copy.
fn curated(dir: &Path, count: u32) -> (PathBuf, PathBuf) {
    let (files, corpus) = (dir.join("files"), dir.join("c.h5"));
    must(&["synth", "-o", text(&files), "--count", &count.to_string(), "--triangles", "400..800"]);
    let made = fs::read_dir(&files).unwrap().map(|e| e.unwrap().path());
    let first = made.filter(|p| p.extension().is_some_and(|e| e == "glb")).min();
    fs::copy(first.unwrap(), files.join("zz <b>copy.glb")).unwrap();
    must(&["curate", text(&files), "-o", text(&corpus), "--config", "curation/any.toml"]);
    (files, corpus)
}

/// The command at work; killed when it is dropped.
struct Serving(Child, String);

impl Serving {
    fn begin(args: &[&str]) -> Self {
        let mut child = riglab(args).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        assert!(url.starts_with("http://127.0.0.1:"), "{url}");
        Self(child, url.trim().to_owned())
    }
}

impl Drop for Serving {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn loaded(browser: &Browser) {
    browser.until("the sheet is drawn", |b| b.text("#tally").contains("decided"));
}

fn saved(browser: &Browser, tally: &str) {
    browser.until(tally, |b| b.text("#tally") == tally && b.text("#status") == "saved");
}

#[test]
fn a_person_decides_by_keyboard_and_mouse_and_nothing_is_lost() {
    let Some(browser) = Browser::start() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (files, corpus) = curated(dir.path(), 60);
    let decisions = dir.path().join("decisions.tsv");
    let args = ["review", text(&corpus), "--files", text(&files), "--decisions", text(&decisions)];
    let serving = Serving::begin(&args);
    browser.open(&serving.1);
    loaded(&browser);
    assert_eq!(browser.text("#tally"), "0 of 61 decided");
    let names: Vec<String> = serde_json::from_value(
        browser.script("return [...document.querySelectorAll('.card .title')].map(t => t.textContent)"),
    )
    .unwrap();
    assert_eq!(names.len(), 48); // the first sheet of two
    // Pictures come as they come into sight.
    browser.until("pictures", |b| b.script("return document.querySelector('#large').naturalWidth") == 800);
    browser.until("small ones", |b| b.script("return document.querySelector('.card img').naturalWidth") == 440);
    let asked =
        browser.script("return performance.getEntriesByType('resource').filter(r => r.name.includes('/small')).length");
    assert!(asked.as_u64().unwrap() < 48, "{asked} pictures were asked for at once");

    // By keyboard: accept the first, reject the second, say more about the third.
    browser.press(&["a", "r"]);
    browser.press(&["5"]);
    browser.press(&["f", "2", "9", ESCAPE]);
    browser.press(&["c"]);
    browser.write("both knees & <i>");
    browser.press(&[ENTER]);
    saved(&browser, "2 of 61 decided");
    // By mouse: the sign on a card, then the buttons at the side.
    browser.click(".card:nth-child(5) .quick button:last-child");
    browser.click(".card:nth-child(4)");
    browser.click("[data-verdict=accept]");
    saved(&browser, "4 of 61 decided");
    let lines = |wanted: &[&str]| {
        let text = fs::read_to_string(&decisions).unwrap();
        let found: Vec<String> = text
            .lines()
            .skip(2)
            .map(|l| {
                let f: Vec<&str> = l.split('\t').collect();
                [&[f[0]], &f[2..]].concat().join("|")
            })
            .collect();
        assert_eq!(found, wanted);
    };
    let all = [
        format!("{}|accept|||", names[0]),
        format!("{}|reject|||", names[1]),
        format!("{}|-|arthropod|joint outside the mesh,not at rest|both knees & <i>", names[2]),
        format!("{}|accept|||", names[3]),
        format!("{}|reject|||", names[4]),
    ];
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    lines(&all);
    // Undone, one at a time, wherever one is.
    browser.press(&[PAGE_DOWN]);
    browser.until("the second sheet", |b| b.text("#page") == "Sheet 2 of 2");
    browser.press(&["u"]);
    saved(&browser, "3 of 61 decided");
    assert_eq!(browser.text("#page"), "Sheet 1 of 2");
    lines(&[&all[..3], &all[4..]].concat());
    browser.press(&["a"]);
    saved(&browser, "4 of 61 decided");

    // A reload shows the same, at the same place.
    browser.press(&[DOWN, RIGHT]);
    let at = browser.text("#name");
    browser.reload();
    loaded(&browser);
    assert_eq!((browser.text("#tally"), browser.text("#name")), ("4 of 61 decided".into(), at));

    // What curation dropped is shown with its reason, and with a picture from the folder; names are text.
    browser.press(&["/"]);
    browser.write("copy");
    browser.press(&[ENTER]);
    browser.until("one is left", |b| b.text("#shown") == "1 shown");
    assert_eq!(browser.text(".card .title"), "zz <b>copy.glb");
    assert!(
        browser.text("#fate").contains("duplicates")
            && browser.script("return document.querySelector('#sheet b')").is_null()
    );
    browser.until("its picture", |b| b.script("return document.querySelector('#large').naturalWidth") == 800);
    browser.press(&["a"]);
    saved(&browser, "5 of 61 decided");

    // Killed: the page says so and takes back what it could not save; what was saved is there.
    let url = serving.1.clone();
    drop(serving);
    browser.press(&["r"]);
    browser.until("the fault is told", |b| b.text("#alert").contains("does not answer"));
    assert_eq!(browser.text("#tally"), "5 of 61 decided");
    let serving = Serving::begin(&args);
    assert_ne!(serving.1, url);
    browser.open(&serving.1);
    loaded(&browser);
    assert_eq!(browser.text("#tally"), "5 of 61 decided");

    // The next build does as was decided.
    let out = must(&[
        "curate",
        text(&files),
        "-o",
        text(&corpus),
        "--config",
        "curation/any.toml",
        "--decisions",
        text(&decisions),
        "--json",
    ]);
    let funnel: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert_eq!(funnel["kept"], 61 - 2);
}

#[test]
fn what_another_window_decided_is_shown_and_kept() {
    let Some(browser) = Browser::start() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (_, corpus) = curated(dir.path(), 3);
    let serving = Serving::begin(&["review", text(&corpus)]);
    browser.open(&serving.1);
    loaded(&browser);
    // As the other window would, which this one has not seen.
    let decided = browser.script(
        "return (async () => {
            const asset = (await (await fetch('assets')).json()).assets[0];
            const body = { name: asset.name, digest: asset.digest, verdict: 'accept', category: '', faults: [], comment: 'mine' };
            const headers = { 'Content-Type': 'application/json' };
            return (await fetch('decide', { method: 'POST', headers, body: JSON.stringify(body) })).status;
        })()",
    );
    assert_eq!(decided, 200);
    let kept = || fs::read_to_string(dir.path().join("c.decisions.tsv")).unwrap();
    browser.press(&["r"]);
    browser.until("the other is told", |b| b.text("#alert").contains("in another window"));
    assert!(kept().contains("\taccept\t") && kept().contains("mine") && !kept().contains("reject"), "{}", kept());
    assert_eq!(browser.text("#tally"), "1 of 4 decided");
    // It has been seen now.
    browser.click(".card:nth-child(1)");
    browser.press(&["r"]);
    browser.until("it is decided again", |_| kept().contains("\treject\t"));
    assert!(kept().contains("mine"), "{}", kept());
    // A second server would lose decisions of either.
    let said = refusal(&mut riglab(&["review", text(&corpus)]));
    assert!(said.contains("c.decisions.tsv: another `riglab review`"), "{said}");
}

#[test]
fn decisions_in_a_row_that_cannot_be_saved_leave_what_was_saved() {
    let Some(browser) = Browser::start() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (_, corpus) = curated(dir.path(), 3);
    let decisions = dir.path().join("c.decisions.tsv");
    let serving = Serving::begin(&["review", text(&corpus)]);
    browser.open(&serving.1);
    loaded(&browser);
    // Decisions are held back until there are several, and the first of them get no answer.
    browser.script(
        "const real = window.fetch;
        window.fetch = async (...asked) => {
            if (asked[0] === 'decide') {
                await window.gate;
                if (window.failing > 0) { window.failing -= 1; throw new TypeError('down'); }
            }
            return real(...asked);
        };",
    );
    let decide = |keys: &[&str], failing: u32| {
        browser.script(&format!("window.gate = new Promise(open => window.open = open); window.failing = {failing};"));
        browser.press(keys);
        browser.script("window.open()");
    };
    let kept = || fs::read_to_string(&decisions).unwrap_or_default();
    decide(&["5", "6"], 2);
    browser.until("the fault is told", |b| {
        b.text("#alert").contains("does not answer") && b.text("#status") == "not saved"
    });
    browser.until("both failed", |b| b.script("return window.failing") == 0);
    assert_eq!(kept(), "");
    // The first of them again: it is no second press, which would clear it.
    decide(&["5"], 0);
    browser.until("it is saved", |_| kept().contains("\tarthropod\t"));
    saved(&browser, "0 of 4 decided");
    // The second has the first in it, and nobody else decided.
    decide(&["f", "2", ESCAPE, "r"], 1);
    browser.until("the last is saved", |_| kept().contains("\treject\tarthropod\tjoint outside the mesh\t"));
    saved(&browser, "1 of 4 decided");
    assert_eq!(browser.script("return document.querySelector('#alert').hidden"), true);
    // A comment that somebody wrote by hand may be longer than what a page can send while it closes.
    drop(serving);
    let lines: Vec<String> = kept().lines().map(String::from).collect();
    let long = lines
        .iter()
        .map(|line| if line.contains("\treject\t") { line.clone() + &"x".repeat(40_000) } else { line.clone() });
    fs::write(&decisions, long.collect::<Vec<_>>().join("\n") + "\n").unwrap();
    let serving = Serving::begin(&["review", text(&corpus)]);
    browser.open(&serving.1);
    loaded(&browser);
    browser.press(&["a"]);
    saved(&browser, "1 of 4 decided");
    assert!(kept().contains("\taccept\tarthropod\t") && kept().len() > 40_000);
}

/// The address of a site of its own, with one page.
fn elsewhere() -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = listener.local_addr().unwrap().port();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let Ok(mut stream) = stream else { continue };
            let mut head = [0; 4096];
            let _ = stream.read(&mut head);
            let page = "HTTP/1.1 200 OK\r\nContent-Type: text/html\r\nContent-Length: 16\r\nConnection: close\r\n\r\n<p>elsewhere</p>";
            let _ = stream.write_all(page.as_bytes());
        }
    });
    format!("http://localhost:{port}/")
}

#[test]
fn a_page_of_another_site_reaches_nothing() {
    let Some(browser) = Browser::start() else { return };
    let dir = tempfile::tempdir().unwrap();
    let (_, corpus) = curated(dir.path(), 3);
    let serving = Serving::begin(&["review", text(&corpus)]);
    // A page of another origin, which even knows the address.
    browser.open(&elsewhere());
    let attempt = |body: &str| {
        let script = format!(
            "return (async () => {{ try {{ const r = await fetch({}, {body}); return r.type + ' ' + r.status; }} catch (e) {{ return 'refused'; }} }})()",
            serde_json::json!(format!("{}decide", serving.1))
        );
        browser.script(&script)
    };
    assert_eq!(attempt("{method: 'POST', headers: {'Content-Type': 'application/json'}, body: '{}'}"), "refused");
    // Nor when it does not want to read the answer: what a form could send.
    assert_eq!(attempt("{method: 'POST', mode: 'no-cors', body: '{}'}"), "refused");
    let read = format!(
        "return (async () => {{ try {{ const r = await fetch({}); return await r.text(); }} catch (e) {{ return 'refused'; }} }})()",
        serde_json::json!(format!("{}assets", serving.1))
    );
    assert_eq!(browser.script(&read), "refused");
    // It cannot be framed, nor a picture of it be shown.
    let picture = format!(
        "return new Promise(done => {{ const i = new Image(); i.onload = () => done('shown'); i.onerror = () => done('refused'); i.src = {}; }})",
        serde_json::json!(format!("{}picture/0/small-light.png", serving.1))
    );
    assert_eq!(browser.script(&picture), "refused");
    // Nothing was written by any of it.
    assert!(!dir.path().join("c.decisions.tsv").exists());
    // The person's own page works.
    browser.open(&serving.1);
    loaded(&browser);
    browser.press(&["a"]);
    saved(&browser, "1 of 4 decided");
    assert!(dir.path().join("c.decisions.tsv").exists());
}

#[test]
fn ctrl_c_ends_it_and_wrong_use_is_told() {
    let dir = tempfile::tempdir().unwrap();
    let (_, corpus) = curated(dir.path(), 2);
    let mut serving = Serving::begin(&["review", text(&corpus)]);
    let port = serving.1.split([':', '/']).nth(4).unwrap().to_owned();
    let taken = refusal(&mut riglab(&["review", text(&corpus), "--port", &port]));
    assert!(taken.contains(&port) && taken.contains("--port"), "{taken}");
    let killed = Command::new("kill").args(["-INT", &serving.0.id().to_string()]).status().unwrap();
    assert!(killed.success() && serving.0.wait().unwrap().success());
    let nothing = refusal(&mut riglab(&["review", text(&dir.path().join("nowhere.h5"))]));
    assert!(nothing.contains("nowhere.h5") && nothing.contains("no such corpus"), "{nothing}");
    let bad = dir.path().join("bad.tsv");
    fs::write(&bad, "one\n").unwrap();
    let said = refusal(&mut riglab(&["review", text(&corpus), "--decisions", text(&bad)]));
    assert!(said.contains("bad.tsv:1"), "{said}");
}
