//! The area of a conflict: the stretches of both paths on which a vehicle is in the way of
//! vehicles on the other path.

use super::geometry::{Pose, Size, boxes_overlap};
use super::shared::STEP;
use crate::sumo::net::Path;

/// Where the centre of a vehicle enters and leaves a stretch of its path \[m\].
pub(super) type Stretch = [f64; 2];

/// Returns the stretches of the first and of the second path, around the places `at` of a conflict,
/// on which a vehicle of this size touches some vehicle on the other path. They begin and end at
/// most [`FAR`] metres from the places, since paths that merge do not part again.
pub(super) fn around(paths: [&Path; 2], at: [f64; 2], size: Size) -> [Stretch; 2] {
    [stretch(paths, at, size), stretch([paths[1], paths[0]], [at[1], at[0]], size)]
}

/// Greatest distance of an end of an area from the place of its conflict \[m\].
const FAR: f64 = 20.0;

/// Returns the stretch of the first path.
fn stretch([own, other]: [&Path; 2], [at, met]: [f64; 2], size: Size) -> Stretch {
    let reach = (FAR / STEP) as i32;
    let far = |k: i32| f64::from(k) * STEP;
    let end = |sign: i32| {
        // Where on the other path the vehicle was last touched; the next place is near it.
        let mut last = 0;
        let mut touches = |k: i32| {
            let here = Pose::on(own, at + far(sign * k));
            let hit =
                |l: &i32| boxes_overlap((&here, size), (&Pose::on(other, met + far(*l)), size));
            let near = (0..=2 * reach).flat_map(|d| [last + d, last - d]);
            let found = near.filter(|l| l.abs() <= reach).find(hit);
            last = found.unwrap_or(last);
            found.is_some()
        };
        let steps = (1..=reach).take_while(|k| touches(*k)).count();
        at + far(sign) * steps as f64
    };
    [end(-1), end(1)]
}
