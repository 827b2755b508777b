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

/// Cuts all edges of a mask but those to the `most` nearest other vehicles of each receiver. Of
/// vehicles at the same distance, those in lower slots stay.
///
/// `poses`: `[N]`; `mask`: `[N, N]`, row `i` is the receiver; `near` is working memory.
pub(super) fn keep_nearest(
    poses: &[Pose],
    most: usize,
    mask: &mut [f32],
    near: &mut Vec<(f64, usize)>,
) {
    for (i, row) in mask.chunks_exact_mut(poses.len()).enumerate() {
        let distance = |j: usize| {
            let (dx, dy) = (poses[i].x - poses[j].x, poses[i].y - poses[j].y);
            dx * dx + dy * dy
        };
        near.clear();
        near.extend((0..row.len()).filter(|&j| j != i && row[j] > 0.0).map(|j| (distance(j), j)));
        if near.len() > most {
            near.select_nth_unstable_by(most, |a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for &(_, j) in &near[most..] {
                row[j] = 0.0;
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

        #[test]
        fn the_nearest_stay_and_all_others_are_cut(
            // Whole numbers, so that some distances are equal.
            places in proptest::collection::vec((-6..6i32, -6..6i32), 1..14),
            range in 0.0..12.0f64,
            most in 0..6usize,
        ) {
            let n = places.len();
            let poses: Vec<_> = places.iter().map(|p| Pose { x: f64::from(p.0), y: f64::from(p.1), heading: 0.0 }).collect();
            let (mut all, mut near) = (vec![0.0; n * n], Vec::new());
            physical_mask(&poses, &vec![true; n], range, &mut all);
            let mut mask = all.clone();
            keep_nearest(&poses, most, &mut mask, &mut near);
            for i in 0..n {
                prop_assert_eq!(mask[i * n + i], 1.0);
                let square = |j: usize| (places[i].0 - places[j].0).pow(2) + (places[i].1 - places[j].1).pow(2);
                let mut others: Vec<_> = (0..n).filter(|&j| j != i && all[i * n + j] > 0.0).collect();
                others.sort_by_key(|&j| (square(j), j));
                for (rank, &j) in others.iter().enumerate() {
                    prop_assert_eq!(mask[i * n + j], f32::from(u8::from(rank < most)));
                }
                let kept = (0..n).filter(|&j| mask[i * n + j] > 0.0).count();
                prop_assert_eq!(kept, 1 + others.len().min(most));
            }
        }
    }
}
