//! Means and 95 % confidence intervals.
//!
//! Every number that the program reports about a policy is a mean over independent units (episodes
//! or seeds). It comes with an interval, so that two rows of a table can be compared. Unbounded
//! quantities get Student's t interval. Rates in `0..=1` get Wilson's score interval, which stays
//! inside `0..=1` and does not collapse to a point when every episode succeeds or none does. This
//! module imports nothing of this crate.

pub mod aggregate;
pub mod contrast;

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize};
use statrs::distribution::{ChiSquared, ContinuousCDF as _};
use statrs::function::beta::beta_reg;

/// The 97.5 % quantile of the standard normal distribution: half the width of a 95 % interval, in
/// standard errors.
const Z_975: f64 = 1.959_963_984_540_054;

/// Returns the arithmetic mean; `None` without values.
pub fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Returns the sample standard deviation (divisor `n - 1`); `None` for fewer than two values.
pub fn sample_sd(values: &[f64]) -> Option<f64> {
    let mean = mean(values)?;
    let n = values.len();
    (n > 1)
        .then(|| (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1) as f64).sqrt())
}

/// A mean with its 95 % confidence interval.
///
/// In JSON an infinite bound and a mean that is NaN are `null`; deserialisation restores the
/// infinities and NaN.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// Mean of the values, in their unit.
    #[serde(deserialize_with = "nan_if_null")]
    pub mean: f64,
    /// Lower end of the 95 % interval; `-inf` if the values give no lower bound.
    #[serde(deserialize_with = "negative_infinity_if_null")]
    pub low: f64,
    /// Upper end of the 95 % interval; `+inf` if the values give no upper bound.
    #[serde(deserialize_with = "infinity_if_null")]
    pub high: f64,
}

impl Default for Estimate {
    /// Returns an estimate that is not known: three NaN.
    fn default() -> Self {
        Self { mean: f64::NAN, low: f64::NAN, high: f64::NAN }
    }
}

impl Estimate {
    /// Returns Student's t interval of the mean of independent values:
    /// `mean ± t(0.975, n-1)·sd/√n`.
    ///
    /// The result is `None` without values. The spread of a single value is unknown, so its
    /// interval is `(-inf, +inf)`. A NaN among the values makes all three numbers NaN.
    pub fn t(values: &[f64]) -> Option<Self> {
        let mean = mean(values)?;
        let half = match sample_sd(values) {
            Some(sd) => {
                let n = values.len() as f64;
                student_t_quantile(0.975, n - 1.0) * sd / n.sqrt()
            }
            None => f64::INFINITY,
        };
        Some(Self { mean, low: mean - half, high: mean + half })
    }

    /// Returns Wilson's score interval of a rate, from one value in `0..=1` per independent unit.
    ///
    /// The unit is the episode: agents of one episode crash together. Each episode therefore
    /// contributes the *fraction* of its agents that succeeded, and `n` is the number of episodes,
    /// not of agents. A fraction varies at most as much as a yes/no value with the same mean, so
    /// the interval is rather too wide than too narrow.
    ///
    /// The result is `None` without values. A single value gives a valid but very wide interval.
    /// Values must be in `0..=1`; a mean outside that range (rounding) is moved to the nearer end.
    pub fn rate(values: &[f64]) -> Option<Self> {
        Self::rate_of(mean(values)?, values.len() as u64)
    }

    /// Returns Wilson's score interval of a rate whose mean over `count` independent units is
    /// `mean`, as [`Estimate::rate`] does; `None` if `count` is 0.
    pub fn rate_of(mean: f64, count: u64) -> Option<Self> {
        if count == 0 {
            return None;
        }
        let (mean, n) = (mean.clamp(0.0, 1.0), count as f64);
        let z2 = Z_975 * Z_975;
        let centre = (mean + z2 / (2.0 * n)) / (1.0 + z2 / n);
        let half = Z_975 / (1.0 + z2 / n) * (mean * (1.0 - mean) / n + z2 / (4.0 * n * n)).sqrt();
        // The exact bounds at a mean of 0 or 1 are 0 or 1; rounding must not move them past the
        // mean.
        Some(Self {
            mean,
            low: (centre - half).max(0.0).min(mean),
            high: (centre + half).min(1.0).max(mean),
        })
    }

    /// Returns the exposure (kilometres, hours) per event, with the exact interval of a Poisson
    /// count (Garwood 1936): the bounds of the count are quantiles of the chi-squared distribution.
    ///
    /// Without an event there is only a lower bound: the mean is NaN and the upper bound infinite.
    /// The interval assumes that events are independent; if events occur in clusters, it is too
    /// narrow. The result is `None` without exposure.
    pub fn exposure_per_event(exposure: f64, events: u64) -> Option<Self> {
        if !(exposure > 0.0 && exposure.is_finite()) {
            return None;
        }
        let [fewest, most] = garwood(events);
        let mean = if events > 0 { exposure / events as f64 } else { f64::NAN };
        Some(Self { mean, low: exposure / most, high: exposure / fewest })
    }
}

/// Returns the exact 95 % interval of the mean of a Poisson distribution, given a count of
/// `events`.
fn garwood(events: u64) -> [f64; 2] {
    let half_quantile = |p: f64, degrees: f64| {
        ChiSquared::new(degrees).expect("degrees of freedom are above 0").inverse_cdf(p) / 2.0
    };
    let events = events as f64;
    let low = if events > 0.0 { half_quantile(0.025, 2.0 * events) } else { 0.0 };
    [low, half_quantile(0.975, 2.0 * events + 2.0)]
}

/// Writes mean and interval, e.g. `88.1 [82.9, 91.9]`, with the decimals of the format's precision
/// (default 1). Without bounds only the mean is written, with only a lower bound `> 12.3`.
impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let digits = f.precision().unwrap_or(1);
        if self.mean.is_nan() && self.low.is_finite() {
            return write!(f, "> {:.digits$}", self.low);
        }
        write!(f, "{:.digits$}", self.mean)?;
        if self.low.is_finite() && self.high.is_finite() {
            write!(f, " [{:.digits$}, {:.digits$}]", self.low, self.high)?;
        }
        Ok(())
    }
}

fn nan_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

fn infinity_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

fn negative_infinity_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NEG_INFINITY))
}

/// Returns a quantile of Student's t distribution: the `t` with `P(T <= t) = p`, for `df` degrees
/// of freedom.
///
/// The absolute error is below 1e-6 for quantiles up to a few hundred. The result is NaN unless
/// `0 < p < 1` and `df > 0`.
pub fn student_t_quantile(p: f64, df: f64) -> f64 {
    if !(p > 0.0 && p < 1.0 && df > 0.0) {
        return f64::NAN;
    }
    if p < 0.5 {
        return -student_t_quantile(1.0 - p, df);
    }
    // P(|T| > t) = I_x(df/2, 1/2) with x = df/(df + t²) falls steadily in t. The upper end is
    // doubled until it exceeds the root; then the interval is halved. The library's own quantile is
    // wrong in the fourth digit for many degrees of freedom.
    let two_tails = 2.0 * (1.0 - p);
    let outside = |t: f64| beta_reg(df / 2.0, 0.5, df / (df + t * t));
    let (mut low, mut high) = (0.0, 1.0);
    while outside(high) > two_tails && high < f64::MAX / 4.0 {
        low = high;
        high *= 2.0;
    }
    loop {
        let middle = f64::midpoint(low, high);
        if middle <= low || middle >= high {
            return middle;
        }
        if outside(middle) > two_tails {
            low = middle;
        } else {
            high = middle;
        }
    }
}

#[cfg(test)]
mod tests {
    use statrs::function::gamma::ln_gamma;

    use super::*;

    fn close(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() <= tolerance, "{a} is not within {tolerance} of {b}");
    }

    #[test]
    fn mean_and_sample_sd_match_hand_numbers() {
        assert_eq!(mean(&[]), None);
        assert_eq!(sample_sd(&[3.0]), None);
        close(mean(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).unwrap(), 5.0, 1e-15);
        close(
            sample_sd(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).unwrap(),
            (32.0_f64 / 7.0).sqrt(),
            1e-15,
        );
    }

    #[test]
    fn t_quantiles_match_closed_forms_and_tables() {
        // df 1 is the Cauchy distribution, df 2 has an algebraic quantile, and df 4 has one by
        // Shaw's formula.
        close(student_t_quantile(0.975, 1.0), (0.475 * std::f64::consts::PI).tan(), 1e-9);
        close(student_t_quantile(0.975, 2.0), 0.95 / (2.0_f64 * 0.975 * 0.025).sqrt(), 1e-9);
        let alpha = (4.0_f64 * 0.975 * 0.025).sqrt();
        let q = ((alpha.acos() / 3.0).cos() / alpha).mul_add(4.0, -4.0);
        close(student_t_quantile(0.975, 4.0), q.sqrt(), 1e-9);
        for (df, expected) in
            [(1, 12.7062), (2, 4.3027), (3, 3.1824), (9, 2.2622), (30, 2.0423), (120, 1.9799)]
        {
            close(student_t_quantile(0.975, f64::from(df)), expected, 5e-5);
        }
        // Expansion around the normal quantile: z + (z³ + z)/(4 df).
        close(student_t_quantile(0.975, 1e6), Z_975 + (Z_975.powi(3) + Z_975) / 4e6, 1e-8);
        close(student_t_quantile(0.025, 9.0), -student_t_quantile(0.975, 9.0), 1e-12);
        close(student_t_quantile(0.5, 7.0), 0.0, 1e-9);
        assert!(student_t_quantile(1.0, 3.0).is_nan() && student_t_quantile(0.9, 0.0).is_nan());
    }

    #[test]
    fn t_interval_matches_a_worked_example() {
        // n = 4, mean 2.5, sd √(5/3), t(0.975, 3) = 3.182446.
        let e = Estimate::t(&[1.0, 2.0, 3.0, 4.0]).unwrap();
        let half = 3.182_446_305 * (5.0_f64 / 3.0).sqrt() / 2.0;
        close(e.mean, 2.5, 1e-15);
        close(e.low, 2.5 - half, 1e-8);
        close(e.high, 2.5 + half, 1e-8);
        let constant = Estimate::t(&[7.0; 5]).unwrap();
        assert_eq!((constant.low, constant.high), (7.0, 7.0));
    }

    #[test]
    fn estimates_are_written_with_the_bounds_that_they_have() {
        let estimate = Estimate { mean: 88.06, low: 82.94, high: 91.9 };
        assert_eq!(
            (format!("{estimate}"), format!("{estimate:.2}")),
            ("88.1 [82.9, 91.9]".into(), "88.06 [82.94, 91.90]".into())
        );
        assert_eq!(Estimate::t(&[2.0]).unwrap().to_string(), "2.0");
    }

    #[test]
    fn intervals_of_nothing_and_of_one_value() {
        assert_eq!(Estimate::t(&[]), None);
        assert_eq!(Estimate::rate(&[]), None);
        assert_eq!(
            Estimate::t(&[2.0]),
            Some(Estimate { mean: 2.0, low: f64::NEG_INFINITY, high: f64::INFINITY })
        );
        let one = Estimate::rate(&[1.0]).unwrap();
        close(one.low, 1.0 / (1.0 + Z_975 * Z_975), 1e-12);
        assert_eq!((one.mean, one.high), (1.0, 1.0));
    }

    #[test]
    fn wilson_interval_matches_published_values() {
        // Newcombe (1998), table I: 81/263 -> 0.2553..0.3662; 15/148 -> 0.0624..0.1605; 0/20 ->
        // 0..0.1611; 1/29 -> 0.0061..0.1718.
        for (k, n, low, high) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ] {
            let values: Vec<f64> = (0..n).map(|i| if i < k { 1.0 } else { 0.0 }).collect();
            let e = Estimate::rate(&values).unwrap();
            close(e.low, low, 5e-5);
            close(e.high, high, 5e-5);
        }
    }

    #[test]
    fn garwood_intervals_match_published_values() {
        // Ulm (1990), "A simple method to calculate the confidence interval of a standardized
        // mortality ratio": exact limits of Poisson counts.
        for (events, low, high) in
            [(0, 0.0, 3.689), (1, 0.0253, 5.572), (5, 1.623, 11.668), (10, 4.795, 18.390)]
        {
            let [least, most] = garwood(events);
            close(least, low, 6e-4);
            close(most, high, 6e-4);
        }
        // By definition, at the upper bound the probability of at most this many events is 2.5 %,
        // and at the lower bound the probability of at least this many.
        let below = |mean: f64, events: u64| {
            let term = |k: u64| (k as f64 * mean.ln() - mean - ln_gamma(k as f64 + 1.0)).exp();
            (0..=events).map(term).sum::<f64>()
        };
        for events in [1, 3, 40, 700, 20_000] {
            let [least, most] = garwood(events);
            close(below(most, events), 0.025, 1e-7);
            close(1.0 - below(least, events - 1), 0.025, 1e-7);
        }
    }

    #[test]
    fn exposure_without_an_event_has_a_lower_bound_alone() {
        let none = Estimate::exposure_per_event(100.0, 0).unwrap();
        assert!(none.mean.is_nan() && none.high.is_infinite());
        close(none.low, 100.0 / 3.688_879, 1e-4);
        assert_eq!(none.to_string(), "> 27.1");
        assert_eq!(serde_json::to_value(none).unwrap()["mean"], serde_json::Value::Null);
        let some = Estimate::exposure_per_event(100.0, 10).unwrap();
        assert_eq!(some.to_string(), "10.0 [5.4, 20.9]");
        assert_eq!(Estimate::exposure_per_event(0.0, 0), None);
    }

    #[test]
    fn rate_bounds_hold_the_mean_and_stay_in_range() {
        for n in 1..40 {
            for k in 0..=n {
                let values: Vec<f64> = (0..n).map(|i| if i < k { 1.0 } else { 0.0 }).collect();
                let e = Estimate::rate(&values).unwrap();
                assert!(
                    0.0 <= e.low && e.low <= e.mean && e.mean <= e.high && e.high <= 1.0,
                    "{k}/{n}: {e:?}"
                );
            }
        }
    }

    #[test]
    fn rate_counts_episodes_not_agents() {
        // Two episodes with fraction 1/2 carry as much information as two yes/no episodes with the
        // same mean.
        assert_eq!(Estimate::rate(&[0.5, 0.5]), Estimate::rate(&[1.0, 0.0]));
    }

    #[test]
    fn json_keeps_the_three_numbers_and_the_missing_bounds() {
        let e = Estimate { mean: 0.5, low: 0.25, high: 0.75 };
        let text = serde_json::to_string(&e).unwrap();
        assert_eq!(text, r#"{"mean":0.5,"low":0.25,"high":0.75}"#);
        assert_eq!(serde_json::from_str::<Estimate>(&text).unwrap(), e);
        let open = Estimate::t(&[2.0]).unwrap();
        let text = serde_json::to_string(&open).unwrap();
        assert_eq!(text, r#"{"mean":2.0,"low":null,"high":null}"#);
        assert_eq!(serde_json::from_str::<Estimate>(&text).unwrap(), open);
    }
}
