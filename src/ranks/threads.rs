//! Ranks that are threads of one process, for tests.

use std::sync::{Arc, Barrier, Mutex};

use super::Ranks;

/// One of several threads that exchange what they give.
pub(crate) struct Thread {
    rank: usize,
    shared: Arc<Shared>,
}

struct Shared {
    given: Mutex<Vec<Vec<u8>>>,
    barrier: Barrier,
}

/// Returns the ends of a connection between threads.
pub(crate) fn threads(size: usize) -> Vec<Arc<dyn Ranks>> {
    let given = Mutex::new(vec![Vec::new(); size]);
    let shared = Arc::new(Shared { given, barrier: Barrier::new(size) });
    let thread = |rank| Arc::new(Thread { rank, shared: Arc::clone(&shared) }) as Arc<dyn Ranks>;
    (0..size).map(thread).collect()
}

impl Ranks for Thread {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.shared.given.lock().expect("no thread panicked").len()
    }

    fn all_gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        self.shared.given.lock().expect("no thread panicked")[self.rank] = own.to_vec();
        self.shared.barrier.wait();
        let all = self.shared.given.lock().expect("no thread panicked").clone();
        self.shared.barrier.wait();
        all
    }
}
