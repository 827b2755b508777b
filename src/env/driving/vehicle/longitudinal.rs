//! Longitudinal dynamics: from a throttle action to the motion during one decision interval.
//!
//! Acceleration is constant over an interval, as measured on the vehicle of the paper's simulator:
//! thrust is proportional to the action, a zero action brakes weakly, and negative actions brake
//! along a curve that is five to ten times stronger than thrust. A vehicle without steering never
//! moves backwards. Integration uses that simulator's substeps of 0.02 s: a slow vehicle that
//! brakes must stop within the interval and not roll on to its end, or random actions would make
//! vehicles creep forward.

use crate::scenario::{Control, Vehicle};

/// Substeps of the integration per second \[1/s\].
pub(super) const RATE: f64 = 50.0;

/// Returns the distance driven \[m\] and the final speed \[m/s\] of one decision interval that
/// begins at speed `v` \[m/s\] under `action` (clipped to -1..=1; NaN counts as 0).
pub fn advance(control: &Control, vehicle: &Vehicle, v: f64, action: f64) -> (f64, f64) {
    let substeps = (control.interval * RATE).round().max(1.0);
    let dt = control.interval / substeps;
    let gain = acceleration(control, action) * dt;
    let (mut distance, mut v) = (0.0, v);
    for _ in 0..substeps as u32 {
        v = (v + gain).clamp(0.0, vehicle.max_speed);
        distance += v * dt;
    }
    (distance, v)
}

/// Returns the acceleration \[m/s²\] of a forward-moving vehicle under `action` (clipped to -1..=1;
/// NaN counts as 0).
pub fn acceleration(control: &Control, action: f64) -> f64 {
    match drive(control, action) {
        Drive::Thrust(acceleration) => acceleration,
        Drive::Brake(deceleration) => -deceleration,
    }
}

/// Effect of a throttle action on a vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Drive {
    /// Acceleration \[m/s²\]; negative values accelerate backwards.
    Thrust(f64),
    /// Deceleration in either direction of motion, until the vehicle stands still \[m/s²\].
    Brake(f64),
}

/// Returns thrust for a positive action, and for a negative one if the vehicle can reverse. Any
/// other action brakes, with at least [`Control::drag`].
pub(super) fn drive(control: &Control, action: f64) -> Drive {
    let action = if action.is_nan() { 0.0 } else { action.clamp(-1.0, 1.0) };
    if action > 0.0 || (action < 0.0 && control.steering.is_some_and(|s| s.reverse)) {
        return Drive::Thrust(control.accel * action);
    }
    let magnitude = -action;
    let mut from = (0.0, 0.0);
    let mut braking = 0.0;
    for &to in &control.brake {
        if magnitude <= to.0 {
            braking = from.1 + (to.1 - from.1) * (magnitude - from.0) / (to.0 - from.0);
            break;
        }
        from = to;
        braking = to.1;
    }
    Drive::Brake(braking.max(control.drag))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn law() -> (Control, Vehicle) {
        (
            Control {
                interval: 0.1,
                accel: 2.909,
                drag: 0.364,
                brake: vec![(0.3, 8.2), (0.5, 10.2), (1.0, 14.7)],
                steering: None,
                initial_throttle: Control::INITIAL_THROTTLE,
                lane_change: crate::scenario::LaneChange::None,
            },
            Vehicle { length: 4.515, width: 1.852, max_speed: 22.222 },
        )
    }

    #[test]
    fn follows_the_measured_rows() {
        let (control, vehicle) = law();
        for (action, expected) in [
            (1.0, 2.909),
            (0.5, 1.4545),
            (0.0, -0.364),
            (-0.01, -0.364),
            (-0.3, -8.2),
            (-0.4, -9.2),
            (-0.5, -10.2),
            (-1.0, -14.7),
            (-3.0, -14.7),
            (9.0, 2.909),
        ] {
            assert!((acceleration(&control, action) - expected).abs() < 1e-9, "{action}");
        }
        let speed = |v, action| advance(&control, &vehicle, v, action).1;
        assert!((speed(10.0, -1.0) - 8.53).abs() < 1e-9);
        assert_eq!(speed(0.5, -1.0), 0.0);
        assert_eq!(speed(0.0, 0.0), 0.0);
        assert_eq!(speed(22.2, 1.0), 22.222);
        assert_eq!(
            advance(&control, &vehicle, 5.0, f64::NAN),
            advance(&control, &vehicle, 5.0, 0.0)
        );
        // From 10 m/s under full throttle: five substeps of 0.02 s, each at its new speed.
        let distance: f64 = (1..=5).map(|k| 0.02 * (10.0 + 2.909 * 0.02 * f64::from(k))).sum();
        assert!((advance(&control, &vehicle, 10.0, 1.0).0 - distance).abs() < 1e-12);
        // A slow vehicle that brakes hard stops within the first substep.
        assert_eq!(advance(&control, &vehicle, 0.2, -1.0).0, 0.0);
    }
}
