//! One request and its answer over a connection. The parser is httparse; what is here are limits.
//!
//! What the page does not need is refused: bodies without a length, chunks, a second request on a
//! connection.

use std::io::{self, Read, Write};
use std::sync::Arc;

/// Bytes of a request's line and headers.
const HEAD: usize = 16 << 10;
/// Bytes of a request's body. A decision has its asset's comment twice, as it is and as it was, and one that was written by
/// hand may be of any length.
pub const BODY: usize = 1 << 20;
/// Headers of a request.
const HEADERS: usize = 64;

/// A request.
#[derive(Debug)]
pub struct Request {
    /// `GET`, `POST`, ...
    pub method: String,
    /// What is asked for, as written.
    pub target: String,
    headers: Vec<(String, String)>,
    /// What was sent along.
    pub body: Vec<u8>,
}

impl Request {
    /// A header, by its name in lower case.
    ///
    /// # Errors
    /// When it is there twice.
    pub fn header(&self, name: &str) -> Result<Option<&str>, Answer> {
        let mut all = self.headers.iter().filter(|(n, _)| n == name).map(|(_, value)| value.as_str());
        let first = all.next();
        if all.next().is_some() { Err(Answer::refusal(400, "a header is there twice")) } else { Ok(first) }
    }

    /// Reads one.
    ///
    /// # Errors
    /// The answer to what is no request, or `None` when there is nobody to answer.
    pub fn read(from: &mut impl Read) -> Result<Self, Option<Answer>> {
        let refuse = |status, text| Some(Answer::refusal(status, text));
        let mut bytes = Vec::with_capacity(1024);
        let (mut request, head) = loop {
            let before = bytes.len();
            if before >= HEAD {
                return Err(refuse(431, "the request's head is too large"));
            }
            bytes.resize(before + 1024, 0);
            let n = more(from, &mut bytes[before..])?;
            bytes.truncate(before + n);
            if n == 0 {
                return Err(if before == 0 { None } else { refuse(400, "the request was cut off") });
            }
            if let Some(parsed) = Self::head(&bytes)? {
                break parsed;
            }
        };
        if request.header("transfer-encoding")?.is_some() {
            return Err(refuse(411, "a body needs a length"));
        }
        let length = match request.header("content-length")? {
            None => 0,
            Some(digits) if !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit()) => {
                digits.parse().unwrap_or(usize::MAX)
            }
            Some(_) => return Err(refuse(400, "the body's length is no number")),
        };
        if length > BODY {
            return Err(refuse(413, "the body is too large"));
        }
        let mut body = bytes.split_off(head);
        body.truncate(length);
        while body.len() < length {
            let before = body.len();
            body.resize(length, 0);
            let n = more(from, &mut body[before..])?;
            body.truncate(before + n);
            if n == 0 {
                return Err(refuse(400, "the request was cut off"));
            }
        }
        request.body = body;
        Ok(request)
    }

    /// Parses the head, if it is complete, and says where it ends.
    fn head(bytes: &[u8]) -> Result<Option<(Self, usize)>, Answer> {
        let malformed = |_| Answer::refusal(400, "this is no HTTP request");
        let mut headers = [httparse::EMPTY_HEADER; HEADERS];
        let mut parsed = httparse::Request::new(&mut headers);
        let end = match parsed.parse(bytes).map_err(malformed)? {
            httparse::Status::Complete(end) => end,
            httparse::Status::Partial => return Ok(None),
        };
        let text = |value: &[u8]| String::from_utf8_lossy(value).into_owned();
        let request = Self {
            method: parsed.method.unwrap_or_default().to_owned(),
            target: parsed.path.unwrap_or_default().to_owned(),
            headers: parsed.headers.iter().map(|h| (h.name.to_ascii_lowercase(), text(h.value))).collect(),
            body: Vec::new(),
        };
        Ok(Some((request, end)))
    }
}

/// Reads some bytes; an error of the connection is answered where that makes sense.
fn more(from: &mut impl Read, into: &mut [u8]) -> Result<usize, Option<Answer>> {
    loop {
        return match from.read(into) {
            Ok(n) => Ok(n),
            Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
            Err(e) if matches!(e.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                Err(Some(Answer::refusal(408, "the request took too long")))
            }
            Err(_) => Err(None),
        };
    }
}

/// An answer.
#[derive(Debug)]
pub struct Answer {
    /// 200 and so on.
    pub status: u16,
    kind: &'static str,
    body: Arc<Vec<u8>>,
    /// Whether a browser may keep it.
    kept: bool,
}

/// Of every answer: nothing from elsewhere is loaded, nothing is shown elsewhere, no address is told.
const ALWAYS: &str = "\
Content-Security-Policy: default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; \
connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n\
Cross-Origin-Opener-Policy: same-origin\r\n\
Cross-Origin-Resource-Policy: same-origin\r\n\
Referrer-Policy: no-referrer\r\n\
X-Content-Type-Options: nosniff\r\n\
X-Frame-Options: DENY\r\n\
Connection: close\r\n";

impl Answer {
    /// What was asked for.
    pub fn found(kind: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { status: 200, kind, body: Arc::new(body.into()), kept: false }
    }

    /// A picture, which stays the same as long as the token of its address.
    pub fn png(body: Arc<Vec<u8>>) -> Self {
        Self { status: 200, kind: "image/png", body, kept: true }
    }

    /// What stands in the way of what was sent.
    pub fn conflict(kind: &'static str, body: impl Into<Vec<u8>>) -> Self {
        Self { status: 409, ..Self::found(kind, body) }
    }

    /// A sentence on why not.
    pub fn refusal(status: u16, text: &str) -> Self {
        let body = Arc::new(format!("{text}\n").into_bytes());
        Self { status, kind: "text/plain; charset=utf-8", body, kept: false }
    }

    /// Writes it.
    ///
    /// # Errors
    /// When nobody listens any more.
    pub fn write(&self, to: &mut impl Write) -> io::Result<()> {
        let reason = match self.status {
            200 => "OK",
            400 => "Bad Request",
            403 => "Forbidden",
            404 => "Not Found",
            405 => "Method Not Allowed",
            408 => "Request Timeout",
            409 => "Conflict",
            411 => "Length Required",
            413 => "Content Too Large",
            415 => "Unsupported Media Type",
            431 => "Request Header Fields Too Large",
            503 => "Service Unavailable",
            _ => "Internal Server Error",
        };
        let cache = if self.kept { "private, max-age=86400, immutable" } else { "no-store" };
        let (status, kind, length) = (self.status, self.kind, self.body.len());
        let head = format!(
            "HTTP/1.1 {status} {reason}\r\nContent-Type: {kind}\r\nContent-Length: {length}\r\nCache-Control: {cache}\r\n{ALWAYS}\r\n"
        );
        to.write_all(head.as_bytes())?;
        to.write_all(&self.body)?;
        to.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POST: &[u8] = b"POST /a HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\n\r\nhello, not read";

    fn status(bytes: &[u8]) -> Option<u16> {
        Request::read(&mut &*bytes).err().map(|answer| answer.map_or(0, |a| a.status))
    }

    #[test]
    fn a_request_is_read_however_its_bytes_arrive() {
        let whole = POST.len() - ", not read".len();
        for cut in 1..whole {
            let request = Request::read(&mut POST[..cut].chain(&POST[cut..])).unwrap();
            assert_eq!((request.method.as_str(), request.target.as_str()), ("POST", "/a"));
            assert_eq!((request.header("host").unwrap(), request.body.as_slice()), (Some("x"), &b"hello"[..]));
            assert_eq!(status(&POST[..cut]), Some(400), "{cut}");
        }
        assert_eq!(status(b""), Some(0));
    }

    #[test]
    fn what_is_no_request_is_refused() {
        let post = |headers: &str| status(format!("POST / HTTP/1.1\r\n{headers}\r\n").as_bytes());
        assert_eq!(post("Transfer-Encoding: chunked\r\n"), Some(411));
        assert_eq!(post("Content-Length: -1\r\n"), Some(400));
        assert_eq!(post("Content-Length: +1\r\n"), Some(400));
        assert_eq!(post("Content-Length: 1\r\nContent-Length: 1\r\n"), Some(400));
        assert_eq!(post(&format!("Content-Length: {BODY}\r\n")), Some(400), "it was cut off");
        assert_eq!(post(&format!("Content-Length: {}\r\n", BODY + 1)), Some(413));
        assert_eq!(post("Content-Length: 99999999999999999999999\r\n"), Some(413));
        assert_eq!(post("a b: c\r\n"), Some(400));
        assert_eq!(post(&"a: b\r\n".repeat(HEADERS + 1)), Some(400));
        assert_eq!(post(&format!("a: {}\r\n", "b".repeat(2 * HEAD))), Some(431));
        for bytes in [&b"\x16\x03\x01\x02\x00"[..], b"GET\r\n\r\n", b"GET / HTTP/9.9\r\n\r\n", b"\0\0\0\0\r\n\r\n"] {
            assert_eq!(status(bytes), Some(400), "{bytes:?}");
        }
    }
}
