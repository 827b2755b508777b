//! Runs numbered cases, each a function of its number only, and names the case that fails.
//!
//! `IWOL_FUZZ_CASES` sets the number of cases of each test (`100000`), or their range
//! (`4711..4712`).

use std::{
    ops::Range,
    sync::mpsc::{RecvTimeoutError, channel},
    thread,
    time::Duration,
};

/// Time limit of a case.
const LIMIT: Duration = Duration::from_secs(2);

fn range(default: u64) -> Range<u64> {
    let Ok(text) = std::env::var("IWOL_FUZZ_CASES") else {
        return 0..default;
    };
    let (first, end) = text.split_once("..").unwrap_or(("0", &text));
    let number = |text: &str| text.parse().expect("IWOL_FUZZ_CASES is a number or first..end");
    number(first)..number(end)
}

/// Runs `case` for each number in a separate thread. Panics if a case panics or takes too long.
pub fn run(default: u64, mut case: impl FnMut(u64) + Send + 'static) {
    let (started, running) = channel();
    let worker = thread::spawn(move || {
        for number in range(default) {
            started.send(number).expect("the test waits");
            case(number);
        }
    });
    let mut last = 0;
    loop {
        match running.recv_timeout(LIMIT) {
            Ok(number) => last = number,
            Err(RecvTimeoutError::Timeout) => panic!("case {last} takes more than {LIMIT:?}"),
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    assert!(
        worker.join().is_ok(),
        "a case failed; IWOL_FUZZ_CASES={last}..{} repeats it",
        last + 1
    );
}
