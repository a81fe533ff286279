//! Categories from a vision-language model: rendered views sent to an OpenAI-compatible endpoint.
//!
//! Each question is a set of pictures and a text; its answer is kept in a folder under the BLAKE3 of model,
//! text and pictures, so that a question is paid for once. Whatever the endpoint does, the run goes on: a
//! question that gets no sensible answer leaves the category by rules, marked as such, and after some faults
//! in a row nothing more is asked.

mod answer;
mod client;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

use riglab_core::Rig;
use riglab_render::{View, render_mesh};
use serde::{Deserialize, Serialize};

use crate::config::VlmConfig;
use crate::store::store;
use crate::{Category, CurateError};
pub use answer::category_in;
use client::{Client, Fault};

/// Asks about rigs.
pub struct Asker {
    config: VlmConfig,
    client: Client,
    cache: PathBuf,
    /// Faults since the last answer.
    faults: AtomicUsize,
    /// The first of all.
    first: OnceLock<String>,
    tally: Tally,
}

/// How it went, counted while it goes.
#[derive(Default)]
struct Tally {
    asked: AtomicUsize,
    cached: AtomicUsize,
    senseless: AtomicUsize,
    failed: AtomicUsize,
}

/// How it went.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct VlmReport {
    /// Requests sent.
    pub requests: usize,
    /// Answers that were known already.
    pub cached: usize,
    /// Answers that named no category, or several.
    pub senseless: usize,
    /// Requests that failed.
    pub failed: usize,
    /// Whether asking was given up after faults in a row.
    pub gave_up: bool,
}

/// An answer as it is kept.
#[derive(Serialize, Deserialize)]
struct Kept {
    model: String,
    answer: String,
    category: Category,
}

impl Asker {
    /// With answers kept in a folder, which is made.
    ///
    /// # Errors
    /// When the folder cannot be made.
    pub fn new(config: &VlmConfig, cache: &Path) -> Result<Self, CurateError> {
        std::fs::create_dir_all(cache).map_err(|e| CurateError::write(cache, &e))?;
        let key = std::env::var(&config.key_from).ok().filter(|k| !k.is_empty() && !config.key_from.is_empty());
        let client = Client::new(config, key);
        Ok(Self {
            config: config.clone(),
            client,
            cache: cache.into(),
            faults: AtomicUsize::new(0),
            first: OnceLock::new(),
            tally: Tally::default(),
        })
    }

    /// Asks about rigs, several at once; gives a category or why there is none, in their order.
    ///
    /// # Errors
    /// When answers cannot be kept: the disk is full.
    pub fn ask(&self, rigs: &[&Rig]) -> Result<Vec<Result<Category, String>>, CurateError> {
        let next = AtomicUsize::new(0);
        let mut all: Vec<Option<Result<Result<Category, String>, CurateError>>> = Vec::new();
        all.resize_with(rigs.len(), || None);
        let work = || {
            let mut own = Vec::new();
            loop {
                let i = next.fetch_add(1, Ordering::Relaxed);
                let Some(rig) = rigs.get(i) else { return own };
                own.push((i, self.ask_one(rig)));
            }
        };
        std::thread::scope(|scope| {
            let workers: Vec<_> = (0..self.config.parallel.min(rigs.len())).map(|_| scope.spawn(work)).collect();
            for worker in workers {
                for (i, answer) in worker.join().unwrap_or_default() {
                    all[i] = Some(answer);
                }
            }
        });
        all.into_iter().map(|a| a.unwrap_or_else(|| Ok(Err("the question was lost".into())))).collect()
    }

    /// How it went so far.
    pub fn report(&self) -> VlmReport {
        let n = |count: &AtomicUsize| count.load(Ordering::Relaxed);
        VlmReport {
            requests: n(&self.tally.asked),
            cached: n(&self.tally.cached),
            senseless: n(&self.tally.senseless),
            failed: n(&self.tally.failed),
            gave_up: self.given_up(),
        }
    }

    /// What went wrong first, if a request failed.
    pub fn first_fault(&self) -> Option<&str> {
        self.first.get().map(String::as_str)
    }

    fn failed(&self, why: &str) {
        self.tally.failed.fetch_add(1, Ordering::Relaxed);
        self.faults.fetch_add(1, Ordering::Relaxed);
        self.first.get_or_init(|| why.to_owned());
    }

    fn given_up(&self) -> bool {
        self.faults.load(Ordering::Relaxed) >= self.config.give_up_after
    }

    fn ask_one(&self, rig: &Rig) -> Result<Result<Category, String>, CurateError> {
        let pictures: Vec<Vec<u8>> = self
            .config
            .views
            .iter()
            .map(|yaw| render_mesh(rig.mesh(), &View::square(self.config.pixels).turned(*yaw, 14.0)).to_png())
            .collect();
        let prompt = self.config.prompt.replace("{categories}", &Category::names());
        let kept = self.cache.join(format!("{}.json", self.key(&prompt, &pictures)));
        // A kept answer that cannot be read is asked for again.
        if let Some(known) = std::fs::read(&kept).ok().and_then(|b| serde_json::from_slice::<Kept>(&b).ok()) {
            self.tally.cached.fetch_add(1, Ordering::Relaxed);
            return Ok(Ok(known.category));
        }
        match self.insist(&prompt, &pictures) {
            Ok((category, answer)) => {
                let known = Kept { model: self.config.model.clone(), answer, category };
                store(&kept, &serde_json::to_vec_pretty(&known).unwrap_or_default())?;
                Ok(Ok(category))
            }
            Err(why) => Ok(Err(why)),
        }
    }

    fn key(&self, prompt: &str, pictures: &[Vec<u8>]) -> String {
        let mut hash = blake3::Hasher::new();
        for part in
            [self.config.model.as_bytes(), prompt.as_bytes()].into_iter().chain(pictures.iter().map(Vec::as_slice))
        {
            hash.update(&(part.len() as u64).to_le_bytes());
            hash.update(part);
        }
        hash.finalize().to_hex()[..32].into()
    }

    /// Asks until there is a sensible answer, or no hope.
    fn insist(&self, prompt: &str, pictures: &[Vec<u8>]) -> Result<(Category, String), String> {
        let mut why = String::from("nothing was asked");
        let mut is_busy = false;
        let mut pause = self.config.wait_s;
        for attempt in 0..=self.config.retries {
            if self.given_up() {
                return Err("asking was given up after faults in a row".into());
            }
            let most = self.config.wait_most_s;
            let mut wait = pause.min(most);
            is_busy = false;
            self.tally.asked.fetch_add(1, Ordering::Relaxed);
            // The same question in the same mood gets the same answer: be looser when it made no sense.
            match self.client.ask(prompt, pictures, if attempt == 0 { 0.0 } else { 0.7 }) {
                Ok(answer) => {
                    self.faults.store(0, Ordering::Relaxed);
                    if let Some(category) = category_in(&answer) {
                        return Ok((category, answer));
                    }
                    self.tally.senseless.fetch_add(1, Ordering::Relaxed);
                    why = format!("the answer `{}` names no category", answer.chars().take(40).collect::<String>());
                    // The endpoint is well; there is no need to wait.
                    continue;
                }
                Err(Fault::Busy(after)) => {
                    why = "the endpoint limits how often it is asked (status 429)".into();
                    is_busy = true;
                    wait = after.unwrap_or(pause).min(most);
                }
                Err(Fault::Passing(message)) => {
                    self.failed(&message);
                    why = message;
                }
                Err(Fault::Final(message)) => {
                    self.failed(&message);
                    return Err(message);
                }
            }
            if attempt < self.config.retries && !self.given_up() {
                std::thread::sleep(std::time::Duration::from_secs_f64(wait));
                pause *= 2.0;
            }
        }
        if is_busy {
            // It may be that nothing is left of a quota.
            self.failed(&why);
        }
        Err(why)
    }
}

#[cfg(test)]
#[path = "vlm_tests.rs"]
mod tests;
