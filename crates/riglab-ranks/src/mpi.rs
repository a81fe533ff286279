//! Ranks as processes of MPI.

use std::io::Write;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use mpi::Threading;
use mpi::environment::Universe;
use mpi::request::{Request, scope};
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator, Destination, Source};

use crate::{Link, RanksError};

/// How long a rank asks again and again whether something has arrived, and how long it sleeps between questions after
/// that: MPI's own waiting takes a whole processor, which a rank that computes could use.
const EAGER: Duration = Duration::from_micros(50);
const NAP: Duration = Duration::from_micros(50);
/// How long other ranks wait before they end all for a reason of their own: what all run into, the first one tells.
const MODESTY: Duration = Duration::from_millis(300);
/// MPI counts in 32 bits.
const MOST: usize = 1 << 30;

pub(crate) struct Mpi {
    rank: usize,
    size: usize,
    world: Mutex<World>,
}

/// The world, and what ends MPI when it goes.
struct World {
    all: SimpleCommunicator,
    _universe: Universe,
}

// SAFETY: MPI was started for calls from any thread, one at a time; the mutex around the world sees to that.
unsafe impl Send for World {}

/// What MPI calls itself.
pub(crate) fn library() -> String {
    let text = mpi::environment::library_version().unwrap_or_default();
    text.lines().next().unwrap_or_default().trim().to_string()
}

impl Mpi {
    pub fn new() -> Result<Self, RanksError> {
        let started = mpi::initialize_with_threading(Threading::Serialized);
        let Some((universe, threading)) = started else {
            return Err(RanksError::Launch("MPI was started twice".into()));
        };
        if threading < Threading::Serialized {
            let message = format!("{} cannot be called from more than one thread; use another MPI", library());
            return Err(RanksError::Launch(message));
        }
        let all = universe.world();
        let (rank, size) = (all.rank() as usize, all.size() as usize);
        Ok(Self { rank, size, world: Mutex::new(World { all, _universe: universe }) })
    }
}

impl Link for Mpi {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn exchange(&self, to: usize, send: &[u8], from: usize, receive: &mut [u8]) -> Result<(), RanksError> {
        let world = self.world.lock().unwrap_or_else(PoisonError::into_inner);
        let (to, from) = (world.all.process_at_rank(to as i32), world.all.process_at_rank(from as i32));
        scope(|s| {
            let mut open: Vec<Request<'_, [u8], _>> = Vec::new();
            for part in receive.chunks_mut(MOST) {
                open.push(from.immediate_receive_into(s, part));
            }
            for part in send.chunks(MOST) {
                open.push(to.immediate_send(s, part));
            }
            let start = Instant::now();
            while let Some(request) = open.pop() {
                if let Err(request) = request.test() {
                    open.push(request);
                    if start.elapsed() > EAGER {
                        std::thread::sleep(NAP);
                    }
                }
            }
        });
        Ok(())
    }

    fn end(&self, message: &str) {
        if self.rank > 0 {
            std::thread::sleep(MODESTY);
        }
        let _ = writeln!(std::io::stderr(), "error: rank {}: {message}", self.rank);
        let world = self.world.lock().unwrap_or_else(PoisonError::into_inner);
        world.all.abort(1);
    }
}
