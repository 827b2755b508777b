//! The best trade-off between crashes and delay on the lane for two directions
//! (`scenarios/one_lane.xml`), of policies that see nobody until it is too late, and of policies
//! that know who comes.
//!
//! Two arms, a lane that takes `TRANSIT` seconds. On each arm, a vehicle comes with probability
//! `presence`, at a time that is uniform over a window. Two vehicles that enter from opposite ends
//! within the transit time crash.
//!
//! **Local policies.** Until another vehicle is in sight, what a vehicle does cannot depend on
//! whether one comes. So a policy is a planned entry time for each arrival time, whatever the policy
//! remembers, and a vehicle enters earlier only if it sees the other come out. A policy may know the
//! time (the simulated ones do not) and treat the two arms differently. The program searches for the
//! plans with the least cost, delay plus `λ` times crashes, by alternating exact best responses from
//! many starts. The curve is the best that it finds, not a certificate of the optimum.
//!
//! **Full information.** Of two vehicles that would meet, the second waits outside until the first
//! has come out.
//!
//! Entries are ideal: braking and starting again cost nothing, so that a simulated policy is slower
//! than these bounds. `cargo run --release --no-default-features --example tradeoff` prints the
//! curves as CSV. With the name of a picture (`.svg` or `.png`), it also draws the curves of the
//! window of 7 s and evaluated policies. A policy is a label with a result of `iwol evaluate --json`,
//! or with a row of a sweep, whose seeds are a point each:
//!
//! ```text
//! iwol evaluate runs/a --scenario scenarios/one_lane.xml --json --out a.json
//! cargo run --release --no-default-features --example tradeoff -- tradeoff.svg mine=a.json MAPPO=runs/one_lane/mappo_…
//! ```

use std::error::Error;
use std::path::{Path, PathBuf};

use rand::RngExt as _;
use serde_json::Value;

use iwol_sumo::plot::{Panel, Series, Style, figure};
use iwol_sumo::rng::{self, Rng, Seed};

/// Time during which a vehicle that has entered the lane keeps others from entering at the other end
/// \[s\]. The lane's 60 m and the vehicle's length take 4.6 s at 14 m/s, but vehicles pass each other
/// where the lane begins to widen: with 3.93 s, as many crash at full throttle as in SUMO, 63 %.
const TRANSIT: f64 = 3.93;
/// Resolution of times \[s\].
const STEP: f64 = 0.25;
/// Number of starts of the search.
const STARTS: usize = 60;

/// Probabilities of an episode.
#[derive(Clone, Copy)]
struct Demand {
    /// That both vehicles come.
    both: f64,
    /// That only the vehicle of a certain arm comes.
    alone: f64,
}

impl Demand {
    /// As in scenario files: a vehicle comes to each place with this probability, and if none would
    /// come, one of them does.
    fn of(presence: f64) -> Self {
        let both = presence * presence;
        Self { both, alone: (1.0 - both) / 2.0 }
    }

    /// Returns the mean number of vehicles of an episode.
    fn vehicles(self) -> f64 {
        2.0 * (self.both + self.alone)
    }
}

/// Planned entry times of one arm, by arrival time.
type Plan = Vec<f64>;

/// What a pair of plans comes to.
#[derive(Clone, Copy, Default)]
struct Outcome {
    /// Share of vehicles that crash.
    crash: f64,
    /// Delay of the vehicles that do not crash, mean \[s\].
    delay: f64,
}

/// Returns when two vehicles enter, given arrivals and plans: a vehicle that sees the other come out
/// enters at once. `None` if they crash.
fn meet(arrivals: [f64; 2], plans: [f64; 2]) -> Option<[f64; 2]> {
    let [a, b] = plans;
    if (a - b).abs() < TRANSIT - 1e-9 {
        return None;
    }
    let first = usize::from(b < a);
    let mut entries = plans;
    entries[1 - first] = (plans[first] + TRANSIT).max(arrivals[1 - first]).min(plans[1 - first]);
    Some(entries)
}

/// Returns the cost of entering at `entry` after an arrival at `arrival` \[s\]: delays of both
/// vehicles, and `lambda` seconds for each vehicle that crashes.
fn cost(demand: Demand, lambda: f64, times: &[f64], arm: (f64, f64), other: &Plan) -> f64 {
    let (arrival, entry) = arm;
    let met = times.iter().zip(other).map(|(&time, &planned)| {
        meet([arrival, time], [entry, planned])
            .map_or(2.0 * lambda, |entries| entries[0] - arrival + entries[1] - time)
    });
    demand.alone * (entry - arrival) + demand.both * met.sum::<f64>() / times.len() as f64
}

fn outcome(demand: Demand, times: &[f64], plans: &[Plan; 2]) -> Outcome {
    let pairs = (times.len() * times.len()) as f64;
    let (mut crashed, mut delay) = (0.0, 0.0);
    for (i, &a) in times.iter().enumerate() {
        for (j, &b) in times.iter().enumerate() {
            match meet([a, b], [plans[0][i], plans[1][j]]) {
                None => crashed += demand.both * 2.0 / pairs,
                Some(entries) => delay += demand.both * (entries[0] - a + entries[1] - b) / pairs,
            }
        }
    }
    for plan in plans {
        let waits = times.iter().zip(plan).map(|(time, entry)| entry - time);
        delay += demand.alone * waits.sum::<f64>() / times.len() as f64;
    }
    let (vehicles, arrived) = (demand.vehicles(), demand.vehicles() - crashed);
    Outcome { crash: crashed / vehicles, delay: delay / arrived.max(1e-9) }
}

/// Returns the times from 0 to `end` \[s\] at which vehicles may arrive or enter.
fn grid(end: f64) -> Vec<f64> {
    (0..(end / STEP) as u32).map(|i| (f64::from(i) + 0.5) * STEP).collect()
}

/// Returns the best plans that the search finds for this price of a crash \[s\].
fn best_local(demand: Demand, window: f64, lambda: f64, rng: &mut Rng) -> Outcome {
    let times = grid(window);
    let entries = grid(window + 2.0 * TRANSIT);
    let mut best: Option<(f64, [Plan; 2])> = None;
    for start in 0..STARTS {
        let mut plans = [times.clone(), times.clone()];
        match start {
            // Everybody drives; one arm waits for the whole window; time slots; anything.
            0 => {}
            1 => plans[1].iter_mut().for_each(|entry| *entry = entry.max(window + TRANSIT)),
            2..=12 => {
                let slot = 2.0 * TRANSIT * (0.5 + 0.1 * start as f64);
                for (plan, offset) in plans.iter_mut().zip([0.0, slot / 2.0]) {
                    for entry in plan {
                        *entry = offset + slot * ((*entry - offset) / slot).ceil().max(0.0);
                    }
                }
                for (plan, time) in plans.iter_mut().flat_map(|plan| plan.iter_mut().zip(&times)) {
                    *plan = plan.max(*time);
                }
            }
            _ => {
                for (plan, time) in plans.iter_mut().flat_map(|plan| plan.iter_mut().zip(&times)) {
                    *plan = time.max(entries[rng.random_range(0..entries.len())]);
                }
            }
        }
        let mut last = f64::INFINITY;
        loop {
            for arm in [0, 1] {
                let other = plans[1 - arm].clone();
                for (entry, &time) in plans[arm].iter_mut().zip(&times) {
                    let later = entries.iter().copied().filter(|&entry| entry > time);
                    let choices = std::iter::once(time).chain(later);
                    let price = |entry: f64| cost(demand, lambda, &times, (time, entry), &other);
                    *entry = choices
                        .min_by(|a, b| price(*a).total_cmp(&price(*b)))
                        .expect("there is a choice");
                }
            }
            let found = outcome(demand, &times, &plans);
            let value = lambda * found.crash * demand.vehicles()
                + found.delay * (1.0 - found.crash) * demand.vehicles();
            if value > last - 1e-9 {
                break;
            }
            last = value;
        }
        if best.as_ref().is_none_or(|(value, _)| last < *value) {
            best = Some((last, plans));
        }
    }
    best.map(|(_, plans)| outcome(demand, &times, &plans)).unwrap_or_default()
}

/// Returns the outcome with full information: of two that would meet, the later one waits.
fn full_information(demand: Demand, window: f64, rng: &mut Rng) -> Outcome {
    const DRAWS: usize = 200_000;
    let wait = |rng: &mut Rng| {
        let [a, b] = [rng::uniform(rng), rng::uniform(rng)].map(|share| share * window);
        (TRANSIT - (a - b).abs()).max(0.0)
    };
    let mean = (0..DRAWS).map(|_| wait(rng)).sum::<f64>() / DRAWS as f64;
    Outcome { crash: 0.0, delay: demand.both * mean / demand.vehicles() }
}

/// Returns the files of an argument: the file itself, or the results of all seeds of a sweep's row.
fn files(path: &str) -> Result<Vec<PathBuf>, Box<dyn Error>> {
    let path = PathBuf::from(path);
    if path.is_file() {
        return Ok(vec![path]);
    }
    let mut found = Vec::new();
    for entry in std::fs::read_dir(&path).map_err(|error| format!("{}: {error}", path.display()))? {
        let file = entry?.path().join("evaluations").join("evaluation.json");
        found.extend(file.is_file().then_some(file));
    }
    found.sort();
    if found.is_empty() {
        return Err(format!("{} holds no evaluated seed", path.display()).into());
    }
    Ok(found)
}

/// Draws curves and points on the plane of crashes and delay. Whiskers are the intervals of the
/// delay over a policy's episodes.
fn draw(path: &str, curves: Vec<Series>, results: &[String]) -> Result<(), Box<dyn Error>> {
    let mut series = curves;
    for argument in results {
        let (label, place) = argument.split_once('=').unwrap_or(("", argument));
        for file in files(place)? {
            let found: Value = serde_json::from_str(&std::fs::read_to_string(&file)?)?;
            let list = found.as_array().cloned().unwrap_or_else(|| vec![found]);
            for result in list {
                let number = |metric: &str, of: &str| result["metrics"][metric][of].as_f64();
                let (Some(crash), Some(delay)) = (number("crash", "mean"), number("delay", "mean"))
                else {
                    let file = file.display();
                    return Err(format!("`{file}` has no crash and delay of an evaluation").into());
                };
                let crash = 100.0 * crash;
                let (low, high) = (number("delay", "low"), number("delay", "high"));
                let named = result["policy"].as_str().filter(|_| label.is_empty());
                let label = named.unwrap_or(label).to_owned();
                let known = series.iter().position(|one| one.label == label);
                let at = known.unwrap_or_else(|| {
                    let (points, band, style) = (Vec::new(), Some(Vec::new()), Style::Whiskers);
                    series.push(Series { label, points, band, style });
                    series.len() - 1
                });
                // A point that is missing keeps the points of two seeds from being joined.
                series[at].points.extend([(crash, delay), (f64::NAN, f64::NAN)]);
                let whisker = (crash, low.unwrap_or(delay), high.unwrap_or(delay));
                series[at].band.get_or_insert_default().push(whisker);
            }
        }
    }
    let panel = Panel {
        title: String::new(),
        x_label: "agents that crash (%)".to_owned(),
        y_label: "delay of an agent that arrives (s)".to_owned(),
        series,
        ..Panel::default()
    };
    Ok(figure(Path::new(path), "A lane for two directions", &[panel], (900, 600))?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let demand = Demand::of(0.8);
    let mut curves = Vec::new();
    println!("window_s,policy,crash_price_s,crash_percent,delay_s");
    for window in [7.0, 20.0] {
        let mut rng = Seed::new(1).rng();
        let row = |policy: &str, price: &str, Outcome { crash, delay }: Outcome| {
            println!("{window},{policy},{price},{:.2},{delay:.2}", 100.0 * crash);
            (100.0 * crash, delay)
        };
        let full = row("full information", "", full_information(demand, window, &mut rng));
        let mut local = Vec::new();
        for price in [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 25.0, 50.0, 1000.0] {
            let found = best_local(demand, window, price, &mut rng);
            local.push(row("local", &price.to_string(), found));
        }
        if curves.is_empty() {
            local.sort_by(|a, b| a.0.total_cmp(&b.0));
            local.dedup();
            curves.push(Series::curve("best without messages (ideal)".to_owned(), local, None));
            let label = "full information (ideal)".to_owned();
            curves.push(Series { label, points: vec![full], band: None, style: Style::Whiskers });
        }
    }
    match arguments.split_first() {
        Some((path, results)) => draw(path, curves, results),
        None => Ok(()),
    }
}
