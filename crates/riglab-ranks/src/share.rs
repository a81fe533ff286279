//! Processors of ranks that share a machine.

use rustix::system::uname;

use crate::{Ranks, RanksError};

/// How many processors are this rank's: those it may use, each shared with the ranks of its machine that may use it too;
/// at least one. So it is right whether the launcher has bound ranks to processors or not.
///
/// # Errors
/// As [`Ranks::gather`].
pub fn processors(ranks: &Ranks) -> Result<usize, RanksError> {
    let usable = usable();
    let machine = uname().nodename().to_string_lossy().into_owned();
    let all = ranks.gather(&(machine, usable))?;
    let (own, used): (_, Vec<&Vec<u32>>) = match all.get(ranks.rank()) {
        Some((machine, own)) => (own, all.iter().filter(|(m, _)| m == machine).map(|(_, used)| used).collect()),
        None => return Ok(1),
    };
    Ok(part(own, &used))
}

/// The numbers of the processors that this process may use.
#[cfg(target_os = "linux")]
fn usable() -> Vec<u32> {
    use rustix::thread::{CpuSet, sched_getaffinity};
    let numbers = |set: CpuSet| (0..CpuSet::MAX_CPU).filter(|&k| set.is_set(k)).map(|k| k as u32).collect();
    sched_getaffinity(None).map_or_else(|_| Vec::new(), numbers)
}

/// Other systems do not tell which: they are taken for the first ones.
#[cfg(not(target_os = "linux"))]
fn usable() -> Vec<u32> {
    (0..std::thread::available_parallelism().map_or(1, |n| n.get() as u32)).collect()
}

fn part(own: &[u32], used: &[&Vec<u32>]) -> usize {
    let shared = |cpu: &u32| 1.0 / used.iter().filter(|u| u.contains(cpu)).count().max(1) as f64;
    // Thirds of three processors are one.
    let sum: f64 = own.iter().map(shared).sum();
    ((sum + 1e-6) as usize).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processors_are_shared_by_who_may_use_them() {
        let (all, low, high) = (vec![0, 1, 2, 3], vec![0, 1], vec![2, 3]);
        assert_eq!(part(&all, &[&all]), 4);
        assert_eq!(part(&all, &[&all, &all]), 2, "not bound: halves");
        assert_eq!(part(&low, &[&low, &high]), 2, "bound: each has its own");
        let three = vec![0, 1, 2];
        assert_eq!(part(&three, &[&three, &three, &three]), 1);
        assert_eq!(part(&low, &[&low, &low, &low]), 1, "more ranks than processors");
        assert_eq!(part(&[], &[]), 1);
    }

    #[test]
    fn one_rank_has_what_it_may_use() {
        let usable = std::thread::available_parallelism().map_or(1, usize::from);
        assert!(processors(&Ranks::alone()).unwrap() >= usable);
    }
}
