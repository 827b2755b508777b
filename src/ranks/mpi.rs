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

impl Drop for World {
    fn drop(&mut self) {
        // Without this, a process that panics would wait in MPI for the others, and they for it.
        if std::thread::panicking() {
            self.abort();
        }
    }
}

/// Divides messages of these lengths into exchanges, because MPI counts bytes in 32 bits. Returns
/// the number of bytes from each process, for every exchange; `most` is the largest sum.
fn exchanges(lengths: &[u64], most: u64) -> Vec<Vec<i32>> {
    let each = most / lengths.len() as u64;
    let count = lengths.iter().max().map_or(0, |longest| longest.div_ceil(each));
    let of = |k: u64| lengths.iter().map(move |all| all.saturating_sub(k * each).min(each) as i32);
    (0..count).map(|k| of(k).collect()).collect()
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
        let mut lengths = vec![0_u64; self.size];
        world.all_gather_into(&(own.len() as u64), &mut lengths[..]);
        let mut all: Vec<Vec<u8>> =
            lengths.iter().map(|length| Vec::with_capacity(*length as usize)).collect();
        let mut rest = own;
        for counts in exchanges(&lengths, i32::MAX as u64) {
            let mut first = 0;
            let starts: Vec<i32> = counts
                .iter()
                .map(|count| {
                    first += count;
                    first - count
                })
                .collect();
            let (piece, others) = rest.split_at(counts[self.rank] as usize);
            rest = others;
            // Rust's address of an empty slice may be the one by which MPI means "in place".
            let piece = if piece.is_empty() { &NOTHING[..0] } else { piece };
            let mut received = vec![0_u8; first as usize];
            let mut parts = PartitionMut::new(&mut received[..], &counts[..], &starts[..]);
            world.all_gather_varcount_into(piece, &mut parts);
            for ((all, start), count) in all.iter_mut().zip(starts).zip(counts) {
                all.extend_from_slice(&received[start as usize..][..count as usize]);
            }
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::exchanges;

    #[test]
    fn long_messages_go_in_several_exchanges() {
        assert!(exchanges(&[0, 0, 0], 9).is_empty());
        assert_eq!(exchanges(&[3, 0, 1], 9), [[3, 0, 1]]);
        assert_eq!(exchanges(&[7, 0, 4], 9), [[3, 0, 3], [3, 0, 1], [1, 0, 0]]);
        let long = exchanges(&[3_000_000_000, 5], i32::MAX as u64);
        assert_eq!(long.len(), 3);
        for counts in &long {
            assert!(
                counts.iter().map(|count| i64::from(*count)).sum::<i64>() <= i64::from(i32::MAX)
            );
        }
        let sum = |rank: usize| long.iter().map(|counts| i64::from(counts[rank])).sum::<i64>();
        assert_eq!((sum(0), sum(1)), (3_000_000_000, 5));
    }
}
