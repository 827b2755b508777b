//! The registry of metrics: what is measured in an evaluation, how tables and figures show it, and
//! how to read it.
//!
//! A metric is one line of the tables below. The line makes it a field of [`Metrics`], a key of the
//! JSON output of `iwol evaluate`, a row of its table, a part of learning curves and reports, and a
//! name that sweep files may use. Values are measured in [`EpisodeRecord`]s.

mod metric;
mod own;
mod reference;
mod result;

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, Serialize};

use crate::env::{
    Audit, BackgroundMetrics, DrivingRecord, EpisodeRecord, Failures, FlowMetrics, OwnMetric,
};
use crate::stats::Estimate;

use metric::{
    APART, BRAKING, COUNT, FINE, FINE_COUNT, Field as _, KILOMETRES, NUMBER, PERCENT, SECONDS,
    SPEED, Source, TIME_LOSS,
};
pub use metric::{Better, Metric, Scale, Shown};
pub use own::{OwnEstimate, of_environments, own};
pub use reference::reference;
pub use result::{DETERMINED, EvaluationResult, KmPerCrash, Knowledge, Probe};

/// Number of steps of the window over which the paper sums rewards.
pub const WINDOW: usize = 1000;

/// Number of metrics of vehicles that say how their trips ended. They come first.
const OUTCOMES: usize = 5;

/// Share of agents that reached their goal: the metric by which policies are compared.
pub const SUCCESS: &Metric = &Metrics::REGISTERED[0];

/// Returns all metrics, in the order of tables.
pub fn all() -> impl Iterator<Item = &'static Metric> {
    let (success, rewards) = Metrics::REGISTERED.split_at(1);
    let (outcomes, details) = DrivingMetrics::REGISTERED.split_at(OUTCOMES);
    (success.iter())
        .chain(outcomes)
        .chain(rewards)
        .chain(details)
        .chain(FlowSummary::REGISTERED)
        .chain(BackgroundSummary::REGISTERED)
}

/// Returns the metric with this key, of all metrics and of those that named environments
/// define by themselves.
pub fn named(id: &str) -> Option<&'static Metric> {
    all().chain(of_environments()).find(|metric| metric.id == id)
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
                source: Source::Field(|metrics| {
                    let part: fn(&Metrics) -> Option<&$name> = $part;
                    part(metrics)?.$id.estimate()
                }),
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
        success: Estimate = |e| e.success(),
            "success", "success (%)", PERCENT, Higher, Everywhere,
            "Share of agents that reached their goal; of vehicles, of those that arrived.";
        reward: Estimate = |e| e.reward(),
            "reward", "reward per agent and episode", NUMBER, Higher, InTables,
            "Reward per agent, mean over the episodes in which an agent was on the road.";
        window_reward: Estimate = |e| Estimate::t(e.windows).unwrap_or_default(),
            "window reward (throughput)", "reward per agent in 1000 steps",
            NUMBER, Higher, Everywhere,
            "Throughput: reward per agent over 1000 steps, in which episodes follow each other \
             (the paper's \"Rewards\"). Where agents come from route files: per slot, so that it \
             compares runs with as many slots (`--agents`) only.";
        episode_length: Estimate = |e| e.mean(|r| f64::from(r.episode_length)),
            "episode length", "steps", COUNT, Neither, InEvaluations,
            "Length of an episode in steps.";
        message_bits: Option<Estimate> = |e| Estimate::t(e.message_bits),
            "bits sent", "bits per decision and agent", COUNT, Neither, InTables,
            "Bits that an agent sends per decision, for methods with messages: the width of a message \
             times `channel.bits`, and 32 for its scale where it is rounded; nothing while nobody is in range.";
    }
    more: {
        /// Metrics of vehicles; `None` in environments without them.
        #[serde(flatten, skip_serializing_if = "Option::is_none", deserialize_with = "of_vehicles")]
        pub driving: Option<DrivingMetrics>,
        /// Number of episodes in which an agent arrived, failed or was unfinished, if there are others.
        /// Shares of agents are over these episodes.
        #[serde(skip_serializing_if = "Option::is_none")]
        pub counted: Option<u64>,
        /// Metrics that the environment defines by itself, by name.
        #[serde(skip_serializing_if = "BTreeMap::is_empty")]
        pub own: BTreeMap<String, OwnEstimate>,
        /// How well the policy's latent predicts its targets; empty for policies without a latent.
        pub reconstruction: Vec<Knowledge>,
    }
}

metrics! {
    /// Metrics of vehicles; see [`DrivingRecord`] for the definitions.
    DrivingMetrics, of: DrivingRecords<'_>, ids: "", part: |metrics| metrics.driving.as_ref(),
    metrics: {
        safety: Estimate = |d| d.rate(|r| r.safety),
            "safety", "agents that do not crash (%)", PERCENT, Higher, Everywhere,
            "Share of agents that neither crashed nor went off-road.";
        crash: Estimate = |d| d.rate(|r| r.crash),
            "crash", "agents that crash (%)", PERCENT, Lower, InTables,
            "Share of agents that crashed.";
        out_of_road: Estimate = |d| d.rate(|r| r.out_of_road),
            "off-road", "agents off-road (%)", PERCENT, Lower, InEvaluations,
            "Share of agents that went off-road.";
        unfinished: Estimate = |d| d.rate(|r| r.unfinished),
            "unfinished", "agents that do not finish (%)", PERCENT, Lower, InEvaluations,
            "Share of agents that had neither arrived nor failed at the end of the episode. Agents \
             from route files count only once they have been on the road for more than four times \
             the time of their route at the speed limits.";
        delay: Option<Estimate> = |d| Estimate::t(&d.known(|r| r.delay)),
            "delay", "delay of an agent that arrives (s)", SECONDS, Lower, InTables,
            "Time that an agent that arrives takes longer than it would alone, at full throttle \
             from its departure time; for agents from spawn places, mean over an episode's agents.";
        efficiency: Estimate = |d| Estimate::t(&d.decided(|r| r.efficiency)).unwrap_or_default(),
            "efficiency", "agents per step", FINE, Higher, InEvaluations,
            "(success − danger) · N / steps, in agents per step; danger is the share of agents \
             that crashed or went off-road.";
        sumo_collisions: Estimate = |d| d.mean(|r| f64::from(r.sumo_collisions)),
            "SUMO collisions", "colliding pairs", FINE_COUNT, Lower, InEvaluations,
            "Colliding pairs per episode in SUMO's report.";
        own_collisions: Estimate = |d| d.mean(|r| f64::from(r.own_collisions)),
            "collisions", "colliding pairs", FINE_COUNT, Lower, InEvaluations,
            "Colliding pairs per episode by our own box test.";
        loitering: Estimate = |d| d.rate(|r| r.loitering),
            "loitering", "agents that loiter (%)", PERCENT, Lower, InTables,
            "Share of agents that loitered: slower than 3 m/s for more than 2 s in total, at \
             most 15 m from their finish and with nobody ahead.";
        red_lights: Option<Estimate> = |d| Estimate::t(&d.known(|r| r.red_lights.filter(|_| !r.undecided))),
            "red light violations", "red signals passed per agent", FINE_COUNT, Lower, InFigures,
            "Red signals that an agent passes, in tasks with signals.";
        km_per_crash: Option<KmPerCrash> = |d| d.km_per_crash(),
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
    }
}

metrics! {
    /// Flow of the agents from route files; see [`FlowMetrics`] for the definitions.
    FlowSummary,
    of: Vec<FlowMetrics>, ids: "flow.", part: |metrics| metrics.driving.as_ref()?.flow.as_ref(),
    metrics: {
        throughput: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.arrived) / f.hours),
            "arrivals per hour", "agents that arrive per hour", COUNT, Higher, InFigures,
            "Agents from route files that arrived, per hour.";
        departures: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.departed) / f.hours),
            "departures per hour", "agents that depart per hour", COUNT, Higher, InEvaluations,
            "Agents from route files that departed, per hour.";
        delay: Option<Estimate> = |f| flow(f, |f| f.arrived > 0, |f| f.delay),
            "time loss", "time loss of an agent (s)", TIME_LOSS, Lower, InFigures,
            "Time that an agent that arrives loses against driving alone at the speed limits \
             (SUMO's time loss).";
        waiting: Option<Estimate> = |f| flow(f, |f| f.departed > 0, |f| f.waiting),
            "departure delay", "wait for departure (s)", SECONDS, Lower, InEvaluations,
            "Time that an agent waits for its departure, because no slot or no room on the road \
             is free.";
        queued: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.queued)),
            "agents that still wait", "agents", COUNT, Lower, InEvaluations,
            "Agents that still wait for their departure at the end of an episode.";
        on_road: Option<Estimate> = |f| flow(f, LASTED, |f| f64::from(f.on_road)),
            "agents on the road", "agents", COUNT, Neither, InEvaluations,
            "Agents on the road at the end of an episode. They count as not arrived if they came \
             longer before it than four times the time of their route at the speed limits; agents that \
             came later do not count, whatever became of them.";
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
    of: Vec<BackgroundMetrics>, ids: "others.", part: |metrics| metrics.driving.as_ref()?.others.as_ref(),
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
        ttc: Option<Estimate> = |o| known(o, |o| o.ttc),
            "smallest TTC", "time to collision (s)", APART, Higher, InEvaluations,
            "Smallest time to collision of an episode, at most 5 s.";
        pet: Option<Estimate> = |o| known(o, |o| o.pet),
            "smallest PET", "post-encroachment time (s)", APART, Higher, InFigures,
            "Smallest post-encroachment time of an episode, at most 5 s.";
    }
    more: {}
}

/// The vehicles' part of the episodes of an evaluation.
struct DrivingRecords<'a>(Vec<&'a DrivingRecord>);

impl DrivingRecords<'_> {
    /// Returns the estimate of a share of agents, from the episodes in which agents count.
    fn rate(&self, of: fn(&DrivingRecord) -> f64) -> Estimate {
        Estimate::rate(&self.decided(of)).unwrap_or_default()
    }

    fn mean(&self, of: fn(&DrivingRecord) -> f64) -> Estimate {
        let all: Vec<f64> = self.0.iter().map(|record| of(record)).collect();
        Estimate::t(&all).unwrap_or_default()
    }

    /// Returns a measurement of the episodes in which agents count.
    fn decided(&self, of: fn(&DrivingRecord) -> f64) -> Vec<f64> {
        self.0.iter().filter(|record| !record.undecided).map(|record| of(record)).collect()
    }

    /// Returns a measurement of the episodes that have it.
    fn known(&self, of: fn(&DrivingRecord) -> Option<f64>) -> Vec<f64> {
        self.0.iter().filter_map(|record| of(record)).collect()
    }

    fn km_per_crash(&self) -> Option<KmPerCrash> {
        KmPerCrash::new(
            self.0.iter().map(|r| r.distance_km).sum(),
            self.0.iter().map(|r| u64::from(r.crashes)).sum(),
        )
    }
}

/// The episodes and windows of an evaluation.
struct Episodes<'a> {
    records: &'a [EpisodeRecord],
    windows: &'a [f64],
    message_bits: &'a [f64],
}

impl Episodes<'_> {
    fn success(&self) -> Estimate {
        let known: Vec<f64> = self.records.iter().filter_map(EpisodeRecord::success).collect();
        Estimate::rate(&known).unwrap_or_default()
    }

    fn reward(&self) -> Estimate {
        let somebody = |r: &EpisodeRecord| {
            let flow = r.driving.as_ref().and_then(|driving| driving.flow);
            flow.is_none_or(|flow| flow.departed > 0)
        };
        mean(self.records, somebody, |r| r.reward).unwrap_or_default()
    }

    fn mean(&self, of: fn(&EpisodeRecord) -> f64) -> Estimate {
        mean(self.records, |_| true, of).unwrap_or_default()
    }
}

type Chosen = fn(&BackgroundMetrics) -> bool;
const DRIVEN: Chosen = |o| o.vehicles > 0;
const WALKED: Chosen = |o| o.pedestrians > 0;

/// Returns the mean over the episodes with agents and others on the road.
fn known(all: &[BackgroundMetrics], of: fn(&BackgroundMetrics) -> Option<f64>) -> Option<Estimate> {
    let met = |o: &&BackgroundMetrics| o.vehicles + o.pedestrians > 0;
    Estimate::t(&all.iter().filter(met).filter_map(of).collect::<Vec<_>>())
}

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
    /// Summarises episodes and windows; `None` without an episode or a window. `own`: the metrics
    /// that the environment defines by itself.
    pub fn of(
        own: &[OwnMetric],
        records: &[EpisodeRecord],
        windows: &[f64],
        reconstruction: &[Knowledge],
        message_bits: &[f64],
    ) -> Option<Self> {
        if records.is_empty() || windows.is_empty() {
            return None;
        }
        let counted = records.iter().filter(|record| record.success().is_some()).count();
        let drives: Vec<&DrivingRecord> =
            records.iter().filter_map(|record| record.driving.as_ref()).collect();
        Some(Self {
            counted: (counted < records.len()).then_some(counted as u64),
            driving: (!drives.is_empty()).then(|| DrivingMetrics::of(drives)),
            own: own::summary(own, records),
            reconstruction: reconstruction.to_vec(),
            ..Self::measure(&Episodes { records, windows, message_bits })
        })
    }

    /// Returns the metrics of vehicles.
    ///
    /// # Panics
    /// In environments without vehicles.
    pub fn driving(&self) -> &DrivingMetrics {
        self.driving.as_ref().expect("an evaluation of vehicles")
    }
}

/// Reads the metrics of vehicles; `None` where there are none.
fn of_vehicles<'de, D: Deserializer<'de>>(data: D) -> Result<Option<DrivingMetrics>, D::Error> {
    let metrics = DrivingMetrics::deserialize(data)?;
    let part = metrics.flow.is_some() || metrics.others.is_some();
    let known = part
        || DrivingMetrics::REGISTERED.iter().any(|metric| {
            let all = Metrics { driving: Some(metrics.clone()), ..Metrics::default() };
            metric.unscaled(&all).is_some()
        });
    Ok(known.then_some(metrics))
}

impl DrivingMetrics {
    fn of(drives: Vec<&DrivingRecord>) -> Self {
        let flows: Vec<FlowMetrics> = drives.iter().filter_map(|r| r.flow).collect();
        let background: Vec<BackgroundMetrics> = drives.iter().filter_map(|r| r.others).collect();
        Self {
            audit: drives.iter().fold(Audit::default(), |sum, r| sum.plus(&r.audit)),
            failures: drives.iter().fold(Failures::default(), |sum, r| sum.plus(&r.failures)),
            flow: (!flows.is_empty()).then(|| FlowSummary::measure(&flows)),
            others: (!background.is_empty()).then(|| BackgroundSummary::measure(&background)),
            ..Self::measure(&DrivingRecords(drives))
        }
    }
}

#[cfg(test)]
mod tests;
