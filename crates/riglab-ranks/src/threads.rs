//! Ranks as threads of one process: everything that ranks do can be tested without an MPI.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use crate::{Link, Ranks, RanksError};

/// Runs `work` on so many threads, each with its rank; gives what they return, by rank.
///
/// # Panics
/// When one of them does.
pub fn on_threads<T: Send>(size: usize, work: impl Fn(Ranks) -> T + Sync) -> Vec<T> {
    let post = Arc::new(Post::new(size));
    std::thread::scope(|scope| {
        let begin = |rank| {
            let (post, work) = (post.clone(), &work);
            scope.spawn(move || work(Ranks::over(Thread { rank, size, post })))
        };
        let threads: Vec<_> = (0..size).map(begin).collect();
        threads.into_iter().map(|t| t.join().expect("a rank panicked")).collect()
    })
}

/// Where ranks meet.
struct Post {
    held: Mutex<Held>,
    news: Condvar,
}

struct Held {
    /// What was sent and not yet received, by receiver and sender.
    boxes: Vec<VecDeque<Vec<u8>>>,
    /// Why all end.
    ended: Option<String>,
}

impl Post {
    fn new(size: usize) -> Self {
        let held = Held { boxes: vec![VecDeque::new(); size * size], ended: None };
        Self { held: Mutex::new(held), news: Condvar::new() }
    }

    fn hold(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

struct Thread {
    rank: usize,
    size: usize,
    post: Arc<Post>,
}

impl Link for Thread {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn exchange(&self, to: usize, send: &[u8], from: usize, receive: &mut [u8]) -> Result<(), RanksError> {
        let mut held = self.post.hold();
        held.boxes[to * self.size + self.rank].push_back(send.to_vec());
        self.post.news.notify_all();
        loop {
            if let Some(bytes) = held.boxes[self.rank * self.size + from].pop_front() {
                if bytes.len() != receive.len() {
                    return Err(RanksError::Strange(from));
                }
                receive.copy_from_slice(&bytes);
                return Ok(());
            }
            if let Some(why) = &held.ended {
                return Err(RanksError::Gone(why.clone()));
            }
            held = self.post.news.wait(held).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn end(&self, message: &str) {
        self.post.hold().ended = Some(message.into());
        self.post.news.notify_all();
    }
}
