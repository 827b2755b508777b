//! Runs numbered cases, each a function of its number only, and names the case that fails.
//!
//! `IWOL_FUZZ_CASES` sets the number of cases of each test (`100000`), or their range
//! (`4711..4712`).

use std::{
    fs,
    ops::Range,
    sync::mpsc::{RecvTimeoutError, channel},
    thread,
    time::Duration,
};

/// Limit of the processor's time that a case takes \[s\]. How busy the machine is does not matter.
const LIMIT: f64 = 4.0;
/// Time between two looks at the processor's time.
const LOOK: Duration = Duration::from_millis(500);
/// Frequency of the clock in which Linux counts the processor's time of a thread \[Hz\].
const TICKS: f64 = 100.0;

fn range(default: u64) -> Range<u64> {
    let Ok(text) = std::env::var("IWOL_FUZZ_CASES") else {
        return 0..default;
    };
    let (first, end) = text.split_once("..").unwrap_or(("0", &text));
    let number = |text: &str| text.parse().expect("IWOL_FUZZ_CASES is a number or first..end");
    number(first)..number(end)
}

/// Returns the processor's time that a thread has taken \[s\]. `thread` is its folder in `/proc`.
fn processor_time(thread: &std::path::Path) -> Option<f64> {
    let stat = fs::read_to_string(thread.join("stat")).ok()?;
    // The name, in parentheses, is the second field; the times in user and kernel mode are fields
    // number 14 and 15.
    let fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11).take(2);
    Some(fields.filter_map(|field| field.parse::<f64>().ok()).sum::<f64>() / TICKS)
}

/// Runs `case` for each number in a separate thread. Panics if a case panics or takes too long.
pub fn run(default: u64, mut case: impl FnMut(u64) + Send + 'static) {
    let (started, running) = channel();
    let worker = thread::spawn(move || {
        let own = fs::canonicalize("/proc/thread-self").expect("a thread has a folder");
        for number in range(default) {
            let begin = processor_time(&own).expect("a time");
            started.send((number, own.clone(), begin)).expect("the test waits");
            case(number);
        }
    });
    let mut now = None;
    loop {
        match running.recv_timeout(LOOK) {
            Ok(case) => now = Some(case),
            Err(RecvTimeoutError::Timeout) => {
                let Some((number, thread, begin)) = &now else { continue };
                let time = processor_time(thread).map_or(0.0, |time| time - begin);
                assert!(time < LIMIT, "case {number} takes the processor more than {LIMIT} s");
            }
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    let last = now.map_or(0, |(number, ..)| number);
    assert!(
        worker.join().is_ok(),
        "a case failed; IWOL_FUZZ_CASES={last}..{} repeats it",
        last + 1
    );
}
