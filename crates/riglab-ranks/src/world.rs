//! The ranks that this program was started as.

use crate::{Ranks, RanksError};

/// Variables by which launchers tell how many ranks they started: MPI's own, then the steps of Slurm. (A batch script
/// of Slurm is no step: it is one process, whatever its allocation.)
const LAUNCHERS: [&str; 5] =
    ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_SIZE", "MV2_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS"];

/// How many ranks this program was started as, by `mpirun` or as the steps of `srun`; 1 where it was started alone.
pub fn launched() -> usize {
    size(|name| std::env::var(name).ok())
}

fn size(variable: impl Fn(&str) -> Option<String>) -> usize {
    LAUNCHERS.into_iter().find_map(|name| variable(name)?.trim().parse().ok()).unwrap_or(1)
}

/// This process among those that were started together; alone where it was started alone. Call it once.
///
/// # Errors
/// [`RanksError::Launch`] where there are several and this program was built without MPI, or MPI finds only itself.
pub fn world() -> Result<Ranks, RanksError> {
    match launched() {
        0 | 1 => Ok(Ranks::alone()),
        n => several(n),
    }
}

/// The MPI that this program was built with, by its own words; `None` without one.
pub fn library() -> Option<String> {
    #[cfg(feature = "mpi")]
    return Some(crate::mpi::library());
    #[cfg(not(feature = "mpi"))]
    None
}

#[cfg(feature = "mpi")]
fn several(n: usize) -> Result<Ranks, RanksError> {
    let link = crate::mpi::Mpi::new()?;
    let found = crate::Link::size(&link);
    if found != n {
        return Err(RanksError::Launch(format!(
            "{n} processes were started, but MPI found {found}: the launcher belongs to another MPI than the one riglab \
             was built with ({}); use that one's mpirun, or choose the right `srun --mpi=...`",
            crate::mpi::library()
        )));
    }
    Ok(Ranks::over(link))
}

#[cfg(not(feature = "mpi"))]
fn several(n: usize) -> Result<Ranks, RanksError> {
    Err(RanksError::Launch(format!(
        "{n} processes were started, but this riglab was built without MPI; build it with \
         `cargo build --release --features mpi` (needs mpicc and libclang; `cargo xtask mpi` brings both where they are \
         missing)"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn launchers_tell_their_number() {
        let with =
            |pairs: &[(&str, &str)]| size(|name| pairs.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_string()));
        assert_eq!(with(&[]), 1);
        assert_eq!(with(&[("OMPI_COMM_WORLD_SIZE", "4")]), 4);
        assert_eq!(with(&[("PMI_SIZE", "2")]), 2);
        assert_eq!(with(&[("SLURM_NTASKS", "8")]), 1, "a batch script is one process");
        assert_eq!(with(&[("SLURM_STEP_NUM_TASKS", "8")]), 8);
        // mpirun starts one helper a node as a step of Slurm, which starts the ranks.
        assert_eq!(with(&[("SLURM_STEP_NUM_TASKS", "1"), ("OMPI_COMM_WORLD_SIZE", "2")]), 2);
    }
}
