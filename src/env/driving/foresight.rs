//! Foresight: how closely two vehicles will pass each other if both keep to their paths and speeds.

use super::agents::{Candidate, Slot};
use super::geometry::{Size, Stance, beside, separation};
use super::routes::RouteGeometry;
use crate::sumo::net::Path;

/// Speed that foresight assumes for an agent that stands or drives slowly \[m/s\].
pub(crate) const DRIVING: f64 = 6.0;
/// Largest gap between two vehicles that counts as close \[m\].
const CLOSE: f64 = 3.0;
/// Time step of the search for vehicles that are close: the distance that both drive in it,
/// together \[m\], and the least and greatest step \[s\].
const LOOK: (f64, f64, f64) = (0.6, 0.1, 0.4);

/// Predicted motion of a vehicle along its path, at its present lateral offset and a constant speed
/// \[m/s\].
#[derive(Clone, Copy)]
pub(crate) struct Course<'a> {
    path: &'a Path,
    /// The course's route, which knows where other routes pass over it.
    route: Option<&'a RouteGeometry>,
    place: Candidate,
    size: Size,
    speed: f64,
}

impl<'a> Course<'a> {
    /// The course along the vehicle's own route.
    pub(crate) fn new(routes: &'a [RouteGeometry], slot: &Slot, speed: f64) -> Self {
        Self::on(routes, Candidate::of(slot), slot.size, speed)
    }

    /// The course along a candidate route.
    pub(crate) fn on(
        routes: &'a [RouteGeometry],
        place: Candidate,
        size: Size,
        speed: f64,
    ) -> Self {
        let route = &routes[place.route];
        Self { path: &route.path, route: Some(route), place, size, speed }
    }

    /// Returns the pose after `time` seconds. The search on the path begins at `segment`, which
    /// becomes the segment of that pose.
    fn at(&self, time: f64, segment: &mut usize) -> Stance {
        let (point, on) = self.path.locate_from(self.place.s + self.speed * time, *segment);
        *segment = on;
        beside(point, self.path.direction(on), self.place.lateral)
    }

    /// Whether the two vehicles are on different levels after `time` seconds.
    fn passes_over(&self, other: &Self, time: f64) -> bool {
        let at = |course: &Self| course.place.s + course.speed * time;
        let lengths = self.size[0] + other.size[0];
        self.route
            .is_some_and(|route| route.passes_over(at(self), other.place.route, at(other), lengths))
    }

    /// Half the diagonal of the vehicle \[m\].
    fn reach(&self) -> f64 {
        let [length, width] = self.size;
        (length * length + width * width).sqrt() / 2.0
    }
}

/// Returns how closely two vehicles pass each other within `horizon` seconds, and how soon.
///
/// The first number is the closeness: 0 for a gap of [`CLOSE`] or more, 1 for contact. The second
/// is 1 if they are closest, or touch, now, and 0 at the horizon or where they do not pass closely.
pub(crate) fn passing(a: Course<'_>, b: Course<'_>, horizon: f64) -> [f64; 2] {
    let mut closest = Closest::within(horizon);
    closest.look(a, b, 0.0);
    closest.numbers()
}

/// The closest passing found so far of a vehicle and another that has several possible courses; of
/// equally close passings the earliest.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Closest {
    /// Smallest gap between the two vehicles \[m\].
    least: f64,
    /// Time of the smallest gap \[s\].
    when: f64,
    horizon: f64,
}

impl Closest {
    pub(crate) fn within(horizon: f64) -> Self {
        Self { least: CLOSE, when: horizon, horizon }
    }

    /// Searches a course of each vehicle for a closer passing, from time `from` on \[s\].
    pub(crate) fn look(&mut self, a: Course<'_>, b: Course<'_>, from: f64) {
        let (closing, reach) = (a.speed.abs() + b.speed.abs(), a.reach() + b.reach());
        let step = (LOOK.0 / closing).clamp(LOOK.1, LOOK.2);
        let mut segments = [a.place.segment, b.place.segment];
        // After a contact only an earlier contact is of interest.
        let (mut time, end) = (from, if self.least > 0.0 { self.horizon } else { self.when });
        while time < end {
            let (own, other) = (a.at(time, &mut segments[0]), b.at(time, &mut segments[1]));
            let far = (own.translation.vector - other.translation.vector).norm() - reach;
            // The vehicles' orientations matter only for the few pairs that are this close.
            let apart =
                if far <= self.least { separation((own, a.size), (other, b.size)) } else { far };
            // Vehicles on different levels come no closer than others that are just out of reach.
            let apart = if apart <= self.least && a.passes_over(&b, time) {
                self.least.max(f64::MIN_POSITIVE)
            } else {
                apart
            };
            if apart < self.least || apart <= 0.0 {
                (self.least, self.when) = (apart.max(0.0), time);
            }
            if closing <= 0.0 || apart <= 0.0 {
                break;
            }
            // Before that time the gap cannot fall below the smallest one found.
            time += ((apart - self.least) / closing).max(step);
        }
    }

    /// Returns the two numbers of [`passing`].
    pub(crate) fn numbers(self) -> [f64; 2] {
        [1.0 - self.least / CLOSE, 1.0 - self.when / self.horizon]
    }
}

#[cfg(test)]
mod tests {
    use super::super::task::Task;
    use super::super::tests::scenario;
    use super::*;
    use proptest::prelude::*;

    const SIZE: [f64; 2] = [4.5, 1.85];
    const HORIZON: f64 = 4.0;

    /// Foresight for vehicles at positions `s` with these speeds, on two paths that cross at right
    /// angles 50 m from both starts.
    fn crossing(s: [f64; 2], speed: [f64; 2]) -> [f64; 2] {
        let points = [[[0.0, 0.0], [100.0, 0.0]], [[50.0, -50.0], [50.0, 50.0]]];
        let paths = points.map(|points| Path::from_points(points, 3.5).expect("two points"));
        let place = |i: usize| Candidate { route: i, s: s[i], lateral: 0.0, segment: 0 };
        let course = |i: usize| Course {
            path: &paths[i],
            route: None,
            place: place(i),
            size: [4.0, 2.0],
            speed: speed[i],
        };
        passing(course(0), course(1), HORIZON)
    }

    #[test]
    fn a_crossing_is_foreseen_from_the_distances_that_are_left() {
        // Contact happens when both vehicles are 3 m from the crossing.
        let touching = [
            ([27.0, 27.0], [10.0, 10.0], 2.0),
            ([37.0, 7.0], [5.0, 20.0], 2.0),
            ([47.0, 47.0], [0.0, 8.0], 0.0),
        ];
        for (s, speed, time) in touching {
            let [close, soon] = crossing(s, speed);
            let found = HORIZON * (1.0 - soon);
            assert!(
                close == 1.0 && (time..=time + LOOK.2).contains(&found),
                "{close}, {found} s, and not {time}"
            );
        }
        // The first vehicle passes the second, which stands 2 m beside its path.
        let [close, soon] = crossing([30.0, 45.0], [10.0, 0.0]);
        assert!((close - 1.0 / 3.0).abs() < 1e-9 && soon > 0.4, "{close} {soon}");
        // In order: one passes long before the other; a standing vehicle is not reached; neither
        // moves; contact is beyond the horizon.
        for (s, speed) in [
            ([27.0, 0.0], [10.0, 10.0]),
            ([30.0, 47.0], [0.0, 8.0]),
            ([40.0, 40.0], [0.0, 0.0]),
            ([2.0, 2.0], [10.0, 10.0]),
        ] {
            assert_eq!(crossing(s, speed), [0.0; 2], "{s:?} {speed:?}");
        }
    }

    proptest! {
        /// On all routes of an intersection with turns, foresight agrees with a search in steps of
        /// 0.01 s.
        #[test]
        fn foresight_agrees_with_a_fine_search(
            routes in [0usize..12, 0usize..12],
            s in [5.0..60.0, 5.0..60.0],
            speed in [-1.0..12.0, 0.0..12.0],
            lateral in [-0.4..0.4, -0.4..0.4],
        ) {
            let task = Task::new(&scenario("intersection_turns_small"), 8).expect("a task");
            let slots = [0, 1].map(|i| Slot { route: routes[i], s: s[i], lateral: lateral[i], size: SIZE, ..Slot::default() });
            let [a, b] = [0, 1].map(|i| Course::new(&task.map.routes, &slots[i], speed[i]));
            let [close, soon] = passing(a, b, HORIZON);
            prop_assert_eq!([close, soon], passing(b, a, HORIZON), "the same for both");
            let (apart, when) = (CLOSE * (1.0 - close), HORIZON * (1.0 - soon));
            let at = |time: f64| separation((a.at(time, &mut 0), SIZE), (b.at(time, &mut 0), SIZE));
            // The search ends at the first contact.
            let (mut least, mut touched) = (CLOSE, None);
            for i in 0..400 {
                let time = f64::from(i) * 0.01;
                least = least.min(at(time).max(0.0));
                if least <= 0.0 {
                    touched = Some(time);
                    break;
                }
            }
            // Between two steps of the search the gap shrinks by what both vehicles drive, and by
            // how far a bend of the path moves their corners.
            let together = a.speed.abs() + b.speed.abs();
            let between = 1.5 * LOOK.0.max(together * LOOK.1) + 0.3;
            prop_assert!((least - 0.2..=least + between).contains(&apart), "{apart} m instead of {least}");
            if let Some(touched) = touched.filter(|_| close == 1.0) {
                prop_assert!(when > touched - 0.02, "foreseen in {when} s, seen in {touched} s");
            }
            prop_assert!(close == 0.0 || at(when).max(0.0) - apart < 1e-9, "they are as close as that then");
        }
    }
}
