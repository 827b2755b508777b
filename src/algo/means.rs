//! Means of an update's diagnostics.

use tch::Tensor;

use super::{Error, Losses};

/// Running means of diagnostics over the gradient steps of an update.
#[derive(Default)]
pub(super) struct Means {
    sums: Losses,
    count: f64,
}

impl Means {
    pub(super) fn add(&mut self, values: &[(&'static str, f64)]) {
        if self.sums.is_empty() {
            self.sums = values.iter().map(|(name, _)| (*name, 0.0)).collect();
        }
        for (sum, value) in self.sums.iter_mut().zip(values) {
            sum.1 += value.1;
        }
        self.count += 1.0;
    }

    /// Returns the means and the `extra` diagnostics.
    ///
    /// # Errors
    /// [`Error::NonFinite`] when a diagnostic is not finite.
    pub(super) fn finish(self, extra: &[(&'static str, f64)]) -> Result<Losses, Error> {
        let mut losses: Losses =
            self.sums.into_iter().map(|(name, sum)| (name, sum / self.count.max(1.0))).collect();
        losses.extend_from_slice(extra);
        match losses.iter().find(|(_, value)| !value.is_finite()) {
            Some((what, _)) => Err(Error::NonFinite { what }),
            None => Ok(losses),
        }
    }
}

/// Returns the value of a tensor with one element.
pub(super) fn scalar(tensor: &Tensor) -> f64 {
    tensor.double_value(&[])
}
