//! The connection by MPI.

use mpi::Threading;
use mpi::datatype::PartitionMut;
use mpi::environment::Universe;
use mpi::topology::SimpleCommunicator;
use mpi::traits::{Communicator as _, CommunicatorCollectives as _};

use super::Ranks;

static NOTHING: [u8; 1] = [0];

/// All processes that MPI's launcher started.
pub(super) struct World {
    rank: usize,
    size: usize,
    // MPI ends when it is dropped.
    _universe: Universe,
}

impl World {
    /// Starts MPI; `None` if it was started before.
    pub(super) fn start() -> Option<Self> {
        let (universe, _) = mpi::initialize_with_threading(Threading::Serialized)?;
        let world = universe.world();
        let (rank, size) = (world.rank() as usize, world.size() as usize);
        Some(Self { rank, size, _universe: universe })
    }
}

impl Ranks for World {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.size
    }

    fn abort(&self) {
        SimpleCommunicator::world().abort(1);
    }

    fn all_gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        let world = SimpleCommunicator::world();
        let mut counts = vec![0_i32; self.size];
        world.all_gather_into(&(own.len() as i32), &mut counts[..]);
        let mut first = 0;
        let starts: Vec<i32> = counts
            .iter()
            .map(|count| {
                first += count;
                first - count
            })
            .collect();
        // Rust's address of an empty slice may be the one by which MPI means "in place".
        let own = if own.is_empty() { &NOTHING[..0] } else { own };
        let mut all = vec![0_u8; first.max(1) as usize];
        let received = &mut all[..first as usize];
        let mut parts = PartitionMut::new(received, &counts[..], &starts[..]);
        world.all_gather_varcount_into(own, &mut parts);
        let of = |(start, count): (&i32, &i32)| all[*start as usize..][..*count as usize].to_vec();
        starts.iter().zip(&counts).map(of).collect()
    }
}
