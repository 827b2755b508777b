//! Stretches that two routes have in common.

/// A stretch of another route on which vehicles count as on this route, too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Shared {
    /// Beginning of the stretch, as a position on the other route.
    pub(super) from: f64,
    /// End of the stretch, as a position on the other route.
    pub(super) to: f64,
    /// Position on this route minus the position of the same place on the other route.
    pub(super) shift: f64,
}

impl Shared {
    /// A whole route, shared with itself.
    pub(super) const IDENTITY: Self =
        Self { from: f64::NEG_INFINITY, to: f64::INFINITY, shift: 0.0 };
}

/// Distance between the positions at which paths are compared \[m\].
pub(super) const STEP: f64 = 0.25;
