//! The processes of one training that runs on several at once, on one machine or on many.
//!
//! Every rank has all weights and sees the same rollouts. Each rank simulates some of the worlds
//! (`divided`), chooses actions for some of them where a step has many decisions, and computes the
//! gradients of some shards. It sends its results to all others. Sums are formed in the order of
//! worlds and shards, so that the result depends on the settings alone: it is the same to the bit
//! as that of one process.

#![cfg(feature = "learn")]

mod divided;
mod message;
#[cfg(feature = "mpi")]
mod mpi;
#[cfg(test)]
pub(crate) mod threads;

use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use bytemuck::Pod;

pub(crate) use divided::Divided;

/// What connects the processes of one training.
pub trait Ranks: Send + Sync {
    /// Returns the number of this process, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of processes.
    fn size(&self) -> usize;

    /// Gives `own` to all ranks, and returns what each of them gave, in the order of ranks. All
    /// ranks must call it equally often.
    fn all_gather(&self, own: &[u8]) -> Vec<Vec<u8>>;

    /// Ends all ranks, because this one cannot go on and the others do not know.
    fn abort(&self) {}
}

/// A training's connection with its other processes, and what stops it.
#[derive(Clone)]
pub struct Team {
    /// The processes.
    pub ranks: Arc<dyn Ranks>,
    /// Set when this process is to stop.
    pub asked: Arc<AtomicBool>,
    /// Set in all processes, in the same step of the worlds or before the same gradient step, once
    /// one of them has been asked to stop.
    pub stop: Arc<AtomicBool>,
}

impl Team {
    /// Returns the team of these processes, of which this one stops when `asked` is set.
    pub fn new(ranks: Arc<dyn Ranks>, asked: Arc<AtomicBool>) -> Self {
        let stop = if ranks.size() > 1 { Arc::default() } else { Arc::clone(&asked) };
        Self { ranks, asked, stop }
    }

    /// Returns the team of a training in one process.
    pub fn alone() -> Self {
        Self::new(Arc::new(Alone), Arc::default())
    }

    /// Returns whether any process has been asked to stop, and sets `stop` then. All processes must
    /// call it equally often; they get the same answer.
    pub(crate) fn must_stop(&self) -> bool {
        let asked = [u8::from(self.asked.load(Ordering::Relaxed))];
        if self.ranks.all_gather(&asked).concat().contains(&1) {
            self.stop.store(true, Ordering::Relaxed);
        }
        self.stop.load(Ordering::Relaxed)
    }
}

/// A training in one process.
#[derive(Debug, Clone, Copy, Default)]
pub struct Alone;

impl Ranks for Alone {
    fn rank(&self) -> usize {
        0
    }

    fn size(&self) -> usize {
        1
    }

    fn all_gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        vec![own.to_vec()]
    }
}

/// Returns which of `count` pieces of work are a rank's: consecutive ones, about as many for each.
pub(crate) fn part(ranks: &dyn Ranks, count: usize) -> Range<usize> {
    part_of(ranks.rank(), ranks.size(), count)
}

pub(crate) fn part_of(rank: usize, size: usize, count: usize) -> Range<usize> {
    rank * count / size..(rank + 1) * count / size
}

/// Gathers numbers from all ranks, one after the other.
pub(crate) fn gather_numbers<T: Pod>(ranks: &dyn Ranks, own: &[T]) -> Vec<T> {
    let all = ranks.all_gather(bytemuck::cast_slice(own));
    // Copied, because the bytes may not be aligned for numbers.
    let numbers = all.iter().map(|bytes| bytemuck::allocation::pod_collect_to_vec(bytes));
    numbers.collect::<Vec<Vec<T>>>().concat()
}

/// The process was started by MPI as one of several, but it cannot work together with the others.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The program was built without MPI.
    #[error(
        "this is one of {size} processes of MPI, and the program was built without MPI: they would all write the same run; build \
         it with `cargo build --release --features mpi`, or start it without mpirun or srun"
    )]
    NotBuilt {
        /// Number of processes.
        size: usize,
    },
    /// The launcher belongs to another MPI than the program.
    #[error(
        "this is one of {launched} processes of MPI's launcher, but the MPI with which the program was built finds {found}: \
         the launcher belongs to another MPI; use the launcher of the MPI with which the program was built"
    )]
    OtherMpi {
        /// Number of processes according to the launcher.
        launched: usize,
        /// Number of processes according to MPI.
        found: usize,
    },
    /// MPI could not be started.
    #[error("MPI could not be started in one of {size} processes")]
    NotStarted {
        /// Number of processes.
        size: usize,
    },
}

/// Returns the connection to the other processes that `mpirun` or `srun` started with this one; of
/// a process that was started alone, [`Alone`].
///
/// # Errors
/// [`Error`].
pub fn of_this_process() -> Result<Arc<dyn Ranks>, Error> {
    match processes() {
        0 | 1 => Ok(Arc::new(Alone)),
        #[cfg(feature = "mpi")]
        size => {
            let world = mpi::World::start().ok_or(Error::NotStarted { size })?;
            if world.size() != size {
                return Err(Error::OtherMpi { launched: size, found: world.size() });
            }
            Ok(Arc::new(world))
        }
        #[cfg(not(feature = "mpi"))]
        size => Err(Error::NotBuilt { size }),
    }
}

/// Returns the environment variables by which MPI's launcher tells a process that it is one of
/// several. A process that starts others for work of their own has to take these from them.
pub fn launcher_variables() -> impl Iterator<Item = std::ffi::OsString> {
    let all = std::env::vars_os().map(|(name, _)| name);
    all.filter(|name| name.to_str().is_some_and(is_of_launcher))
}

fn is_of_launcher(name: &str) -> bool {
    ["OMPI_", "PMI_", "PMIX_"].iter().any(|start| name.starts_with(start))
}

/// Returns the number of processes that MPI's launcher started, by the variables that Open MPI, PMI
/// and Slurm with PMIx set.
fn processes() -> usize {
    let number = |name: &str| std::env::var(name).ok()?.parse().ok();
    let slurm = || {
        std::env::var_os("PMIX_RANK")?;
        number("SLURM_STEP_NUM_TASKS")
    };
    number("OMPI_COMM_WORLD_SIZE").or_else(|| number("PMI_SIZE")).or_else(slurm).unwrap_or(1)
}

/// Returns the number of tasks that Slurm's `srun` started with this one, if it started several
/// without MPI.
pub fn tasks_without_mpi() -> Option<usize> {
    let tasks = std::env::var("SLURM_STEP_NUM_TASKS").ok()?.parse().ok()?;
    (tasks > 1 && processes() == 1).then_some(tasks)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells of a sweep under `mpirun` are runs of their own.
    #[test]
    fn variables_of_launchers_are_known() {
        for name in ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "PMIX_RANK"] {
            assert!(is_of_launcher(name), "{name}");
        }
        assert!(!["PATH", "OMP_NUM_THREADS", "SUMO_HOME"].iter().any(|name| is_of_launcher(name)));
    }
}
