//! Motion of a vehicle that steers: a bicycle model, fitted to the vehicle of the paper's simulator.
//!
//! The wheel follows the command after a dead time and with a first-order lag. Yaw rate is speed over the radius that belongs to the
//! wheel's angle, √((wheelbase / tan δ)² + offset²), up to the lateral acceleration that tyres hold; the vehicle moves at a slip angle to its
//! heading. Integrated in the 0.02 s substeps of that simulator, as the longitudinal law is ([`super::dynamics`]).

use super::dynamics::{self, RATE};
use super::geometry::Pose;
use crate::scenario::{Control, Steering, Vehicle};

/// Where a steered vehicle is, and how it moves.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Of its centre.
    pub pose: Pose,
    /// \[m/s\], negative backwards.
    pub speed: f64,
    /// Yaw rate over the last interval, counter-clockwise \[rad/s\].
    pub yaw_rate: f64,
    /// Angle of the front wheels, to the left \[rad\].
    wheel: f64,
    /// Steering command of the last decision, -1 to 1, which holds on until the dead time of the next is over.
    command: f64,
}

impl Motion {
    /// At rest, wheels straight.
    pub const fn at(pose: Pose) -> Self {
        Self { pose, speed: 0.0, yaw_rate: 0.0, wheel: 0.0, command: 0.0 }
    }

    /// Angle of the front wheels, to the left \[rad\].
    pub fn wheel(&self) -> f64 {
        self.wheel
    }

    /// The motion after one decision interval under the actions `steer` (to the left) and `throttle` (clipped to -1..=1; NaN
    /// counts as 0).
    #[must_use]
    pub fn advance(self, control: &Control, steering: &Steering, vehicle: &Vehicle, steer: f64, throttle: f64) -> Self {
        let steer = if steer.is_nan() { 0.0 } else { steer.clamp(-1.0, 1.0) };
        let substeps = (control.interval * RATE).round().max(1.0);
        let dt = control.interval / substeps;
        let gain = dynamics::acceleration(control, throttle) * dt;
        let backwards = if steering.reverse { -vehicle.max_speed } else { 0.0 };
        let follow = 1.0 - (-dt / steering.lag).exp();
        let Pose { mut x, mut y, mut heading } = self.pose;
        let (mut speed, mut wheel) = (self.speed, self.wheel);
        for k in 0..substeps as u32 {
            let late = (f64::from(k) + 0.5) * dt < steering.dead_time;
            let command = if late { self.command } else { steer };
            let next = wheel + (command * steering.max_angle.to_radians() - wheel) * follow;
            let mean = f64::midpoint(wheel, next);
            wheel = next;
            speed = (speed + gain).clamp(backwards, vehicle.max_speed);
            let free = curvature(steering, mean);
            let most = steering.max_lateral / (speed * speed).max(f64::MIN_POSITIVE);
            let curvature = free.clamp(-most, most);
            let turn = curvature * speed * dt;
            // Tyres that slide turn the vehicle less than its wheels say, and its way as well.
            let slip = if free == 0.0 { 0.0 } else { steering.slip * mean * curvature / free };
            let (sin, cos) = (heading + turn / 2.0 + slip).sin_cos();
            x += speed * dt * cos;
            y += speed * dt * sin;
            heading += turn;
        }
        Self {
            pose: Pose { x, y, heading },
            speed,
            yaw_rate: (heading - self.pose.heading) / control.interval,
            wheel,
            command: steer,
        }
    }
}

/// Curvature of the way at low speed \[1/m\], to the left, with the front wheels at `wheel` \[rad\].
pub fn curvature(steering: &Steering, wheel: f64) -> f64 {
    if wheel == 0.0 { 0.0 } else { (steering.wheelbase / wheel.tan()).hypot(steering.offset).recip() * wheel.signum() }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn law(reverse: bool) -> (Control, Steering, Vehicle) {
        let steering = Steering {
            max_angle: 40.0,
            wheelbase: 2.469,
            offset: 2.05,
            slip: 0.4,
            dead_time: 0.065,
            lag: 0.175,
            max_lateral: 7.2,
            reverse,
        };
        let control = Control {
            interval: 0.1,
            accel: 2.909,
            drag: 0.364,
            brake: vec![(0.3, 8.2), (0.5, 10.2), (1.0, 14.7)],
            steering: Some(steering),
        };
        (control, steering, Vehicle { length: 4.515, width: 1.852, max_speed: 22.222 })
    }

    /// Motions at a constant speed, after each interval.
    fn steady(speed: f64, steer: f64, intervals: usize) -> Vec<Motion> {
        let (control, steering, vehicle) = law(false);
        let control = Control { drag: 0.0, ..control };
        let first = Motion { speed, ..Motion::at(Pose::default()) };
        let next = |m: &Motion| Some(m.advance(&control, &steering, &vehicle, steer, 0.0));
        std::iter::successors(Some(first), next).skip(1).take(intervals).collect()
    }

    #[test]
    fn low_speed_radii_are_the_measured_ones() {
        for (steer, radius) in [(0.05, 71.0), (0.1, 35.5), (0.25, 14.2), (0.5, 7.1), (0.75, 4.7), (1.0, 3.6)] {
            let last = steady(1.0, steer, 40).pop().unwrap();
            let found = last.speed / last.yaw_rate;
            assert!((found / radius - 1.0).abs() < 0.02, "steering {steer}: radius {found}, measured {radius}");
            let mirrored = steady(1.0, -steer, 40).pop().unwrap();
            assert!((mirrored.yaw_rate + last.yaw_rate).abs() < 1e-12 && (mirrored.pose.y + last.pose.y).abs() < 1e-9);
        }
    }

    #[test]
    fn yaw_follows_a_step_of_steering_as_measured() {
        let measured = [0.063, 0.305, 0.534, 0.704, 0.777, 0.807, 0.823];
        for (motion, rate) in steady(6.0, 0.5, 7).iter().zip(measured) {
            assert!((motion.yaw_rate - rate).abs() < 0.03, "{} against {rate}", motion.yaw_rate);
        }
    }

    #[test]
    fn tyres_hold_so_much() {
        for speed in [8.0, 12.0, 20.0] {
            let last = steady(speed, 1.0, 40).pop().unwrap();
            assert!((last.yaw_rate * speed - 7.2).abs() < 1e-6, "{}", last.yaw_rate * speed);
        }
    }

    #[test]
    fn drives_backwards_only_where_it_may() {
        let advance = |reverse: bool, throttle: f64| {
            let (control, steering, vehicle) = law(reverse);
            Motion::at(Pose::default()).advance(&control, &steering, &vehicle, 0.0, throttle)
        };
        assert_eq!(advance(false, -1.0).speed, 0.0);
        assert_eq!(advance(false, -1.0).pose, Pose::default());
        let back = advance(true, -1.0);
        assert!((back.speed + 0.2909).abs() < 1e-12 && back.pose.x < 0.0, "{back:?}");
    }

    proptest! {
        /// Going straight, a steered vehicle moves as one on rails.
        #[test]
        fn straight_on_it_is_the_longitudinal_law(speed in 0.0..22.0f64, throttle in -1.2..1.2f64, heading in -3.0..3.0f64) {
            let (control, steering, vehicle) = law(false);
            let first = Motion { speed, ..Motion::at(Pose { x: 1.0, y: 2.0, heading }) };
            let next = first.advance(&control, &steering, &vehicle, 0.0, throttle);
            let (way, expected) = dynamics::advance(&control, &vehicle, speed, throttle);
            prop_assert!((next.speed - expected).abs() < 1e-12);
            prop_assert!((next.pose.distance(&first.pose) - way).abs() < 1e-9 && next.pose.heading == heading);
        }

        /// Any actions: finite, no faster than allowed, no sharper than the wheels and tyres allow.
        #[test]
        fn stays_within_its_limits(actions in prop::collection::vec((-2.0..2.0f64, -2.0..2.0f64), 1..80), reverse in any::<bool>()) {
            let (control, steering, vehicle) = law(reverse);
            let mut motion = Motion::at(Pose::default());
            for (steer, throttle) in actions {
                let next = motion.advance(&control, &steering, &vehicle, steer, throttle);
                prop_assert!(next.speed.abs() <= vehicle.max_speed && (reverse || next.speed >= 0.0));
                let fastest = next.speed.abs().max(motion.speed.abs());
                prop_assert!(next.pose.distance(&motion.pose) <= fastest * control.interval + 1e-9);
                prop_assert!(next.yaw_rate.abs() <= fastest / 3.5 && next.yaw_rate.is_finite());
                motion = next;
            }
        }
    }
}
