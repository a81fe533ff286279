use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use riglab_synth::{Options, creature};

use super::*;

/// What the server does with a request.
#[derive(Clone)]
enum Reply {
    /// Says this.
    Say(&'static str),
    /// Answers with a status and one more header.
    Status(u16, &'static str),
    /// Sends these bytes for a body.
    Raw(&'static str),
    /// Keeps silent.
    Hang,
}

struct Server {
    url: String,
    requests: Arc<Mutex<Vec<String>>>,
}

/// A server on this machine that goes through replies and repeats the last.
fn server(replies: Vec<Reply>) -> Server {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let url = format!("http://{}/v1", listener.local_addr().unwrap());
    let requests: Arc<Mutex<Vec<String>>> = Arc::default();
    let log = requests.clone();
    std::thread::spawn(move || {
        for (n, stream) in listener.incoming().enumerate() {
            let Ok(mut stream) = stream else { return };
            let reply = replies[n.min(replies.len() - 1)].clone();
            let log = log.clone();
            std::thread::spawn(move || {
                let Some(request) = request(&mut stream) else { return };
                log.lock().unwrap().push(request);
                let (status, header, body) = match reply {
                    Reply::Say(text) => {
                        let body =
                            serde_json::json!({"choices": [{"message": {"role": "assistant", "content": text}}]});
                        (200, "", body.to_string())
                    }
                    Reply::Status(status, header) => (status, header, "{\"error\": \"no\"}".into()),
                    Reply::Raw(body) => (200, "", body.into()),
                    Reply::Hang => return std::thread::sleep(Duration::from_secs(5)),
                };
                let head =
                    format!("HTTP/1.1 {status} X\r\nContent-Type: application/json\r\n{header}Connection: close\r\n");
                let _ = write!(stream, "{head}Content-Length: {}\r\n\r\n{body}", body.len());
            });
        }
    });
    Server { url, requests }
}

/// Head and body of a request, by its content length.
fn request(stream: &mut impl Read) -> Option<String> {
    let mut bytes = Vec::new();
    let mut buffer = [0; 4096];
    loop {
        let n = stream.read(&mut buffer).ok().filter(|n| *n > 0)?;
        bytes.extend_from_slice(&buffer[..n]);
        let text = String::from_utf8_lossy(&bytes);
        let Some((head, body)) = text.split_once("\r\n\r\n") else { continue };
        let length =
            head.lines().find_map(|l| l.to_lowercase().strip_prefix("content-length:")?.trim().parse::<usize>().ok());
        if body.len() >= length.unwrap_or(0) {
            return Some(text.into_owned());
        }
    }
}

fn asker(server: &Server, cache: &Path) -> Asker {
    let config = VlmConfig {
        url: server.url.clone(),
        model: "seer".into(),
        key_from: String::new(),
        pixels: 32,
        views: vec![0.0, 90.0],
        timeout_s: 0.5,
        retries: 3,
        wait_s: 0.01,
        wait_most_s: 0.3,
        parallel: 2,
        give_up_after: 6,
        ..VlmConfig::default()
    };
    Asker::new(&config, cache).unwrap()
}

fn rigs(n: u64) -> Vec<Rig> {
    (0..n).map(|k| creature(5, k, &Options { triangles: 200..=300, ..Options::default() }).rig).collect()
}

fn ask(asker: &Asker, rigs: &[Rig]) -> Vec<Result<Category, String>> {
    asker.ask(&rigs.iter().collect::<Vec<_>>()).unwrap()
}

#[test]
fn pictures_are_sent_and_answers_kept() {
    let dir = tempfile::tempdir().unwrap();
    let server = server(vec![Reply::Say("Reptile.")]);
    let rigs = rigs(3);
    let first = asker(&server, dir.path());
    assert_eq!(ask(&first, &rigs), vec![Ok(Category::Reptile); 3]);
    let sent = server.requests.lock().unwrap().clone();
    assert_eq!(sent.len(), 3);
    assert!(sent[0].starts_with("POST /v1/chat/completions HTTP/1.1"));
    let body: serde_json::Value = serde_json::from_str(sent[0].split_once("\r\n\r\n").unwrap().1).unwrap();
    assert_eq!(body["model"], "seer");
    let content = body["messages"][0]["content"].as_array().unwrap();
    assert!(content[0]["text"].as_str().unwrap().contains("humanoid, anime_vrm, quadruped"));
    assert_eq!(content.len(), 3);
    assert!(content[1]["image_url"]["url"].as_str().unwrap().starts_with("data:image/png;base64,iVBOR"));
    // A later run asks nothing, and a torn answer is asked for again.
    let again = asker(&server, dir.path());
    assert_eq!(ask(&again, &rigs), vec![Ok(Category::Reptile); 3]);
    assert_eq!((again.report().cached, again.report().requests), (3, 0));
    let one = std::fs::read_dir(dir.path()).unwrap().next().unwrap().unwrap().path();
    std::fs::write(one, b"{").unwrap();
    let third = asker(&server, dir.path());
    ask(&third, &rigs);
    assert_eq!((third.report().cached, third.report().requests), (2, 1));
}

#[test]
fn limits_are_waited_for_and_faults_repeated() {
    let dir = tempfile::tempdir().unwrap();
    let replies = vec![Reply::Status(429, "Retry-After: 0.2\r\n"), Reply::Status(500, ""), Reply::Say("aquatic")];
    let server = server(replies);
    let asker = asker(&server, dir.path());
    let begin = Instant::now();
    assert_eq!(ask(&asker, &rigs(1)), [Ok(Category::Aquatic)]);
    assert!(begin.elapsed() >= Duration::from_millis(200));
    assert_eq!(asker.report(), VlmReport { requests: 3, failed: 1, ..VlmReport::default() });
}

#[test]
fn a_quota_that_is_spent_is_given_up() {
    let dir = tempfile::tempdir().unwrap();
    let server = server((0..100).map(|_| Reply::Status(429, "Retry-After: 0\r\n")).collect());
    let asker = asker(&server, dir.path());
    assert!(ask(&asker, &rigs(20)).iter().all(Result::is_err));
    let report = asker.report();
    assert!(report.gave_up && report.failed >= 1 && report.requests < 80, "{report:?}");
    assert!(asker.first_fault().is_some_and(|why| why.contains("429")));
}

#[test]
fn a_silent_endpoint_times_out_and_the_next_answer_counts() {
    let dir = tempfile::tempdir().unwrap();
    let asker = asker(&server(vec![Reply::Hang, Reply::Say("arthropod")]), dir.path());
    let begin = Instant::now();
    assert_eq!(ask(&asker, &rigs(1)), [Ok(Category::Arthropod)]);
    assert!(begin.elapsed() < Duration::from_secs(3));
}

#[test]
fn nonsense_is_asked_again_and_never_kept() {
    let dir = tempfile::tempdir().unwrap();
    let server =
        server(vec![Reply::Say("a lovely table"), Reply::Say("humanoid or bird_flying"), Reply::Say("humanoid")]);
    let first = asker(&server, dir.path());
    assert_eq!(ask(&first, &rigs(1)), [Ok(Category::Humanoid)]);
    assert_eq!(first.report(), VlmReport { requests: 3, senseless: 2, ..VlmReport::default() });
    let dir = tempfile::tempdir().unwrap();
    let mad = asker(&self::server(vec![Reply::Say("?")]), dir.path());
    assert!(ask(&mad, &rigs(1))[0].as_ref().unwrap_err().contains("names no category"));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 0);
    let foreign = asker(&self::server(vec![Reply::Raw("<html>hello</html>")]), dir.path());
    assert!(ask(&foreign, &rigs(1))[0].as_ref().unwrap_err().contains("not of this protocol"));
}

#[test]
fn an_endpoint_that_is_down_is_given_up() {
    let dir = tempfile::tempdir().unwrap();
    // Bound and closed: nobody listens.
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let down = Server { url: format!("http://127.0.0.1:{port}/v1"), requests: Arc::default() };
    let asker = asker(&down, dir.path());
    let answers = ask(&asker, &rigs(6));
    assert!(answers.iter().all(Result::is_err));
    let report = asker.report();
    assert!(report.gave_up && report.requests <= 8, "{report:?}");
    let refusing = self::asker(&server(vec![Reply::Status(401, "")]), dir.path());
    assert!(ask(&refusing, &rigs(1))[0].as_ref().unwrap_err().contains("status 401"));
    assert_eq!(refusing.report().requests, 1);
}
