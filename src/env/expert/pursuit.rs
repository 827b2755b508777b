//! Pure pursuit (Coulter 1992): the front wheels steer onto the circle through a point ahead on the
//! path.

use super::fcfs::giving_way;
use crate::env::driving::agents::Status;
use crate::env::driving::geometry::Pose;
use crate::env::driving::world::World;
use crate::scenario::Steering;
use crate::sumo::net::Path;

/// Distance along the path to the point ahead \[m\].
const LOOK_AHEAD: f64 = 4.0;

/// A rule-based policy that follows its route by pure pursuit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pursuit {
    /// Speed \[m/s\].
    pub speed: f64,
    /// Whether the policy gives way by the rule first come, first served; otherwise it ignores
    /// other vehicles.
    pub gives_way: bool,
}

impl World {
    /// Writes the actions of such a policy for all slots, `[N, A]`.
    ///
    /// # Panics
    /// If the policy gives way and the world does not keep the right of way ([`Driver::Rules`](crate::env::Driver::Rules)).
    pub fn pursue(&self, Pursuit { speed, gives_way }: Pursuit, actions: &mut [f32]) {
        let (task, n) = (self.task(), self.task().agents);
        let reverses = task.scenario.control.steering.is_some_and(|steering| steering.reverse);
        let waits = if gives_way {
            assert!(self.keeps_right_of_way(), "the world knows no priorities");
            giving_way(task, self.traffic())
        } else {
            vec![false; n]
        };
        for (i, action) in actions.chunks_mut(task.spec.actions.len()).enumerate() {
            let [steer, throttle] = self.pursuit(i, if waits[i] { 0.0 } else { speed });
            // Where full brake does not drive backwards, it stops the vehicle fastest.
            let throttle = if waits[i] && !reverses { -1.0 } else { throttle };
            let values = task.action(steer, throttle);
            action.iter_mut().zip(values).for_each(|(to, from)| *to = from as f32);
        }
    }

    /// Returns steering and throttle with which the agent of a slot follows its route at
    /// `speed` \[m/s\]. Steering is by pure pursuit; the throttle closes a gap in speed within
    /// half a second.
    pub fn pursuit(&self, slot: usize, speed: f64) -> [f64; 2] {
        let (task, own) = (self.task(), &self.traffic().slots[slot]);
        let control = &task.scenario.control;
        let throttle = ((speed - own.speed) / (0.5 * control.accel)).clamp(-1.0, 1.0);
        let Some(steering) = control.steering.filter(|_| own.status == Status::Active) else {
            return [0.0, throttle];
        };
        [steer(&steering, &task.map.routes[own.route].path, own.s, &own.pose), throttle]
    }
}

/// Returns the steering command, -1 to 1 (left), of a vehicle at position `s` on a path.
pub(crate) fn steer(steering: &Steering, path: &Path, s: f64, pose: &Pose) -> f64 {
    let ([x, y], _) = path.at(s + LOOK_AHEAD);
    let (dx, dy) = (x - pose.x, y - pose.y);
    let bearing = dy.atan2(dx) - pose.heading;
    let wheel = (2.0 * steering.wheelbase() * bearing.sin() / dx.hypot(dy).max(1.0)).atan();
    (wheel / steering.max_angle.to_radians()).clamp(-1.0, 1.0)
}
