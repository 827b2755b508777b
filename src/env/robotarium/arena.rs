//! Robots in the arena, and the controller that drives them (`rps/robotarium_abc.py`; MARBLER,
//! `utilities/roboEnv.py` and `utilities/controller.py`).

use nalgebra::Vector2;

use super::certificate::certify;

/// Duration of a tick \[s\].
const TICK: f64 = 0.033;
/// Ticks between two computations of the velocities, as in MARBLER outside of the real testbed.
const CONTROL_PERIOD: u32 = 15;
/// Half the length and half the width of the arena \[m\].
pub(super) const HALF: [f64; 2] = [1.6, 1.0];
/// Diameter of a robot \[m\].
pub(super) const DIAMETER: f64 = 0.11;
/// Largest linear velocity \[m/s\], and largest angular velocity that the controller asks for
/// \[rad/s\]; the robot itself would turn at up to 3.64 rad/s.
const LINEAR: f64 = 0.2;
const ANGULAR: f64 = std::f64::consts::PI;
/// Largest speed that the position controller asks for \[m/s\]; its gain is 1 per second.
const APPROACH: f64 = 0.15;
/// Distance from a robot's centre to the point in front of it that the controller moves \[m\].
const AHEAD: f64 = 0.05;
/// Distance from a robot's centre to the point that collisions are tested at, and distance between
/// two such points at which robots collide \[m\].
const COLLISION_AHEAD: f64 = 0.025;
const COLLISION_DISTANCE: f64 = 0.135;

/// A robot: a unicycle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Robot {
    /// Centre \[m\].
    pub(super) centre: Vector2<f64>,
    /// Direction, counter-clockwise from the x axis \[rad\], and as a unit vector.
    pub(super) heading: f64,
    pub(super) direction: Vector2<f64>,
    /// Linear velocity \[m/s\].
    pub(super) linear: f64,
    /// Angular velocity \[rad/s\].
    angular: f64,
}

impl Robot {
    /// Returns a robot that stands at a place with its heading along the x axis.
    pub(super) fn at(centre: Vector2<f64>) -> Self {
        Self { centre, heading: 0.0, direction: Vector2::x(), linear: 0.0, angular: 0.0 }
    }

    fn ahead(&self, distance: f64) -> Vector2<f64> {
        self.centre + distance * self.direction
    }

    fn turn_to(&mut self, heading: f64) {
        self.heading = heading;
        self.direction = Vector2::new(heading.cos(), heading.sin());
    }

    /// Sets the velocities with which the point in front of the robot moves by `velocity`.
    fn follow(&mut self, velocity: Vector2<f64>) {
        let along = self.direction;
        self.linear = along.dot(&velocity).clamp(-LINEAR, LINEAR);
        self.angular = (along.perp(&velocity) / AHEAD).clamp(-ANGULAR, ANGULAR);
    }

    fn tick(&mut self) {
        self.centre += TICK * self.linear * self.direction;
        self.turn_to(self.heading + TICK * self.angular);
    }

    fn is_outside(&self) -> bool {
        self.centre.x.abs() > HALF[0] || self.centre.y.abs() > HALF[1]
    }
}

/// Drives robots towards their goals for a number of ticks. Returns which robots collided or left
/// the arena; the drive breaks off at the first tick with such a violation.
pub(super) fn drive(robots: &mut [Robot], goals: &[Vector2<f64>], ticks: u32) -> Vec<bool> {
    let mut violations = vec![false; robots.len()];
    for tick in 0..ticks {
        if tick % CONTROL_PERIOD == 0 {
            let points: Vec<_> = robots.iter().map(|robot| robot.ahead(AHEAD)).collect();
            let toward = points.iter().zip(goals).map(|(point, goal)| capped(goal - point));
            let mut velocities: Vec<_> = toward.collect();
            certify(&points, &mut velocities);
            for (robot, velocity) in robots.iter_mut().zip(velocities) {
                robot.follow(velocity);
            }
        }
        robots.iter_mut().for_each(Robot::tick);
        validate(robots, &mut violations);
        if violations.contains(&true) {
            break;
        }
    }
    violations
}

fn capped(velocity: Vector2<f64>) -> Vector2<f64> {
    velocity * (APPROACH / velocity.norm().max(APPROACH))
}

/// Notes which robots are outside of the arena or collide with another one.
fn validate(robots: &[Robot], violations: &mut [bool]) {
    for (i, robot) in robots.iter().enumerate() {
        violations[i] |= robot.is_outside();
        let point = robot.ahead(COLLISION_AHEAD);
        for (j, other) in robots[..i].iter().enumerate() {
            let apart = point - other.ahead(COLLISION_AHEAD);
            if apart.norm_squared() <= COLLISION_DISTANCE * COLLISION_DISTANCE {
                (violations[i], violations[j]) = (true, true);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(x: f64, y: f64) -> Robot {
        Robot::at(Vector2::new(x, y))
    }

    /// A robot alone approaches its goal as the proportional controller says: at 0.15 m/s while far
    /// away, and the point ahead of its centre ends at the goal.
    #[test]
    fn a_robot_reaches_its_goal() {
        let mut robots = [robot(-1.0, 0.0)];
        drive(&mut robots, &[Vector2::new(1.0, 0.0)], 29);
        assert!((robots[0].centre.x - (-1.0 + 29.0 * 0.033 * 0.15)).abs() < 1e-9);
        for _ in 0..60 {
            assert_eq!(drive(&mut robots, &[Vector2::new(0.0, 0.5)], 29), [false]);
        }
        assert!((robots[0].ahead(AHEAD) - Vector2::new(0.0, 0.5)).norm() < 1e-3, "{robots:?}");
    }

    /// Robots that drive at each other do not collide, whatever their goals are.
    #[test]
    fn the_certificate_prevents_collisions() {
        let mut robots = [robot(-0.6, 0.0), robot(0.6, 0.01), robot(0.0, 0.6), robot(0.02, -0.6)];
        robots[1].turn_to(std::f64::consts::PI);
        let goals = [[0.6, 0.0], [-0.6, 0.0], [0.0, -0.6], [0.0, 0.6]].map(Vector2::from);
        for _ in 0..100 {
            assert_eq!(drive(&mut robots, &goals, 29), [false; 4], "{robots:?}");
        }
    }

    /// A robot that is driven out of the arena is a violation, of itself alone.
    #[test]
    fn the_arena_ends() {
        let mut robots = [robot(1.5, 0.0), robot(-1.0, 0.0)];
        let goals = [[1.8, 0.0], [-1.0, 0.0]].map(Vector2::from);
        let found = (0..3).map(|_| drive(&mut robots, &goals, 29)).find(|all| all.contains(&true));
        assert_eq!(found, Some(vec![true, false]));
    }

    /// The points in front of two robots that touch are nearer than the distance of a collision.
    #[test]
    fn robots_that_touch_collide() {
        let mut violations = vec![false; 3];
        validate(&[robot(0.0, 0.0), robot(0.134, 0.0), robot(0.6, 0.0)], &mut violations);
        assert_eq!(violations, [true, true, false]);
    }
}
