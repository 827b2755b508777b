//! Comparisons that a sweep file names before its runs.

use serde::Deserialize;
use toml::{Table, Value};

use super::conditions::{holds, listed};
use super::{Cell, Evaluate};
use crate::metrics::{self, Metric, Shown};

/// A comparison of trained runs: by how much the metric of those of `plus` exceeds that of those of
/// `minus`. With two conditions each, by how much the first difference exceeds the second. The report corrects the
/// p-values of all comparisons of a sweep together (Holm).
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contrast {
    /// What is compared, in the report.
    pub title: String,
    /// Metric, as in the JSON of `iwol evaluate`.
    pub metric: String,
    /// Conditions on the cells whose interquartile means count with weight 1.
    pub plus: Vec<Table>,
    /// Conditions on the cells whose interquartile means count with weight -1.
    pub minus: Vec<Table>,
    /// What is compared: the metric of the trained policies, or its mean over the training.
    #[serde(default)]
    pub of: Compared,
    /// Largest difference that counts as none, in the unit of the metric's column in reports, such
    /// as percentage points: the report says whether the difference is within it.
    #[serde(default)]
    pub margin: Option<f64>,
    /// Name of the evaluation that is compared [default: the first].
    #[serde(default)]
    pub evaluate: Option<String>,
    /// Values of that evaluation's grid.
    #[serde(default)]
    pub at: Table,
}

/// What a comparison is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Compared {
    /// An evaluation of the trained policies.
    #[default]
    Evaluation,
    /// The area under the curve of the validations in training, as a mean over environment steps:
    /// a run that learns sooner has a larger area.
    Training,
}

impl Contrast {
    /// Returns the metric.
    pub fn metric(&self) -> Option<&'static Metric> {
        metrics::named(&self.metric)
    }

    /// Returns the evaluation that is compared.
    pub fn evaluation<'a>(&self, all: &'a [Evaluate]) -> Option<&'a Evaluate> {
        match &self.evaluate {
            None => all.first(),
            Some(name) => all.iter().find(|evaluate| evaluate.name == *name),
        }
    }

    /// Returns the one combination of the evaluation's grid that is compared.
    pub fn combination(&self, evaluate: &Evaluate) -> Option<Vec<(String, Value)>> {
        let fits = |combination: &Vec<(String, Value)>| {
            holds(&self.at, |key| super::value_of(combination, key))
        };
        let mut all = evaluate.combinations().into_iter().filter(fits);
        let only = all.next();
        only.filter(|_| all.next().is_none())
    }

    /// Returns the conditions with their weights.
    pub fn groups(&self) -> impl Iterator<Item = (f64, &Table)> {
        let (plus, minus) = (self.plus.iter(), self.minus.iter());
        plus.map(|when| (1.0, when)).chain(minus.map(|when| (-1.0, when)))
    }

    /// Checks everything that does not depend on the cells.
    pub(super) fn check(&self, evaluations: &[Evaluate]) -> Result<(), String> {
        let at = format!("[[contrast]] `{}`", self.title);
        if self.metric().is_none() {
            let all = metrics::all().chain(metrics::of_environments());
            let known: Vec<&str> = all.map(|metric| metric.id).collect();
            return Err(format!("{at}: metric must be one of {}", known.join(", ")));
        }
        if self.metric == "km_per_crash" {
            return Err(format!(
                "{at}: a run without a crash has no number for km_per_crash; compare `crash`"
            ));
        }
        if self.margin.is_some_and(|margin| !(margin > 0.0 && margin.is_finite())) {
            return Err(format!("{at}: margin must be above 0"));
        }
        if self.of == Compared::Training && (self.evaluate.is_some() || !self.at.is_empty()) {
            return Err(format!(
                "{at}: with `of = \"training\"`, the curves of validations are compared: omit `evaluate` and `at`"
            ));
        }
        if self.of == Compared::Training
            && self.metric().is_none_or(|m| m.shown != Shown::Everywhere && !m.is_own())
        {
            let all = metrics::shown(Shown::Everywhere).chain(metrics::of_environments());
            let known: Vec<&str> = all.map(|m| m.id).collect();
            return Err(format!(
                "{at}: the metric of validations must be one of {}",
                known.join(", ")
            ));
        }
        if self.plus.is_empty() || self.plus.len() != self.minus.len() {
            return Err(format!("{at}: give as many conditions in `minus` as in `plus`"));
        }
        let Some(evaluate) = self.evaluation(evaluations) else {
            return Err(format!("{at}: evaluate must be the name of an [[evaluate]]"));
        };
        if self.of == Compared::Evaluation && self.combination(evaluate).is_none() {
            return Err(format!(
                "{at}: at must select one combination of the grid of [[evaluate]] `{}`",
                evaluate.name
            ));
        }
        Ok(())
    }

    /// Checks that every condition selects cells that are evaluated, and that they differ in their
    /// seed only.
    pub(super) fn check_cells(
        &self,
        cells: &[Cell],
        evaluations: &[Evaluate],
    ) -> Result<(), String> {
        let evaluate = self.evaluation(evaluations);
        let ids = |when| self.cells(cells, when, evaluate).map(|cell| &cell.id).collect::<Vec<_>>();
        if let Some((plus, _)) =
            self.plus.iter().zip(&self.minus).find(|(plus, minus)| ids(plus) == ids(minus))
        {
            return Err(format!(
                "[[contrast]] `{}`: plus and minus both select the cells with {}; choose two groups",
                self.title,
                listed(plus)
            ));
        }
        let groups: Vec<&Table> = self.groups().map(|(_, when)| when).collect();
        for (i, when) in groups.iter().enumerate() {
            let shared = groups[..i].iter().flat_map(|other| ids(other));
            if let Some(id) = shared.into_iter().find(|id| ids(when).contains(id)) {
                return Err(format!(
                    "[[contrast]] `{}`: cell {id} is in two of its groups, which must be of different runs",
                    self.title
                ));
            }
            let chosen: Vec<&Cell> = self.cells(cells, when, evaluate).collect();
            if let [only] = chosen[..] {
                return Err(format!(
                    "[[contrast]] `{}`: only cell {} has {}; a group needs two runs or more",
                    self.title,
                    only.id,
                    listed(when)
                ));
            }
            let Some(first) = chosen.first() else {
                let title = &self.title;
                return Err(format!(
                    "[[contrast]] `{title}`: no cell that is evaluated has {}",
                    listed(when)
                ));
            };
            let rest = |cell: &Cell| {
                cell.values.iter().filter(|(key, _)| key != "seed").cloned().collect::<Vec<_>>()
            };
            if let Some(other) = chosen.iter().find(|cell| rest(cell) != rest(first)) {
                return Err(format!(
                    "[[contrast]] `{}`: cells {} and {} both have {}; give more conditions, so that a group differs in its seeds only",
                    self.title,
                    first.id,
                    other.id,
                    listed(when)
                ));
            }
        }
        Ok(())
    }

    /// Returns the cells of a condition that are evaluated.
    pub fn cells<'a>(
        &self,
        cells: &'a [Cell],
        when: &'a Table,
        evaluate: Option<&'a Evaluate>,
    ) -> impl Iterator<Item = &'a Cell> {
        let chosen = cells.iter().filter(move |cell| holds(when, |key| cell.value(key)));
        chosen.filter(move |cell| evaluate.is_some_and(|evaluate| evaluate.applies(cell)))
    }
}
