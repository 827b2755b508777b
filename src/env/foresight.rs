//! How closely two vehicles will pass each other if both keep to their ways and speeds: what a driver foresees.

use super::geometry::{Size, Stance, separation};
use super::intention::Candidate;
use super::routes::RouteGeometry;
use super::slots::Slot;
use crate::sumo::net::Path;

/// Speed at which an agent that stands or crawls would drive \[m/s\].
pub(super) const DRIVING: f64 = 6.0;
/// Who passes no closer than this is not foreseen \[m\].
const CLOSE: f64 = 3.0;
/// Between two looks at vehicles that are close they drive this far together \[m\], but for these bounds of the time between \[s\].
const LOOK: (f64, f64, f64) = (0.6, 0.1, 0.4);

/// A vehicle that keeps to its way, as far beside its middle as it is, and to a speed \[m/s\].
#[derive(Clone, Copy)]
pub(super) struct Course<'a> {
    path: &'a Path,
    place: Candidate,
    size: Size,
    speed: f64,
}

impl<'a> Course<'a> {
    /// On the vehicle's own route.
    pub(super) fn new(routes: &'a [RouteGeometry], slot: &Slot, speed: f64) -> Self {
        Self::on(routes, Candidate::of(slot), slot.size, speed)
    }

    /// On a route that it may take.
    pub(super) fn on(
        routes: &'a [RouteGeometry],
        place: Candidate,
        size: Size,
        speed: f64,
    ) -> Self {
        Self { path: &routes[place.route].path, place, size, speed }
    }

    /// Where it is; looked for from a segment of its way on, which becomes the one that it is on.
    fn at(&self, time: f64, segment: &mut usize) -> Stance {
        let (point, on) = self.path.locate_from(self.place.s + self.speed * time, *segment);
        *segment = on;
        Stance::beside(point, self.path.direction(on), self.place.lateral)
    }

    /// How far from its middle it reaches \[m\].
    fn reach(&self) -> f64 {
        let [length, width] = self.size;
        (length * length + width * width).sqrt() / 2.0
    }
}

/// How closely two vehicles pass each other within `horizon` seconds, from 0, [`CLOSE`] or farther apart, to 1, touching; and how soon
/// they are closest, or touch, from 1 now to 0 at the horizon, where they pass closely.
pub(super) fn passing(a: Course<'_>, b: Course<'_>, horizon: f64) -> [f64; 2] {
    let mut closest = Closest::within(horizon);
    closest.look(a, b, 0.0);
    closest.told()
}

/// The closest passing of a vehicle and another that may take several courses, and of equally close
/// ones the soonest.
#[derive(Debug, Clone, Copy)]
pub(super) struct Closest {
    /// Gap between the two \[m\].
    least: f64,
    /// When it is so small \[s\].
    when: f64,
    horizon: f64,
}

impl Closest {
    pub(super) fn within(horizon: f64) -> Self {
        Self { least: CLOSE, when: horizon, horizon }
    }

    /// Looks along a course of each from the time `from` on \[s\].
    pub(super) fn look(&mut self, a: Course<'_>, b: Course<'_>, from: f64) {
        let (closing, reach) = (a.speed.abs() + b.speed.abs(), a.reach() + b.reach());
        let step = (LOOK.0 / closing).clamp(LOOK.1, LOOK.2);
        let mut segments = [a.place.segment, b.place.segment];
        // Of two that touch, only when they do so first is of interest.
        let (mut time, end) = (from, if self.least > 0.0 { self.horizon } else { self.when });
        while time < end {
            let (own, other) = (a.at(time, &mut segments[0]), b.at(time, &mut segments[1]));
            let [dx, dy] = [0, 1].map(|axis| own.middle[axis] - other.middle[axis]);
            let far = (dx * dx + dy * dy).sqrt() - reach;
            // Few pairs are so close that it matters how they stand.
            let apart =
                if far <= self.least { separation((own, a.size), (other, b.size)) } else { far };
            if apart < self.least || apart <= 0.0 {
                (self.least, self.when) = (apart.max(0.0), time);
            }
            if closing <= 0.0 || apart <= 0.0 {
                break;
            }
            // Until then they cannot be closer than they have been.
            time += ((apart - self.least) / closing).max(step);
        }
    }

    /// As [`passing`].
    pub(super) fn told(self) -> [f64; 2] {
        [1.0 - self.least / CLOSE, 1.0 - self.when / self.horizon]
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path as File;

    use proptest::prelude::*;

    use super::super::Task;
    use super::super::slots::EMPTY;
    use super::*;
    use crate::scenario::Scenario;

    const SIZE: [f64; 2] = [4.5, 1.85];
    const HORIZON: f64 = 4.0;

    /// Places and speeds on two ways that cross at right angles, 50 m from both starts.
    fn crossing(s: [f64; 2], speed: [f64; 2]) -> [f64; 2] {
        let points = [[[0.0, 0.0], [100.0, 0.0]], [[50.0, -50.0], [50.0, 50.0]]];
        let paths = points.map(|points| Path::from_points(points, 3.5).expect("two points"));
        let place = |i: usize| Candidate { route: i, s: s[i], lateral: 0.0, segment: 0 };
        let course = |i: usize| Course {
            path: &paths[i],
            place: place(i),
            size: [4.0, 2.0],
            speed: speed[i],
        };
        passing(course(0), course(1), HORIZON)
    }

    #[test]
    fn a_crossing_is_foreseen_from_the_ways_that_are_left() {
        // They touch when both are 3 m from the crossing.
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
        // One drives by before the other, which stands 2 m beside its way.
        let [close, soon] = crossing([30.0, 45.0], [10.0, 0.0]);
        assert!((close - 1.0 / 3.0).abs() < 1e-9 && soon > 0.4, "{close} {soon}");
        // One passes long before; one that stands is not reached; nobody moves; beyond the horizon.
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
        /// On all routes of an intersection with turns, against looking every hundredth of a second.
        #[test]
        fn what_is_foreseen_is_what_a_close_look_finds(
            routes in [0usize..12, 0usize..12],
            s in [5.0..60.0, 5.0..60.0],
            speed in [-1.0..12.0, 0.0..12.0],
            lateral in [-0.4..0.4, -0.4..0.4],
        ) {
            let path = File::new(env!("CARGO_MANIFEST_DIR")).join("scenarios/intersection_turns_small.xml");
            let task = Task::new(&Scenario::load(&path).expect("a scenario"), 8).expect("a task");
            let slots = [0, 1].map(|i| Slot { route: routes[i], s: s[i], lateral: lateral[i], size: SIZE, ..EMPTY });
            let [a, b] = [0, 1].map(|i| Course::new(&task.routes, &slots[i], speed[i]));
            let [close, soon] = passing(a, b, HORIZON);
            prop_assert_eq!([close, soon], passing(b, a, HORIZON), "the same for both");
            let (apart, when) = (CLOSE * (1.0 - close), HORIZON * (1.0 - soon));
            let at = |time: f64| separation((a.at(time, &mut 0), SIZE), (b.at(time, &mut 0), SIZE));
            // Up to where they touch, if they do.
            let (mut least, mut touched) = (CLOSE, None);
            for i in 0..400 {
                let time = f64::from(i) * 0.01;
                least = least.min(at(time).max(0.0));
                if least <= 0.0 {
                    touched = Some(time);
                    break;
                }
            }
            // Between two looks they come closer by what both drive, and by what a turn of the way moves their corners.
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
