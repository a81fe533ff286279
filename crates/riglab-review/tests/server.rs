//! The server over its socket: what it answers, and to whom.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpStream};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

use riglab_core::{Asset, Joint, JointId, Mesh, Provenance, Rig, Skeleton, SkinWeights};
use riglab_curate::decisions::{Decision, Decisions, Verdict};
use riglab_data::CorpusWriter;
use riglab_review::{Review, Server};

fn corpus(path: &Path, names: &[&str]) {
    let mut writer = CorpusWriter::create(path).unwrap();
    for (i, name) in names.iter().enumerate() {
        let joint = |n: &str, parent, head| Joint { name: n.into(), parent, head };
        let joints = vec![joint("a", None, [0.1; 3]), joint("b", Some(JointId(0)), [0.1, 0.6, 0.2])];
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, i as f32]], vec![[0, 1, 2]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0, 1.0)], vec![(0, 0.5), (1, 0.5)], vec![(1, 1.0)]]).unwrap();
        let rig = Rig::new(Skeleton::new(joints).unwrap(), mesh, weights).unwrap();
        let checksum = format!("{i:016x}rest");
        let provenance = Provenance { checksum, notes: vec!["<b>note</b>".into()], ..Provenance::default() };
        writer.add(&Asset { name: (*name).into(), rig, clips: Vec::new(), provenance }).unwrap();
    }
    writer.finish(&vec!["train".to_owned(); names.len()]).unwrap();
}

/// A server in a folder of its own, stopped when it is dropped.
struct Running {
    dir: tempfile::TempDir,
    server: Arc<Server>,
    thread: Option<std::thread::JoinHandle<()>>,
}

impl Running {
    fn new(names: &[&str]) -> Self {
        let dir = tempfile::tempdir().unwrap();
        corpus(&dir.path().join("c.h5"), names);
        Self::again(dir)
    }

    fn again(dir: tempfile::TempDir) -> Self {
        let review = Review::open(&dir.path().join("c.h5"), None, &dir.path().join("d.tsv")).unwrap();
        let server = Server::bind(review, 0).unwrap();
        let own = server.clone();
        Self { dir, server, thread: Some(std::thread::spawn(move || own.run())) }
    }

    /// `127.0.0.1:port` and the token.
    fn place(&self) -> (String, String) {
        let url = self.server.url();
        let (host, token) = url.strip_prefix("http://").unwrap().split_once('/').unwrap();
        (host.to_owned(), token.trim_end_matches('/').to_owned())
    }

    fn send(&self, bytes: &[u8]) -> String {
        let mut stream = TcpStream::connect(self.place().0).unwrap();
        stream.write_all(bytes).unwrap();
        let _ = stream.shutdown(Shutdown::Write);
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        String::from_utf8_lossy(&answer).into_owned()
    }

    /// Status and whole answer of a request with these headers besides `Host`.
    fn ask(&self, line: &str, headers: &str, body: &str) -> (u16, String) {
        let host = self.place().0;
        let length = if body.is_empty() { String::new() } else { format!("Content-Length: {}\r\n", body.len()) };
        let host = if headers.contains("Host:") { String::new() } else { format!("Host: {host}\r\n") };
        let answer = self.send(format!("{line} HTTP/1.1\r\n{host}{headers}{length}\r\n{body}").as_bytes());
        (answer.get(9..12).and_then(|s| s.parse().ok()).unwrap_or(0), answer)
    }

    fn get(&self, path: &str) -> (u16, String) {
        self.ask(&format!("GET /{}/{path}", self.place().1), "", "")
    }

    fn decide(&self, body: &str) -> (u16, String) {
        let (host, token) = self.place();
        let headers = format!("Origin: http://{host}\r\nContent-Type: application/json\r\n");
        self.ask(&format!("POST /{token}/decide"), &headers, body)
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.server.stop().stop();
        // It answered to its end: no thread of it panicked for good.
        assert!(self.thread.take().unwrap().join().is_ok());
    }
}

fn accept(name: &str, number: usize) -> String {
    format!(
        r#"{{"name":"{name}","digest":"{number:016x}","verdict":"accept","category":"","faults":["knees, both"],"comment":"a\tb"}}"#
    )
}

#[test]
fn the_page_and_its_parts_are_served_with_all_guards() {
    let running = Running::new(&["a.glb", "b.glb"]);
    for (path, kind) in [
        ("", "text/html"),
        ("review.js", "text/javascript"),
        ("style.css", "text/css"),
        ("icon.svg", "image/svg+xml"),
        ("assets", "application/json"),
        ("picture/1/small-light.png", "image/png"),
        ("picture/0/large-dark.png", "image/png"),
    ] {
        let (status, answer) = running.get(path);
        assert!(status == 200 && answer.contains(&format!("Content-Type: {kind}")), "{path}: {answer}");
        for guard in ["default-src 'none'", "frame-ancestors 'none'", "nosniff", "no-referrer", "same-origin"] {
            assert!(answer.contains(guard), "{path}: {guard}");
        }
        assert!(!answer.contains("Access-Control"), "{path}");
    }
    // Names from files are data, in JSON alone; the page sets them as text.
    let script =
        [include_str!("../page/review.js"), include_str!("../page/sheet.js"), include_str!("../page/detail.js")];
    assert!(script.iter().all(|s| !s.contains("innerHTML") && !s.contains("eval(") && !s.contains("insertAdjacent")));
    let page = include_str!("../page/index.html");
    assert!(
        !page.contains("http:") && !page.contains("https:") && !page.contains("style=") && !page.contains("onclick")
    );
}

#[test]
fn the_page_knows_the_corpus_with_its_folder() {
    // Its command for the next build would else write beside it.
    let running = Running::new(&["a"]);
    let (_, answer) = running.get("assets");
    let all: serde_json::Value = serde_json::from_str(answer.split("\r\n\r\n").nth(1).unwrap()).unwrap();
    let whole = running.dir.path().join("c.h5").display().to_string();
    assert_eq!((all["title"].as_str(), all["corpus"].as_str()), (Some("c.h5"), Some(whole.as_str())));
    assert!(running.get("review.js").1.contains("-o ${quoted(loaded.corpus)}"));
}

#[test]
fn who_was_not_given_the_address_is_refused() {
    let running = Running::new(&["a.glb"]);
    let (host, token) = running.place();
    let port = host.rsplit(':').next().unwrap().to_owned();
    let refused = |line: &str, headers: &str| {
        let (status, answer) = running.ask(line, headers, "");
        assert!(status == 403 && !answer.contains("a.glb"), "{line} {headers}: {answer}");
    };
    let right = format!("GET /{token}/assets");
    for path in ["/", "/assets", "//assets", "/x/assets", "*", "http://127.0.0.1/assets"] {
        refused(&format!("GET {path}"), "");
    }
    refused(&format!("GET /{}/assets", &token[1..]), "");
    refused(&format!("GET /{}/assets", token.to_lowercase() + "A"), "");
    refused(&format!("GET /%{:02x}{}/assets", token.as_bytes()[0], &token[1..]), "");
    // A name that was rebound to this machine.
    for name in ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example", "127.0.0.1@evil.example", "[::1]"]
    {
        refused(&right, &format!("Host: {name}:{port}\r\n"));
    }
    refused(&right, "Host:\r\n");
    refused(&right, "Host: localhost:\r\n");
    // Another site, and another page of this machine.
    for origin in ["http://evil.example", "null", "http://localhost:1", &format!("https://{host}"), "file://"] {
        refused(&right, &format!("Origin: {origin}\r\n"));
    }
    refused(&right, "Sec-Fetch-Site: cross-site\r\n");
    refused(&right, "Sec-Fetch-Site: same-site\r\n");
    assert_eq!(running.ask(&right, "Host: a\r\nHost: b\r\n", "").0, 400);
    // A forwarded port has another number.
    assert_eq!(running.ask(&right, "Host: localhost:9999\r\nOrigin: http://localhost:9999\r\n", "").0, 200);
    // What is written says where it is from, and in what type.
    let post = format!("POST /{token}/decide");
    let json = "Content-Type: application/json\r\n";
    assert_eq!(running.ask(&post, json, &accept("a.glb", 0)).0, 403);
    assert_eq!(running.ask(&post, &format!("{json}Origin: http://evil.example\r\n"), &accept("a.glb", 0)).0, 403);
    let own = format!("Origin: http://{host}\r\n");
    assert_eq!(running.ask(&post, &format!("{own}Content-Type: text/plain\r\n"), &accept("a.glb", 0)).0, 415);
    assert!(!running.dir.path().join("d.tsv").exists());
}

#[test]
fn only_this_machine_can_connect() {
    let running = Running::new(&["a.glb"]);
    let port: u16 = running.place().0.rsplit(':').next().unwrap().parse().unwrap();
    // Another address of this machine is another host's way in.
    let other = std::net::UdpSocket::bind("0.0.0.0:0").and_then(|s| {
        s.connect("192.0.2.1:9")?;
        s.local_addr()
    });
    for ip in [other.map(|a| a.ip()).ok(), "127.0.0.2".parse().ok(), "::1".parse().ok()].into_iter().flatten() {
        let there = TcpStream::connect_timeout(&(ip, port).into(), Duration::from_millis(500));
        assert!(ip == std::net::Ipv4Addr::LOCALHOST || there.is_err(), "{ip}");
    }
}

#[test]
fn paths_lead_nowhere() {
    let running = Running::new(&["a.glb"]);
    std::fs::write(running.dir.path().join("secret"), "hidden").unwrap();
    let long = "a/".repeat(2000);
    for path in [
        "../secret",
        "..%2fsecret",
        "%2e%2e/secret",
        "./",
        "/etc/passwd",
        "review.js/../secret",
        "c.h5",
        "d.tsv",
        "picture/",
        "picture/0/",
        "picture/0/huge.png",
        "picture/9/small-light.png",
        "picture/-1/small-light.png",
        "picture/99999999999999999999999/small-light.png",
        "picture/0/../0/small-light.png",
        "decide",
        "%",
        "\u{e9}",
        &long,
    ] {
        let (status, answer) = running.get(path);
        assert!(matches!(status, 400 | 404) && !answer.contains("hidden"), "{path}: {answer}");
    }
    assert_eq!(running.ask(&format!("DELETE /{}/assets", running.place().1), "", "").0, 405);
}

#[test]
fn decisions_are_on_the_disk_when_the_page_is_told_and_after_a_restart() {
    let odd = "\u{e9}<script>alert(1)</script>\".glb";
    let running = Running::new(&["a.glb", odd, "c.glb"]);
    let file = running.dir.path().join("d.tsv");
    let (status, answer) = running.decide(&accept("a.glb", 0));
    assert!(status == 200 && answer.ends_with(r#"{"decided":1}"#), "{answer}");
    assert_eq!(running.decide(&accept(&odd.replace('"', "\\\""), 1)).0, 200);
    let now = Decisions::read(&file).unwrap();
    let kept = now.get(odd, "0000000000000001").unwrap();
    assert_eq!(
        (kept.verdict, kept.faults.as_slice(), kept.comment.as_str()),
        (Verdict::Accept, &["knees  both".to_owned()][..], "a\tb")
    );
    // Taken back, and the line is gone.
    let back = r#"{"name":"a.glb","digest":"0000000000000000","verdict":"-","category":"","faults":[],"comment":""}"#;
    assert!(running.decide(back).1.ends_with(r#"{"decided":1}"#));
    // Nothing is left behind beside it.
    assert_eq!(std::fs::read_dir(running.dir.path()).unwrap().count(), 2);
    let before = running.place();
    let dir = tempfile::tempdir().unwrap();
    for name in ["c.h5", "d.tsv"] {
        std::fs::copy(running.dir.path().join(name), dir.path().join(name)).unwrap();
    }
    let again = Running::again(dir);
    assert_ne!(again.place().1, before.1);
    assert_eq!(again.server.review().tally().decided, 1);
    assert!(again.get("assets").1.contains(r#""verdict":"accept""#));
}

#[test]
fn a_stale_window_is_told_and_wipes_nothing() {
    let running = Running::new(&["a.glb"]);
    let was = |body: &str, was: &str| format!(r#"{},"was":{was}}}"#, &body[..body.len() - 1]);
    let nothing = r#"{"verdict":"-","category":"","faults":[],"comment":""}"#;
    let good = accept("a.glb", 0);
    assert_eq!(running.decide(&was(&good, nothing)).0, 200);
    // Another window of the same page, loaded before.
    let stale = good.replace("accept", "reject").replace("a\\tb", "");
    let (status, answer) = running.decide(&was(&stale, nothing));
    assert!(status == 409 && answer.contains("application/json") && answer.contains("\"newer\":{"), "{answer}");
    assert!(answer.contains(r#""comment":"a\tb""#), "{answer}");
    let now = Decisions::read(&running.dir.path().join("d.tsv")).unwrap();
    let kept = now.get("a.glb", "0000000000000000").unwrap();
    assert_eq!((kept.verdict, kept.comment.as_str()), (Verdict::Accept, "a\tb"));
    // It has seen it now.
    let seen = r#"{"verdict":"accept","category":"","faults":["knees  both"],"comment":"a\tb"}"#;
    assert_eq!(running.decide(&was(&stale, seen)).0, 200);
    assert_eq!(running.decide(&was(&good, r#"{"verdict":"maybe"}"#)).0, 400);
}

#[test]
fn an_asset_with_a_long_comment_from_elsewhere_can_be_decided_about() {
    let dir = tempfile::tempdir().unwrap();
    corpus(&dir.path().join("c.h5"), &["a.glb"]);
    let comment = "x".repeat(40_000);
    let mut all = Decisions::default();
    all.set("a.glb", "0000000000000000", Decision { comment: comment.clone(), ..Decision::default() });
    all.write(&dir.path().join("d.tsv")).unwrap();
    let running = Running::again(dir);
    let record = |verdict: &str| format!(r#""verdict":"{verdict}","category":"","faults":[],"comment":"{comment}""#);
    let key = r#""name":"a.glb","digest":"0000000000000000""#;
    let body = format!("{{{key},{},\"was\":{{{}}}}}", record("accept"), record("-"));
    assert!(body.len() > 64 << 10);
    assert_eq!(running.decide(&body).0, 200);
    let now = Decisions::read(&running.dir.path().join("d.tsv")).unwrap();
    let kept = now.get("a.glb", "0000000000000000").unwrap();
    assert_eq!((kept.verdict, kept.comment.len()), (Verdict::Accept, comment.len()));
}

#[test]
fn a_second_server_on_the_same_decisions_is_refused() {
    let running = Running::new(&["a.glb"]);
    let second = || {
        let review = Review::open(&running.dir.path().join("c.h5"), None, &running.dir.path().join("d.tsv")).unwrap();
        Server::bind(review, 0).err().map(|e| e.to_string())
    };
    let said = second().unwrap();
    assert!(said.contains("d.tsv: another `riglab review`"), "{said}");
    assert_eq!(running.decide(&accept("a.glb", 0)).0, 200);
    assert!(second().is_some());
}

#[test]
fn what_is_no_decision_changes_nothing() {
    let running = Running::new(&["a.glb"]);
    let good = accept("a.glb", 0);
    for (body, status) in [
        (String::new(), 400),
        ("{".into(), 400),
        ("[".repeat(60_000), 400),
        (good.replace("accept", "maybe"), 400),
        (good.replace(r#""category":"""#, r#""category":"bird""#), 400),
        (good.replace("}", r#","more":1}"#), 400),
        (good.replace("a\\tb", &"x".repeat(4001)), 400),
        (good.replace("knees", &"x".repeat(81)), 400),
        (good.replace("a.glb", "b.glb"), 404),
        (good.replace("0000", "0001"), 404),
        (good.replace("a\\tb", &"x".repeat(70_000)), 400),
        (good.replace("a\\tb", &"x".repeat(1 << 20)), 413),
    ] {
        assert_eq!(running.decide(&body).0, status, "{}", body.get(..80).unwrap_or(&body));
    }
    assert!(!running.dir.path().join("d.tsv").exists());
    // A file in conflict is told, and left as it is.
    std::fs::write(running.dir.path().join("d.tsv"), "<<<<<<< ours\n").unwrap();
    let (status, answer) = running.decide(&good);
    assert!(status == 409 && answer.contains("d.tsv:1: a conflict"), "{answer}");
    assert_eq!(std::fs::read(running.dir.path().join("d.tsv")).unwrap(), b"<<<<<<< ours\n");
}

#[test]
fn rubbish_and_idlers_do_not_keep_others_out() {
    let running = Running::new(&["a.glb"]);
    let (host, _) = running.place();
    let idle: Vec<TcpStream> = (0..40).map(|_| TcpStream::connect(&host).unwrap()).collect();
    let whole = format!("GET /{}/assets HTTP/1.1\r\nHost: {host}\r\n\r\n", running.place().1);
    for cut in 0..whole.len() {
        assert!(!running.send(&whole.as_bytes()[..cut]).contains("a.glb"));
    }
    let mut byte = 1u8;
    for length in [1, 100, 5000, 40_000] {
        let noise = std::iter::repeat_with(|| {
            byte = byte.wrapping_mul(197).wrapping_add(31);
            byte
        });
        running.send(&noise.take(length).collect::<Vec<u8>>());
    }
    assert!(running.send(b"GET example.com:80 HTTP/1.1\r\nHost: localhost\r\n\r\n").contains("403"));
    assert!(running.send(b"CONNECT a:1 HTTP/1.1\r\nHost: localhost\r\n\r\n").contains("403"));
    let begun = Instant::now();
    assert_eq!(running.get("assets").0, 200);
    assert!(begun.elapsed() < Duration::from_secs(2));
    drop(idle);
}
