//! Connections from this machine, one thread and one request each.

use std::io::{self, Read};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use crate::guard::Token;
use crate::http::{Answer, BODY, Request};
use crate::routes::answer;
use crate::{Review, ReviewError};

/// Connections at a time; more are sent away.
const MOST: usize = 64;
/// How long a request may take to arrive, and each part of an answer to leave.
const PATIENCE: Duration = Duration::from_secs(10);

/// Serves a review on 127.0.0.1.
pub struct Server {
    listener: TcpListener,
    address: SocketAddr,
    token: Token,
    review: Review,
    stopped: AtomicBool,
    busy: AtomicUsize,
}

/// Ends a server from another thread.
#[derive(Clone)]
pub struct Stop(Arc<Server>);

impl Stop {
    /// Ends it: what is being answered is, nothing more.
    pub fn stop(&self) {
        self.0.stopped.store(true, Ordering::SeqCst);
        // Wakes the listener.
        let _ = TcpStream::connect_timeout(&self.0.address, PATIENCE);
    }
}

impl Server {
    /// Takes a port, 0 any that is free, and the file of decisions for itself.
    ///
    /// # Errors
    /// When the port or the file is taken, or there is no token.
    pub fn bind(review: Review, port: u16) -> Result<Arc<Self>, ReviewError> {
        let fail = |e: io::Error| ReviewError::Port { port, message: e.to_string() };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(fail)?;
        let address = listener.local_addr().map_err(fail)?;
        review.ledger.hold()?;
        let (stopped, busy) = (AtomicBool::new(false), AtomicUsize::new(0));
        Ok(Arc::new(Self { listener, address, token: Token::new()?, review, stopped, busy }))
    }

    /// What to open in a browser. Who knows it may decide.
    pub fn url(&self) -> String {
        format!("http://{}/{}/", self.address, self.token.text())
    }

    /// What is served.
    pub fn review(&self) -> &Review {
        &self.review
    }

    /// For ending it.
    pub fn stop(self: &Arc<Self>) -> Stop {
        Stop(self.clone())
    }

    /// Answers until it is stopped.
    pub fn run(self: &Arc<Self>) {
        while !self.stopped.load(Ordering::SeqCst) {
            let Ok((stream, _)) = self.listener.accept() else {
                // Out of files, for one: it may get better.
                std::thread::sleep(Duration::from_millis(50));
                continue;
            };
            if self.stopped.load(Ordering::SeqCst) {
                break;
            }
            if self.busy.fetch_add(1, Ordering::SeqCst) >= MOST {
                self.busy.fetch_sub(1, Ordering::SeqCst);
                let _ = stream.set_write_timeout(Some(Duration::from_millis(100)));
                let _ = Answer::refusal(503, "too many connections").write(&mut &stream);
                continue;
            }
            let this = self.clone();
            let begun = std::thread::Builder::new().spawn(move || {
                // A fault in one answer is not the end of the others.
                let _ = catch_unwind(AssertUnwindSafe(|| this.serve(&stream)));
                this.busy.fetch_sub(1, Ordering::SeqCst);
            });
            if begun.is_err() {
                self.busy.fetch_sub(1, Ordering::SeqCst);
            }
        }
        // A decision that is on its way to the disk arrives there.
        let begun = Instant::now();
        while self.busy.load(Ordering::SeqCst) > 0 && begun.elapsed() < Duration::from_secs(2) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    fn serve(&self, stream: &TcpStream) {
        let _ = stream.set_nodelay(true);
        let _ = stream.set_write_timeout(Some(PATIENCE));
        let mut arriving = Until { stream, end: Instant::now() + PATIENCE };
        let (answer, whole) = match Request::read(&mut arriving) {
            Ok(request) => (answer(&self.review, &request, &self.token), true),
            Err(Some(refusal)) => (refusal, false),
            Err(None) => return,
        };
        if answer.write(&mut &*stream).is_ok() && !whole {
            // Bytes that nobody read would reset the connection before the refusal arrives.
            let _ = stream.shutdown(Shutdown::Write);
            let mut rest = Until { stream, end: Instant::now() + Duration::from_millis(500) };
            let _ = io::copy(&mut (&mut rest).take(16 * BODY as u64), &mut io::sink());
        }
    }
}

/// Reads until a moment, however slowly bytes drip.
struct Until<'a> {
    stream: &'a TcpStream,
    end: Instant,
}

impl Read for Until<'_> {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let left = self.end.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(io::ErrorKind::TimedOut.into());
        }
        self.stream.set_read_timeout(Some(left))?;
        (&*self.stream).read(into)
    }
}
