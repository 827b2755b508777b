//! Tests of the registry.

use super::*;
use crate::env::MAX_TIME_APART;

#[test]
fn every_metric_has_its_own_key_and_the_key_finds_it_in_json() {
    let known = Estimate { mean: 0.25, low: 0.0, high: 0.5 };
    for metric in all() {
        assert_eq!(all().filter(|other| other.id == metric.id).count(), 1, "{}", metric.id);
        assert_eq!(metric.estimate(&Metrics::default()), None, "{}", metric.id);
        let value =
            serde_json::json!({ "mean": 0.25, "low": 0.0, "high": 0.5, "km": 1.0, "crashes": 4 });
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
        ttc: Some(ttc),
        ..BackgroundMetrics::default()
    };
    let records: Vec<EpisodeRecord> = [effects(0.0, 5.0), effects(0.5, 5.0), effects(0.0, 4.0)]
        .map(|others| DrivingRecord { others: Some(others), ..DrivingRecord::default() })
        .map(|driving| EpisodeRecord { driving: Some(driving), ..EpisodeRecord::default() })
        .into();
    let metrics = Metrics::of(&[], &records, &[-1.0, 2.0], &[], &[]).unwrap();
    let others = metrics.driving().others.as_ref().unwrap();
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

/// An episode whose agents all came too late to count says nothing about their success.
#[test]
fn shares_of_agents_are_over_the_episodes_in_which_agents_count() {
    let episode = |undecided: bool, success: f64| {
        let driving = DrivingRecord {
            undecided,
            safety: 1.0,
            efficiency: success,
            ..DrivingRecord::default()
        };
        EpisodeRecord { success, driving: Some(driving), ..EpisodeRecord::default() }
    };
    let of = |records: &[EpisodeRecord]| Metrics::of(&[], records, &[0.0], &[], &[]).unwrap();
    let decided = of(&[episode(false, 0.5), episode(false, 1.0)]);
    let mixed = of(&[episode(false, 0.5), episode(true, 0.0), episode(false, 1.0)]);
    assert_eq!(mixed.success, decided.success);
    assert_eq!(mixed.driving().efficiency, decided.driving().efficiency);
    assert_eq!((mixed.counted, decided.counted), (Some(2), None));
    let none = of(&[episode(true, 0.0)]);
    let again: Metrics = serde_json::from_str(&serde_json::to_string(&none).unwrap()).unwrap();
    for metrics in [none, again] {
        assert_eq!(SUCCESS.estimate(&metrics), None);
        assert_eq!(named("safety").unwrap().estimate(&metrics), None);
        assert!(named("own_collisions").unwrap().estimate(&metrics).is_some());
    }
}

#[test]
fn metrics_survive_their_json() {
    let success = Estimate { mean: 0.5, low: 0.25, high: 0.75 };
    let metrics = Metrics { success, ..Metrics::default() };
    let again: Metrics = serde_json::from_str(&serde_json::to_string(&metrics).unwrap()).unwrap();
    assert_eq!(again.success, metrics.success);
    assert_eq!(again.driving, None, "there are no vehicles");
    let driving = DrivingMetrics { safety: success, ..DrivingMetrics::default() };
    let metrics = Metrics { driving: Some(driving), ..metrics };
    let again: Metrics = serde_json::from_str(&serde_json::to_string(&metrics).unwrap()).unwrap();
    assert_eq!(again.driving().safety, success);
    assert!(again.driving().crash.mean.is_nan(), "null is no number");
}

/// `IWOL_UPDATE=1 cargo test metrics_reference` writes the page again.
#[test]
fn the_metrics_reference_is_up_to_date() {
    let path = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference/metrics.md");
    if std::env::var_os("IWOL_UPDATE").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, reference()).unwrap();
    }
    let page = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(page == reference(), "out of date: run it again with IWOL_UPDATE=1");
}

/// An episode without an agent says nothing about rewards, nor about how near agents came to others.
#[test]
fn episodes_without_an_agent_have_no_reward_and_no_distance() {
    let episode = |departed: u32, reward: f64| {
        let others = BackgroundMetrics {
            vehicles: 3,
            ttc: (departed > 0).then_some(2.0),
            pet: (departed > 0).then_some(3.0),
            ..BackgroundMetrics::default()
        };
        let flow = FlowMetrics { hours: 0.1, departed, ..FlowMetrics::default() };
        let driving =
            DrivingRecord { flow: Some(flow), others: Some(others), ..DrivingRecord::default() };
        EpisodeRecord { reward, driving: Some(driving), ..EpisodeRecord::default() }
    };
    let records = [episode(1, 90.0), episode(0, 0.0), episode(2, 110.0)];
    let metrics = Metrics::of(&[], &records, &[0.0], &[], &[]).unwrap();
    let others = metrics.driving().others.as_ref().unwrap();
    assert_eq!(metrics.reward.mean, 100.0);
    assert_eq!((others.ttc.unwrap().mean, others.pet.unwrap().mean), (2.0, 3.0));
}
