//! How a vehicle moves under an action: along its route by the longitudinal law, or freely on four
//! wheels with tyres.

pub mod longitudinal;
pub mod tyres;
