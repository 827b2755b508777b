//! Configurations that are older than some settings. Who adds a setting that changes what runs do adds a line here.

use toml::{Table, Value};

/// Gives a configuration that is older than a setting the value which says what was done before there was one; gives whether
/// it was older than any.
pub fn complete_older(table: &mut Table) -> bool {
    let mut older = false;
    for (key, neutral) in [
        ("ppo.bounds", Value::Float(0.0)),
        ("ppo.gamma_explored", Value::Float(0.0)),
        ("ppo.target_kl", Value::Float(0.0)),
        ("exploration.correlation", Value::Float(0.0)),
        ("exploration.correlation_steps", Value::Integer(0)),
        ("iwol.graph_bias", Value::Float(0.0)),
        ("train.fewest_agents", Value::Integer(0)),
        ("train.growth", Value::Integer(1)),
        ("train.imitate_speed", Value::Float(6.0)),
        ("train.imitate_yields", Value::Boolean(false)),
        ("train.imitate_steps", Value::Integer(0)),
        ("train.teacher", Value::String(String::new())),
        ("train.replay_failed", Value::Float(0.0)),
        ("train.restart_steps", Value::Integer(0)),
        ("train.shaping", Value::Float(0.0)),
        ("train.restart_success", Value::Float(0.8)),
        ("env.encounters", Value::Integer(0)),
        ("env.foresight", Value::Float(0.0)),
        ("env.turns", Value::Float(0.0)),
        ("env.borders", Value::Float(0.0)),
        ("env.neighbour_order", Value::String("distance".to_owned())),
        ("env.intention", Value::String("seen".to_owned())),
        ("env.signal_distance", Value::Float(30.0)),
        ("env.lidar_beams", Value::Integer(0)),
        ("env.lidar_range", Value::Float(50.0)),
        ("env.penetration", Value::Float(1.0)),
        ("env.share_range", Value::Float(f64::INFINITY)),
        ("train.bootstrap_horizon", Value::Boolean(true)),
        ("commformer.dropout", Value::Float(0.0)),
        ("maddpg.n_step", Value::Integer(1)),
    ] {
        let (group, setting) = key.split_once('.').expect("a group and a setting");
        if let Some(group) = table.get_mut(group).and_then(Value::as_table_mut) {
            older |= !group.contains_key(setting);
            group.entry(setting).or_insert(neutral);
        }
    }
    older
}
