//! The registry of metrics: what is measured in an evaluation, how tables and figures show it, and
//! how to read it.
//!
//! A metric is one line of the tables below. The line makes it a field of [`Metrics`], a key of the
//! JSON output of `iwol evaluate`, a row of its table, a part of learning curves and reports, and a
//! name that sweep files may use. Values are measured in [`EpisodeRecord`]s.

mod metric;
mod result;

use std::fmt::Write as _;

use serde::{Deserialize, Serialize};

use crate::env::{Audit, BackgroundMetrics, EpisodeRecord, Failures, FlowMetrics};
use crate::stats::Estimate;

use metric::{
    APART, BRAKING, COUNT, FINE, FINE_COUNT, Field as _, KILOMETRES, NUMBER, PERCENT, SECONDS,
    SPEED,
};
pub use metric::{Better, Metric, Scale, Shown};
pub use result::{DETERMINED, EvaluationResult, KmPerCrash, Knowledge, Probe};

/// Number of steps of the window over which the paper sums rewards.
pub const WINDOW: usize = 1000;

/// Share of agents that arrived: the metric by which policies are compared.
pub const SUCCESS: &Metric = &Metrics::REGISTERED[0];

/// Returns all metrics, in the order of tables.
pub fn all() -> impl Iterator<Item = &'static Metric> {
    Metrics::REGISTERED.iter().chain(FlowSummary::REGISTERED).chain(BackgroundSummary::REGISTERED)
}

/// Returns the metrics that an output shows, if results contain them.
pub fn shown(output: Shown) -> impl Iterator<Item = &'static Metric> {
    all().filter(move |metric| metric.shown <= output)
}

/// Declares a struct with a field per metric, the function that measures them, and their entries
/// in the registry. The function `part` returns the struct as a part of [`Metrics`].
macro_rules! metrics {
    (
        $(#[$meta:meta])*
        $name:ident, of: $data:ty, ids: $prefix:literal, part: $part:expr,
        metrics: { $(
            $id:ident: $type:ty = $measure:expr,
            $title:literal, $axis:literal, $scale:ident, $better:ident, $shown:ident,
            $explanation:literal;
        )* }
        more: { $($more:tt)* }
    ) => {
        $(#[$meta])*
        #[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
        #[serde(default)]
        pub struct $name {
            $(#[doc = $explanation] pub $id: $type,)*
            $($more)*
        }

        impl $name {
            /// Entries of the registry.
            const REGISTERED: &[Metric] = &[$(Metric {
                id: concat!($prefix, stringify!($id)),
                validation: concat!("validation/", $prefix, stringify!($id)),
                title: $title,
                axis: $axis,
                scale: $scale,
                better: Better::$better,
                shown: Shown::$shown,
                explanation: $explanation,
                field: |metrics| {
                    let part: fn(&Metrics) -> Option<&$name> = $part;
                    part(metrics)?.$id.estimate()
                },
            }),*];

            #[allow(clippy::needless_update)]
            fn measure(data: &$data) -> Self {
                $(let $id: fn(&$data) -> $type = $measure;)*
                Self { $($id: $id(data).possible(&$scale),)* ..Self::default() }
            }
        }
    };
}

metrics! {
    /// Means with 95 % intervals; the unit is the episode, or the window.
    Metrics, of: Episodes<'_>, ids: "", part: |metrics| Some(metrics),
    metrics: {
        success: Estimate = |e| e.rate(|r| r.success),
            "success", "agents that arrive (%)", PERCENT, Higher, Everywhere,
            "Share of agents that arrived.";
        safety: Estimate = |e| e.rate(|r| r.safety),
            "safety", "agents that do not crash (%)", PERCENT, Higher, Everywhere,
            "Share of agents that neither crashed nor went off-road.";
        crash: Estimate = |e| e.rate(|r| r.crash),
            "crash", "agents that crash (%)", PERCENT, Lower, InTables,
            "Share of agents that crashed.";
        out_of_road: Estimate = |e| e.rate(|r| r.out_of_road),
            "off-road", "agents off-road (%)", PERCENT, Lower, InEvaluations,
            "Share of agents that went off-road.";
        unfinished: Estimate = |e| e.rate(|r| r.unfinished),
            "unfinished", "agents that do not finish (%)", PERCENT, Lower, InEvaluations,
            "Share of agents that had neither arrived nor failed at the end of the episode.";
        delay: Option<Estimate> = |e| Estimate::t(&e.known(|r| r.delay)),
            "delay", "delay of an agent that arrives (s)", SECONDS, Lower, InTables,
            "Time that an agent that arrives takes longer than it would alone, at full throttle \
             from its departure time; for agents from spawn places, mean over an episode's agents.";
        reward: Estimate = |e| e.mean(|r| r.reward),
            "reward", "reward per agent and episode", NUMBER, Higher, InEvaluations,
            "Reward per agent and episode.";
        window_reward: Estimate = |e| Estimate::t(e.windows).unwrap_or_default(),
            "window reward (throughput)", "reward per agent in 1000 steps",
            NUMBER, Higher, Everywhere,
            "Throughput: reward per agent over 1000 steps, in which episodes follow each other \
             (the paper's \"Rewards\").";
        episode_length: Estimate = |e| e.mean(|r| f64::from(r.episode_length)),
            "episode length", "steps", COUNT, Neither, InEvaluations,
            "Length of an episode in steps.";
        efficiency: Estimate = |e| e.mean(|r| r.efficiency),
            "efficiency", "agents per step", FINE, Higher, InEvaluations,
            "(success − danger) · N / steps, in agents per step; danger is the share of agents \
             that crashed or went off-road.";
        sumo_collisions: Estimate = |e| e.mean(|r| f64::from(r.sumo_collisions)),
            "SUMO collisions", "colliding pairs", FINE_COUNT, Lower, InEvaluations,
            "Colliding pairs per episode in SUMO's report.";
        own_collisions: Estimate = |e| e.mean(|r| f64::from(r.own_collisions)),
            "collisions", "colliding pairs", FINE_COUNT, Lower, InEvaluations,
            "Colliding pairs per episode by our own box test.";
        message_bits: Option<Estimate> = |e| Estimate::t(e.message_bits),
            "bits sent", "bits per decision and vehicle", COUNT, Neither, InTables,
            "Bits that a vehicle sends per decision, for methods with messages: the width of a message \
             times `channel.bits`, and 32 for its scale where it is rounded; nothing while nobody is in range.";
        loitering: Estimate = |e| e.rate(|r| r.loitering),
            "loitering", "agents that loiter (%)", PERCENT, Lower, InTables,
            "Share of agents that loitered: slower than 3 m/s for more than 2 s in total, at \
             most 15 m from their finish and with nobody ahead.";
        red_lights: Option<Estimate> = |e| Estimate::t(&e.known(|r| r.red_lights)),
            "red light violations", "red signals passed per agent", FINE_COUNT, Lower, InFigures,
            "Red signals that an agent passes, in tasks with signals.";
        km_per_crash: Option<KmPerCrash> = |e| e.km_per_crash(),
            "km per crash", "km per crash", KILOMETRES, Higher, InEvaluations,
            "Distance that the agents drove per crash, over all episodes together, with the \
             exact interval of a Poisson count. Without a crash there is only a lower bound.";
    }
    more: {
        /// Where SUMO's report and our own box test differ, and why; sums over all episodes.
        pub audit: Audit,
        /// Why agents did not arrive; sums over all episodes.
        pub failures: Failures,
        /// Flow of the agents from route files; `None` in tasks without them.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub flow: Option<FlowSummary>,
        /// Effects on background traffic and pedestrians; `None` in tasks without them.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub others: Option<BackgroundSummary>,
        /// How well the policy's latent predicts its targets; empty for policies without a latent.
        pub reconstruction: Vec<Knowledge>,
    }
}

metrics! {
    /// Flow of the agents from route files; see [`FlowMetrics`] for the definitions.
    FlowSummary,
    of: Vec<FlowMetrics>, ids: "flow.", part: |metrics| metrics.flow.as_ref(),
    metrics: {
        throughput: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.arrived) / f.hours),
            "arrivals per hour", "agents that arrive per hour", NUMBER, Higher, InFigures,
            "Agents from route files that arrived, per hour.";
        departures: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.departed) / f.hours),
            "departures per hour", "agents that depart per hour", NUMBER, Higher, InEvaluations,
            "Agents from route files that departed, per hour.";
        delay: Option<Estimate> = |f| flow(f, |f| f.arrived > 0, |f| f.delay),
            "time loss", "time loss of an agent (s)", SECONDS, Lower, InFigures,
            "Time that an agent that arrives loses against driving alone at the speed limits \
             (SUMO's time loss).";
        waiting: Option<Estimate> = |f| flow(f, |f| f.departed > 0, |f| f.waiting),
            "departure delay", "wait for departure (s)", SECONDS, Lower, InEvaluations,
            "Time that an agent waits for its departure, because no slot or no room on the road \
             is free.";
        queued: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.queued)),
            "agents that still wait", "agents", NUMBER, Lower, InEvaluations,
            "Agents that still wait for their departure at the end of an episode.";
        on_road: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.on_road)),
            "agents on the road", "agents", NUMBER, Neither, InEvaluations,
            "Agents on the road at the end of an episode. They count as not arrived if they have \
             been there for more than four times the time of their route at the speed limits; otherwise \
             they do not count.";
        speed: Option<Estimate> = |f| flow(f, LASTED, |f| f.speed),
            "speed of all vehicles", "speed of all vehicles (m/s)", SPEED, Higher, InFigures,
            "Mean speed of all vehicles on the road, agents and others. A wreck has the speed 0.";
        standing: Option<Estimate> = |f| rate(f, LASTED, |f| f.standing),
            "vehicles that stand", "vehicles that stand (%)", PERCENT, Lower, InFigures,
            "Share of all vehicles on the road that are slower than 0.1 m/s, in the mean over all \
             steps.";
    }
    more: {}
}

const LASTED: fn(&FlowMetrics) -> bool = |f| f.hours > 0.0;

fn flow(
    all: &[FlowMetrics],
    chosen: fn(&FlowMetrics) -> bool,
    of: fn(&FlowMetrics) -> f64,
) -> Option<Estimate> {
    Estimate::t(&all.iter().filter(|f| chosen(f)).map(of).collect::<Vec<_>>())
}

metrics! {
    /// Effects of agents on background traffic and pedestrians; see [`BackgroundMetrics`] for the
    /// definitions. Shares and means are over the episodes that contain vehicles, or pedestrians;
    /// `None` without such episodes.
    BackgroundSummary,
    of: Vec<BackgroundMetrics>, ids: "others.", part: |metrics| metrics.others.as_ref(),
    metrics: {
        vehicles: Estimate = |o| mean(o, |_| true, |o| f64::from(o.vehicles)).unwrap_or_default(),
            "background vehicles", "background vehicles", COUNT, Neither, InEvaluations,
            "Number of background vehicles in an episode.";
        crash: Option<Estimate> = |o| rate(o, DRIVEN, |o| o.crash),
            "background crash", "background vehicles that crash (%)", PERCENT, Lower, InFigures,
            "Share of the background vehicles that collided with an agent or a wreck.";
        delay: Option<Estimate> = |o| mean(o, DRIVEN, |o| o.delay),
            "background delay", "time loss of background vehicles (s)", SECONDS, Lower, InFigures,
            "SUMO's time loss of a background vehicle.";
        braking: Option<Estimate> = |o| mean(o, DRIVEN, |o| o.braking),
            "background braking", "hardest braking (m/s²)", BRAKING, Lower, InEvaluations,
            "Hardest braking of a background vehicle.";
        hard_braking: Option<Estimate> = |o| rate(o, DRIVEN, |o| o.hard_braking),
            "background hard braking", "background vehicles that brake hard (%)",
            PERCENT, Lower, InFigures,
            "Share of the background vehicles that had to brake harder than 6 m/s².";
        close: Option<Estimate> = |o| rate(o, DRIVEN, |o| o.close),
            "background TTC < 1.5 s", "background vehicles (%)", PERCENT, Lower, InEvaluations,
            "Share of the background vehicles with a time to collision with an agent below 1.5 \
             s, or with a collision.";
        pedestrians: Estimate = |o| mean(o, |_| true, |o| f64::from(o.pedestrians)).unwrap_or_default(),
            "pedestrians", "pedestrians", COUNT, Neither, InEvaluations,
            "Number of pedestrians in an episode.";
        pedestrian_crash: Option<Estimate> = |o| rate(o, WALKED, |o| o.pedestrian_crash),
            "pedestrians hit", "pedestrians (%)", PERCENT, Lower, InFigures,
            "Share of the pedestrians that were hit by an agent or a wreck.";
        pedestrian_close: Option<Estimate> = |o| rate(o, WALKED, |o| o.pedestrian_close),
            "pedestrian TTC < 1.5 s", "pedestrians (%)", PERCENT, Lower, InEvaluations,
            "Share of the pedestrians with a time to collision with an agent below 1.5 s, or \
             that were hit.";
        ttc: Option<Estimate> = |o| mean(o, EITHER, |o| o.ttc),
            "smallest TTC", "time to collision (s)", APART, Higher, InEvaluations,
            "Smallest time to collision of an episode, at most 5 s.";
        pet: Option<Estimate> = |o| mean(o, EITHER, |o| o.pet),
            "smallest PET", "post-encroachment time (s)", APART, Higher, InFigures,
            "Smallest post-encroachment time of an episode, at most 5 s.";
    }
    more: {}
}

/// The episodes and windows of an evaluation.
struct Episodes<'a> {
    records: &'a [EpisodeRecord],
    windows: &'a [f64],
    message_bits: &'a [f64],
}

impl Episodes<'_> {
    fn rate(&self, of: fn(&EpisodeRecord) -> f64) -> Estimate {
        rate(self.records, |_| true, of).unwrap_or_default()
    }

    fn mean(&self, of: fn(&EpisodeRecord) -> f64) -> Estimate {
        mean(self.records, |_| true, of).unwrap_or_default()
    }

    /// Returns a measurement of the episodes that have it.
    fn known(&self, of: fn(&EpisodeRecord) -> Option<f64>) -> Vec<f64> {
        self.records.iter().filter_map(of).collect()
    }

    fn km_per_crash(&self) -> Option<KmPerCrash> {
        KmPerCrash::new(
            self.records.iter().map(|r| r.distance_km).sum(),
            self.records.iter().map(|r| u64::from(r.crashes)).sum(),
        )
    }
}

type Chosen = fn(&BackgroundMetrics) -> bool;
const DRIVEN: Chosen = |o| o.vehicles > 0;
const WALKED: Chosen = |o| o.pedestrians > 0;
const EITHER: Chosen = |o| o.vehicles + o.pedestrians > 0;

fn column<R>(all: &[R], chosen: fn(&R) -> bool, of: fn(&R) -> f64) -> Vec<f64> {
    all.iter().filter(|row| chosen(row)).map(of).collect()
}

fn rate<R>(all: &[R], chosen: fn(&R) -> bool, of: fn(&R) -> f64) -> Option<Estimate> {
    Estimate::rate(&column(all, chosen, of))
}

fn mean<R>(all: &[R], chosen: fn(&R) -> bool, of: fn(&R) -> f64) -> Option<Estimate> {
    Estimate::t(&column(all, chosen, of))
}

impl Metrics {
    /// Summarises episodes and windows; `None` without an episode or a window.
    pub fn of(
        records: &[EpisodeRecord],
        windows: &[f64],
        reconstruction: &[Knowledge],
        message_bits: &[f64],
    ) -> Option<Self> {
        if records.is_empty() || windows.is_empty() {
            return None;
        }
        let flows: Vec<FlowMetrics> = records.iter().filter_map(|r| r.flow).collect();
        let background: Vec<BackgroundMetrics> = records.iter().filter_map(|r| r.others).collect();
        Some(Self {
            audit: records.iter().fold(Audit::default(), |sum, r| sum.plus(&r.audit)),
            failures: records.iter().fold(Failures::default(), |sum, r| sum.plus(&r.failures)),
            flow: (!flows.is_empty()).then(|| FlowSummary::measure(&flows)),
            others: (!background.is_empty()).then(|| BackgroundSummary::measure(&background)),
            reconstruction: reconstruction.to_vec(),
            ..Self::measure(&Episodes { records, windows, message_bits })
        })
    }
}

/// Returns the reference of all metrics as Markdown: `docs/reference/metrics.md`.
pub fn reference() -> String {
    let mut text = String::from(
        "# Metrics\n\nWhat `iwol evaluate` measures, each as a mean with its 95 % interval. The key is that of the \
         JSON output, in which shares go from 0 to 1. Learning curves and all reports show the metrics that are \
         shown everywhere; reports show the metrics of reports if results contain them.\n\n\
         | metric | key | better | shown | meaning |\n|---|---|---|---|---|\n",
    );
    for metric in all() {
        let better = match metric.better {
            Better::Higher => "higher",
            Better::Lower => "lower",
            Better::Neither => "–",
        };
        let shown = match metric.shown {
            Shown::Everywhere => "everywhere",
            Shown::InFigures => "tables and figures of reports",
            Shown::InTables => "tables of reports",
            Shown::InEvaluations => "evaluations",
        };
        let (heading, id) = (metric.heading(), metric.id);
        let meaning = metric.explanation;
        let _ = writeln!(text, "| {heading} | `{id}` | {better} | {shown} | {meaning} |");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::env::MAX_TIME_APART;

    #[test]
    fn every_metric_has_its_own_key_and_the_key_finds_it_in_json() {
        let known = Estimate { mean: 0.25, low: 0.0, high: 0.5 };
        for metric in all() {
            assert_eq!(all().filter(|other| other.id == metric.id).count(), 1, "{}", metric.id);
            assert_eq!(metric.estimate(&Metrics::default()), None, "{}", metric.id);
            let value = serde_json::json!({ "mean": 0.25, "low": 0.0, "high": 0.5, "km": 1.0, "crashes": 4 });
            let json = match metric.id.split_once('.') {
                None => serde_json::json!({ metric.id: value }),
                Some((part, key)) => serde_json::json!({ part: { key: value } }),
            };
            let metrics: Metrics = serde_json::from_value(json).unwrap();
            let shown = metric.estimate(&metrics).expect("it is there");
            assert_eq!(shown.mean, metric.scale.factor * known.mean, "{}", metric.id);
        }
        assert_eq!(SUCCESS.id, "success");
    }

    #[test]
    fn intervals_contain_only_possible_numbers() {
        let effects = |delay: f64, ttc: f64| BackgroundMetrics {
            vehicles: 1,
            delay,
            ttc,
            ..BackgroundMetrics::default()
        };
        let records: Vec<EpisodeRecord> = [effects(0.0, 5.0), effects(0.5, 5.0), effects(0.0, 4.0)]
            .map(|others| EpisodeRecord { others: Some(others), ..EpisodeRecord::default() })
            .into();
        let metrics = Metrics::of(&records, &[-1.0, 2.0], &[], &[]).unwrap();
        let others = metrics.others.as_ref().unwrap();
        let (delay, ttc) = (others.delay.unwrap(), others.ttc.unwrap());
        assert!(delay.low == 0.0 && delay.high > 0.5, "{delay:?}");
        assert!(ttc.low > 0.0 && ttc.high == MAX_TIME_APART, "{ttc:?}");
        assert!(metrics.window_reward.low < -1.0, "rewards have any sign");
        // In the shown unit, as reports compute it over seeds.
        let shown = Estimate { mean: 99.0, low: 95.0, high: 103.0 };
        assert_eq!(SUCCESS.possible(shown).high, 100.0);
        let unknown = Estimate { mean: 1.0, low: f64::NEG_INFINITY, high: f64::INFINITY };
        assert_eq!(SUCCESS.possible(unknown), unknown);
    }

    #[test]
    fn metrics_survive_their_json() {
        let success = Estimate { mean: 0.5, low: 0.25, high: 0.75 };
        let metrics = Metrics { success, ..Metrics::default() };
        let again: Metrics =
            serde_json::from_str(&serde_json::to_string(&metrics).unwrap()).unwrap();
        assert_eq!(again.success, metrics.success);
        assert!(again.crash.mean.is_nan(), "null is no number");
    }

    /// `IWOL_UPDATE=1 cargo test metrics_reference` writes the page again.
    #[test]
    fn the_metrics_reference_is_up_to_date() {
        let path =
            std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/metrics.md");
        if std::env::var_os("IWOL_UPDATE").is_some() {
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(&path, reference()).unwrap();
        }
        let page = std::fs::read_to_string(&path).unwrap_or_default();
        assert!(page == reference(), "out of date: run it again with IWOL_UPDATE=1");
    }
}
