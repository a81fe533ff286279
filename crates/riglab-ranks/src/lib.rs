//! Processes that work together: each has a rank, and all do the same thing at the same time.
//!
//! The one idea: **how many they are changes no number.** Sums over ranks are made pair by pair along a tree that is the
//! same wherever its leaves stand ([`halves`]), so that a sum over two, four or eight ranks has the bits of the sum
//! that one rank makes of the same parts; over three, whose parts are no halves of halves, it may round otherwise.
//!
//! Holds: every rank gets the same bits; a rank that cannot go on ends all of them.
//!
//! Leaves out: tensors, and what is computed. MPI (feature `mpi`) is one way for ranks to speak to each other, threads
//! of one process are another, for tests.

#[cfg(feature = "mpi")]
mod mpi;
mod share;
mod sum;
mod threads;
mod world;

use std::sync::Arc;

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

pub use share::processors;
pub use sum::halves;
pub use threads::on_threads;
pub use world::{launched, library, world};

/// What happened between ranks.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum RanksError {
    /// Another rank ended while it was waited for.
    #[error("another rank ended: {0}")]
    Gone(String),
    /// Something arrived that cannot be understood.
    #[error("rank {0} sent something else than expected; do all ranks run the same program with the same arguments?")]
    Strange(usize),
    /// An item could not be made.
    #[error("{0}")]
    Item(String),
    /// Ranks were asked for where there is no way to speak to them.
    #[error("{0}")]
    Launch(String),
}

/// A way for ranks to speak to each other. Calls come from one thread at a time.
pub(crate) trait Link: Send + Sync {
    fn rank(&self) -> usize;
    fn size(&self) -> usize;
    /// Sends bytes to `to` while as many as fit arrive from `from`; both know the lengths.
    fn exchange(&self, to: usize, send: &[u8], from: usize, receive: &mut [u8]) -> Result<(), RanksError>;
    /// Ends all ranks. Over MPI it does not return.
    fn end(&self, message: &str);
}

/// This process among those that work together. Cheap to clone.
#[derive(Clone)]
pub struct Ranks(Option<Arc<dyn Link>>);

/// One rank, for those who have no others.
pub static ALONE: Ranks = Ranks::alone();

impl Default for Ranks {
    fn default() -> Self {
        Self::alone()
    }
}

impl Ranks {
    /// One rank, which speaks to nobody.
    pub const fn alone() -> Self {
        Self(None)
    }

    pub(crate) fn over(link: impl Link + 'static) -> Self {
        Self((link.size() > 1).then(|| Arc::new(link) as Arc<dyn Link>))
    }

    /// This rank, from 0.
    pub fn rank(&self) -> usize {
        self.0.as_ref().map_or(0, |l| l.rank())
    }

    /// How many there are.
    pub fn size(&self) -> usize {
        self.0.as_ref().map_or(1, |l| l.size())
    }

    /// Whether this is the rank that writes files and shows progress.
    pub fn leads(&self) -> bool {
        self.rank() == 0
    }

    /// Puts the sum over ranks in place of each value, the same bits on every rank. Lengths are the same on all.
    ///
    /// # Errors
    /// [`RanksError::Gone`].
    pub fn sum(&self, values: &mut [f32]) -> Result<(), RanksError> {
        match &self.0 {
            None => Ok(()),
            Some(link) => sum::sum(&**link, values),
        }
    }

    /// What each rank says, by rank, on every rank.
    ///
    /// # Errors
    /// [`RanksError::Gone`], [`RanksError::Strange`].
    pub fn gather<T: Serialize + DeserializeOwned>(&self, own: &T) -> Result<Vec<T>, RanksError> {
        let bytes = postcard::to_allocvec(own).map_err(|e| RanksError::Item(e.to_string()))?;
        let all = match &self.0 {
            None => vec![bytes],
            Some(link) => gather(&**link, bytes)?,
        };
        let read =
            |(rank, bytes): (usize, &Vec<u8>)| postcard::from_bytes(bytes).map_err(|_| RanksError::Strange(rank));
        all.iter().enumerate().map(read).collect()
    }

    /// What the first rank says, on every rank.
    ///
    /// # Errors
    /// As [`Self::gather`].
    pub fn told<T: Serialize + DeserializeOwned>(&self, own: T) -> Result<T, RanksError> {
        if self.size() == 1 {
            return Ok(own);
        }
        let all = self.gather(&if self.leads() { Some(own) } else { None })?;
        all.into_iter().next().flatten().ok_or(RanksError::Strange(0))
    }

    /// Items `0..n`, of which every rank makes its share and gets all. An item must depend on its number alone. `made`
    /// hears how many this rank's share has come to, as a number of all.
    ///
    /// # Errors
    /// The first item's error, by rank; as [`Self::gather`].
    pub fn share<T: Serialize + DeserializeOwned>(
        &self,
        n: usize,
        mut make: impl FnMut(usize) -> Result<T, String>,
        mut made: impl FnMut(usize),
    ) -> Result<Vec<T>, RanksError> {
        let (rank, size) = (self.rank(), self.size());
        let mut own = Vec::new();
        let mut fault = None;
        for k in (rank..n).step_by(size) {
            match make(k) {
                Ok(item) => own.push(item),
                Err(e) => {
                    fault = Some(e);
                    break;
                }
            }
            made((k + size - rank).min(n));
        }
        if size == 1 {
            return fault.map_or(Ok(own), |e| Err(RanksError::Item(e)));
        }
        let mut all = Vec::with_capacity(size);
        for share in self.gather(&fault.map_or(Ok(own), Err))? {
            all.push(share.map_err(RanksError::Item)?.into_iter());
        }
        (0..n).map(|k| all[k % size].next().ok_or(RanksError::Strange(k % size))).collect()
    }

    /// Ends all ranks, as one of them cannot go on. Over MPI it does not return; alone it does nothing.
    pub fn end(&self, message: &str) {
        if let Some(link) = &self.0 {
            link.end(message);
        }
    }
}

/// What each rank has, by rank; lengths first, since they differ.
fn gather(link: &dyn Link, own: Vec<u8>) -> Result<Vec<Vec<u8>>, RanksError> {
    let (rank, size) = (link.rank(), link.size());
    let mut all = vec![Vec::new(); size];
    for d in 1..size {
        let (to, from) = ((rank + d) % size, (rank + size - d) % size);
        let mut length = [0u8; 8];
        link.exchange(to, &(own.len() as u64).to_le_bytes(), from, &mut length)?;
        all[from] = vec![0; u64::from_le_bytes(length) as usize];
        link.exchange(to, &own, from, &mut all[from])?;
    }
    all[rank] = own;
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_rank_hears_all() {
        for size in [1, 2, 3, 5] {
            let heard = on_threads(size, |ranks| {
                let word = "x".repeat(ranks.rank() + 1);
                (ranks.gather(&word).unwrap(), ranks.told(ranks.rank() as u64 + 7).unwrap())
            });
            for (words, told) in heard {
                assert_eq!(words, (1..=size).map(|n| "x".repeat(n)).collect::<Vec<_>>());
                assert_eq!(told, 7);
            }
        }
    }

    #[test]
    fn items_are_shared_and_come_back_in_order() {
        for size in [1, 2, 3] {
            for n in [0, 1, 5, 6] {
                let got = on_threads(size, |ranks| {
                    let mut made = 0;
                    let items = ranks
                        .share(
                            n,
                            |k| {
                                made += 1;
                                Ok(k * k)
                            },
                            |_| {},
                        )
                        .unwrap();
                    (items, made)
                });
                let all: usize = got.iter().map(|(_, made)| made).sum();
                assert_eq!(all, n, "each item is made once");
                got.iter().for_each(|(items, _)| assert_eq!(*items, (0..n).map(|k| k * k).collect::<Vec<_>>()));
            }
        }
    }

    #[test]
    fn a_fault_of_one_is_everybodys() {
        let faults = on_threads(2, |ranks| {
            ranks.share(4, |k| if k == 3 { Err("no three".to_string()) } else { Ok(k) }, |_| {}).unwrap_err()
        });
        assert_eq!(faults, vec![RanksError::Item("no three".into()); 2]);
    }

    #[test]
    fn who_waits_for_a_rank_that_ended_is_told() {
        let heard = on_threads(2, |ranks| match ranks.rank() {
            0 => {
                ranks.end("out of memory");
                Ok(())
            }
            _ => ranks.sum(&mut [1.0]),
        });
        assert_eq!(heard[1], Err(RanksError::Gone("out of memory".into())));
    }
}
