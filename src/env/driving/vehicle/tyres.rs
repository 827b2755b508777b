//! Motion of a vehicle that steers: a rigid body in the plane on four wheels whose tyres slide.
//!
//! This is the ray-cast vehicle of the Bullet physics engine, on which the paper's simulator runs,
//! restricted to the plane. In each substep of 0.02 s, every wheel reduces its own sideways speed
//! by a share and applies a quarter of the thrust or brake; the tyre's grip limits the two
//! together. No constant is fitted to recorded drives: the vehicle's constants are scenario data
//! ([`Steering`]), and the others are from Bullet's source or were read from the running engine.
//! Roll, pitch and load transfer are left out, except that roll and pitch soften the sideways
//! impulse of a wheel.
//!
//! Source: bulletphysics/bullet3, `src/BulletDynamics/Vehicle/btRaycastVehicle.cpp`, and
//! metadriverse/metadrive, `component/vehicle/vehicle_type.py`.

use nalgebra::{Matrix2, Rotation2, Vector2};

use super::longitudinal::{self, Drive, RATE};
use crate::env::driving::geometry::Pose;
use crate::scenario::{Control, Steering, Vehicle};

/// Share of its sideways speed that a wheel tries to remove per second: Bullet's `contactDamping`
/// of 0.2 in each 0.02 s \[1/s\].
const DAMPING: f64 = 0.2 * RATE;
/// Weight of thrust and brake in the comparison with a tyre's grip: Bullet's `fwdFactor`.
const ALONG: f64 = 0.5;
/// Mass times the squared height of the centre of mass (0.537 m), divided by the roll inertia
/// (`ROLL`) and by the pitch inertia (`PITCH`) of the paper's vehicle: how much a sideways impulse
/// at the ground rolls or pitches the body instead of moving it.
const ROLL: f64 = 0.714;
const PITCH: f64 = 0.159;
/// Gravity \[m/s²\].
const GRAVITY: f64 = 9.81;

/// Pose and velocity of a vehicle that steers.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Motion {
    /// Pose of the centre of mass, which is the middle of the body.
    pub pose: Pose,
    /// Velocity in the vehicle's own frame, forward and to the left \[m/s\].
    pub velocity: Vector2<f64>,
    /// Yaw rate, counter-clockwise \[rad/s\].
    pub yaw_rate: f64,
}

/// A wheel and its quantities for one substep. Impulses are per mass \[m/s\].
#[derive(Debug, Clone, Copy)]
struct Wheel {
    /// Position in the vehicle's frame, forward and to the left of the centre \[m\].
    at: Vector2<f64>,
    /// Unit vector of the direction in which the wheel rolls.
    rolling: Vector2<f64>,
    /// Unit vector along the axle, to the right.
    axle: Vector2<f64>,
    /// Sideways impulse that changes the wheel's sideways speed by 1 m/s.
    softness: f64,
    /// Share of the vehicle's weight that the wheel carries.
    load: f64,
}

impl Wheel {
    /// Returns the wheels of a vehicle, with the front wheels turned by `angle` to the
    /// left \[rad\].
    fn all(steering: &Steering, angle: f64) -> [Self; 4] {
        let Steering { front_axle, rear_axle, track, yaw_inertia, .. } = *steering;
        let wheel = |along: f64, across: f64, angle: f64, other_axle: f64| {
            let (sin, cos) = angle.sin_cos();
            let (at, axle) = (Vector2::new(along, across), Vector2::new(sin, -cos));
            let lever = at.perp(&axle);
            let rolls = ROLL * axle.y * axle.y + PITCH * axle.x * axle.x;
            Self {
                at,
                rolling: Vector2::new(cos, sin),
                axle,
                softness: (1.0 + lever * lever / yaw_inertia + rolls).recip(),
                load: 0.5 * other_axle / (front_axle + rear_axle),
            }
        };
        let half = track / 2.0;
        [
            wheel(front_axle, -half, angle, rear_axle),
            wheel(front_axle, half, angle, rear_axle),
            wheel(-rear_axle, -half, 0.0, front_axle),
            wheel(-rear_axle, half, 0.0, front_axle),
        ]
    }

    /// Returns the velocity of the wheel's position, in the vehicle's frame \[m/s\].
    fn velocity(&self, motion: &Motion) -> Vector2<f64> {
        motion.velocity + motion.yaw_rate * Vector2::new(-self.at.y, self.at.x)
    }

    /// Returns the impulse of the wheel on the vehicle in `dt` seconds, in the vehicle's frame.
    fn impulse(&self, motion: &Motion, drive: Drive, friction: f64, dt: f64) -> Vector2<f64> {
        let velocity = self.velocity(motion);
        let sideways = -DAMPING * dt * velocity.dot(&self.axle) * self.softness;
        let along = match drive {
            Drive::Thrust(acceleration) => acceleration * dt / 4.0,
            // A brake can stop a wheel, but not drive it.
            Drive::Brake(deceleration) => {
                let most = deceleration * dt / 4.0;
                -(velocity.dot(&self.rolling) / 4.0).clamp(-most, most)
            }
        };
        let (asked, held) = ((ALONG * along).hypot(sideways), friction * GRAVITY * dt * self.load);
        let impulse = along * self.rolling + sideways * self.axle;
        if asked > held { impulse * (held / asked) } else { impulse }
    }
}

impl Motion {
    /// Returns the motion of a vehicle at rest.
    pub const fn at(pose: Pose) -> Self {
        Self::driving(pose, 0.0)
    }

    /// Returns the motion of a vehicle that drives straight ahead at `speed` \[m/s\].
    pub const fn driving(pose: Pose, speed: f64) -> Self {
        Self { pose, velocity: Vector2::new(speed, 0.0), yaw_rate: 0.0 }
    }

    /// Returns the motion after one decision interval under the actions `steer` (positive to the
    /// left) and `throttle`. Both are clipped to -1..=1, and NaN counts as 0.
    #[must_use]
    pub fn advance(
        mut self,
        control: &Control,
        steering: &Steering,
        vehicle: &Vehicle,
        steer: f64,
        throttle: f64,
    ) -> Self {
        let steer = if steer.is_nan() { 0.0 } else { steer.clamp(-1.0, 1.0) };
        let wheels = Wheel::all(steering, steer * steering.max_angle.to_radians());
        let drive = longitudinal::drive(control, throttle);
        let substeps = (control.interval * RATE).round().max(1.0);
        let dt = control.interval / substeps;
        for _ in 0..substeps as u32 {
            self.coast(dt);
            self.push(&wheels, drive, steering, dt);
            self.velocity.x = self.velocity.x.clamp(-vehicle.max_speed, vehicle.max_speed);
        }
        self
    }

    /// Moves the vehicle by its velocity for `dt` seconds. The velocity keeps its direction in the
    /// plane while the vehicle's frame turns.
    fn coast(&mut self, dt: f64) {
        let (sin, cos) = self.pose.heading.sin_cos();
        self.pose.x += dt * (self.velocity.x * cos - self.velocity.y * sin);
        self.pose.y += dt * (self.velocity.x * sin + self.velocity.y * cos);
        let turn = dt * self.yaw_rate;
        self.pose.heading += turn;
        self.velocity = Rotation2::new(-turn) * self.velocity;
    }

    /// Changes the velocity by the impulses of all wheels, each computed from the velocity before
    /// any of them.
    fn push(&mut self, wheels: &[Wheel; 4], drive: Drive, steering: &Steering, dt: f64) {
        let before = *self;
        for wheel in wheels {
            let impulse = wheel.impulse(&before, drive, steering.friction, dt);
            self.velocity += impulse;
            self.yaw_rate += wheel.at.perp(&impulse) / steering.yaw_inertia;
        }
    }
}

/// Returns the radius of the circle on which the vehicle's centre turns at low speed with the
/// front wheels at full lock \[m\]. On this circle, the sideways impulses of all wheels and their
/// moments balance.
pub fn least_radius(steering: &Steering) -> f64 {
    // Impulse and moment are linear in the leftward velocity and the yaw rate, both per forward
    // speed.
    let (mut matrix, mut forward) = (Matrix2::zeros(), Vector2::zeros());
    for wheel in Wheel::all(steering, steering.max_angle.to_radians()) {
        let arm = Vector2::new(wheel.axle.y, wheel.at.perp(&wheel.axle));
        matrix += wheel.softness * arm * arm.transpose();
        forward -= wheel.softness * wheel.axle.x * arm;
    }
    let left_and_yaw = matrix.try_inverse().map_or(Vector2::zeros(), |inverse| inverse * forward);
    left_and_yaw.x.hypot(1.0) / left_and_yaw.y
}

#[cfg(test)]
mod tests;
