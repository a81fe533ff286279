//! Threads that judge what was drawn while their caller draws more.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Mutex, PoisonError};

use riglab_torch::said;

/// What jobs give, in their order, done by at most so many threads while the next ones are made. A job comes with the
/// name of its mesh, which its error begins with; whatever thread does it, it has as many threads of libtorch as the
/// caller.
///
/// # Errors
/// The first one of making a job; else that of the first job that has one. A panic is an error that says its cause.
pub(super) fn judged<T: Send, F: FnOnce() -> Result<T, String> + Send>(
    threads: usize,
    jobs: impl Iterator<Item = Result<(String, F), String>>,
) -> Result<Vec<T>, String> {
    let (ready, waiting) = channel();
    let (send, receive) = channel();
    let receive = Mutex::new(receive);
    let mut found = std::thread::scope(|scope| {
        let hand = || {
            // The number that is set now, whatever others are given later.
            let _ = tch::get_num_threads();
            let _ = ready.send(());
            work(&receive)
        };
        let hands: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(hand)).collect();
        for _ in &hands {
            let _ = waiting.recv();
        }
        for (place, job) in jobs.enumerate() {
            let (name, job) = job?;
            let _ = send.send((place, name, job));
        }
        drop(send);
        Ok::<_, String>(hands.into_iter().filter_map(|hand| hand.join().ok()).flatten().collect::<Vec<_>>())
    })?;
    found.sort_unstable_by_key(|(place, _)| *place);
    found.into_iter().map(|(_, found)| found).collect()
}

/// Does jobs as they come, until there are no more; gives their places with what came of them.
fn work<T, F: FnOnce() -> Result<T, String>>(
    jobs: &Mutex<Receiver<(usize, String, F)>>,
) -> Vec<(usize, Result<T, String>)> {
    let next = || jobs.lock().unwrap_or_else(PoisonError::into_inner).recv();
    std::iter::from_fn(|| next().ok()).map(|(place, name, job)| (place, told(&name, job))).collect()
}

/// What a job gives; its error names the mesh.
fn told<T>(name: &str, job: impl FnOnce() -> Result<T, String>) -> Result<T, String> {
    match catch_unwind(AssertUnwindSafe(job)) {
        Ok(found) => found.map_err(|e| format!("{name}: {e}")),
        Err(panic) => Err(format!("{name}: judging its rigs panicked, which is a fault of riglab: {}", said(&*panic))),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::sync::Barrier;
    use std::thread::ThreadId;

    use super::*;

    type Job<T> = Box<dyn FnOnce() -> Result<T, String> + Send>;

    fn job<T>(
        name: &str,
        work: impl FnOnce() -> Result<T, String> + Send + 'static,
    ) -> Result<(String, Job<T>), String> {
        Ok((name.to_owned(), Box::new(work)))
    }

    #[test]
    fn order_is_kept_and_threads_are_as_many_as_asked_for() {
        let slow = |k: u64| {
            job("fox", move || {
                std::thread::sleep(std::time::Duration::from_millis(12 - k));
                Ok((k, std::thread::current().id()))
            })
        };
        let found: Vec<(u64, ThreadId)> = judged(3, (0..12).map(slow)).unwrap();
        assert_eq!(found.iter().map(|(k, _)| *k).collect::<Vec<_>>(), (0..12).collect::<Vec<_>>());
        let threads: HashSet<ThreadId> = found.iter().map(|(_, thread)| *thread).collect();
        assert!(threads.len() <= 3 && !threads.contains(&std::thread::current().id()), "{threads:?}");
    }

    #[test]
    fn a_mesh_is_judged_while_the_next_is_drawn() {
        // Neither goes on alone.
        static BOTH: Barrier = Barrier::new(2);
        let jobs = (0..2).map(|k| {
            if k == 1 {
                BOTH.wait();
            }
            job("fox", move || {
                if k == 0 {
                    BOTH.wait();
                }
                Ok(k)
            })
        });
        assert_eq!(judged(1, jobs), Ok(vec![0, 1]));
    }

    #[test]
    fn a_panic_and_an_error_name_their_mesh_and_the_cause() {
        let jobs = || [job("fox", || Ok(1)), job("owl", || panic!("bone {} is gone", 7)), job("cat", || Ok(3))];
        let error = judged(2, jobs().into_iter()).unwrap_err();
        assert!(error.starts_with("owl: judging") && error.ends_with("bone 7 is gone"), "{error}");
        let jobs = [job("fox", || Err::<u8, _>("no rig".to_owned())), job("owl", || panic!("later"))];
        assert_eq!(judged(2, jobs.into_iter()).unwrap_err(), "fox: no rig");
    }

    #[test]
    fn what_cannot_be_drawn_ends_it() {
        let jobs = [job("fox", || Ok(1)), Err("no draws".to_owned()), job("owl", || Ok(2))];
        assert_eq!(judged(2, jobs.into_iter()), Err("no draws".to_owned()));
    }
}
