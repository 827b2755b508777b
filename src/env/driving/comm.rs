//! The physical communication mask G_p: which agents are in communication range of each other, from
//! positions alone (paper: "physical mask").

use super::geometry::Pose;

/// Writes the mask: `G_p[i, j] = 1` where vehicles `i` and `j` are both present and their centres
/// at most `range` metres apart, else 0. The diagonal is 1 for every present agent.
///
/// `poses` and `present`: `[N]`; `mask`: `[N, N]`, row `i` is the receiver.
pub fn physical_mask(poses: &[Pose], present: &[bool], range: f64, mask: &mut [f32]) {
    let n = poses.len();
    debug_assert_eq!(mask.len(), n * n);
    mask.fill(0.0);
    for i in (0..n).filter(|&i| present[i]) {
        mask[i * n + i] = 1.0;
        for j in (i + 1..n).filter(|&j| present[j]) {
            let (dx, dy) = (poses[i].x - poses[j].x, poses[i].y - poses[j].y);
            if dx * dx + dy * dy <= range * range {
                mask[i * n + j] = 1.0;
                mask[j * n + i] = 1.0;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn is_exactly_the_definition(
            vehicles in proptest::collection::vec((-80.0..80.0f64, -80.0..80.0f64, any::<bool>()), 1..12),
            range in 0.0..120.0f64,
        ) {
            let n = vehicles.len();
            let poses: Vec<_> = vehicles.iter().map(|v| Pose { x: v.0, y: v.1, heading: 0.0 }).collect();
            let present: Vec<_> = vehicles.iter().map(|v| v.2).collect();
            let mut mask = vec![7.0; n * n];
            physical_mask(&poses, &present, range, &mut mask);
            for i in 0..n {
                for j in 0..n {
                    let near = i == j || (poses[i].x - poses[j].x).powi(2) + (poses[i].y - poses[j].y).powi(2) <= range * range;
                    prop_assert_eq!(mask[i * n + j], f32::from(u8::from(present[i] && present[j] && near)));
                }
            }
        }
    }
}
