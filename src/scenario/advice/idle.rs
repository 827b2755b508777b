//! Attributes that have no effect.

use super::super::Scenario;

/// Returns the attributes that other values of the scenario make ineffective, whatever its nets
/// are: element, attribute, and why.
pub fn without_effect(
    s: &Scenario,
) -> impl Iterator<Item = (&'static str, &'static str, &'static str)> {
    let o = &s.observation;
    let follows = s.control.steering.is_none();
    let unseen = follows && o.lidar.beams == 0 && o.borders == 0.0;
    let placeless = s.nets.iter().all(|net| net.spawns.is_empty());
    let all = s.everybody_is_nearest();
    let rules = [
        ("communication", "nearest", all, "there are never more other agents"),
        ("route", "offLane", follows, "vehicles do not steer"),
        ("reward", "laneKeeping", follows, "vehicles do not steer"),
        ("termination", "border", unseen, "vehicles do not steer and observe no borders"),
        ("termination", "brokenLines", unseen, "vehicles do not steer and observe no borders"),
        ("observation", "neighbourOrder", !o.groups.nearest(), "groups is `conflict`"),
        ("reward", "shareRange", s.reward.cooperation == 0.0, "cooperation is 0"),
        ("observation", "foresight", o.encounters == 0, "encounters is 0"),
        ("observation", "lidarRange", o.lidar.beams == 0, "lidarBeams is 0"),
        ("jitter", "longitudinal", placeless, "there are no spawn places"),
        ("jitter", "lateral", placeless, "there are no spawn places"),
        ("traffic", "type", placeless, "there are no spawn places"),
        ("traffic", "type", !placeless && s.traffic.penetration >= 1.0, "penetration is 1"),
        ("traffic", "capacity", s.traffic.files.is_empty(), "there are no files"),
        ("traffic", "begin", s.traffic.files.is_empty(), "there are no files"),
        ("traffic", "strict", s.traffic.files.is_empty(), "there are no files"),
    ];
    rules.into_iter().filter(|rule| rule.2).map(|(element, key, _, why)| (element, key, why))
}
