//! Drivers without training.

mod fcfs;
mod pursuit;

pub use pursuit::Pursuit;
#[cfg(test)]
pub(super) use pursuit::steer;
