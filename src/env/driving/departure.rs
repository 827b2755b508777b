//! The departure of an agent from a route file.

use super::task::Task;

/// A vehicle of the route files that is an agent.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Departure {
    /// Time at which it is to depart, from the start of the episode \[s\].
    pub(crate) due: f64,
    /// Position of the front, on the lanes of its route, at which SUMO may remove it \[m\].
    pub(crate) end: f64,
    /// What is added to SUMO's driven distance to get the position of the front on the route, as a
    /// sum of SUMO's lane lengths \[m\].
    pub(crate) origin: f64,
    /// SUMO's time loss so far \[s\].
    pub(crate) time_loss: f64,
}

impl Departure {
    /// Returns the departure of an agent that is due at `due` seconds. `planned` is an index into
    /// the departures of the plan.
    pub(super) fn new(task: &Task, planned: usize, due: f64) -> Self {
        let planned = &task.map.plan.departures[planned];
        let path = task.map.routes[planned.route].lanes();
        let on_last_edge = match task.demand.sources[planned.source].finish.pos.as_str() {
            "random" => Some(0.0),
            pos => pos.parse().ok(),
        };
        let last = path.edges.len().saturating_sub(1);
        let end = on_last_edge.and_then(|pos| path.arc(last, pos));
        Self { due, end: end.unwrap_or_else(|| path.length()), ..Self::default() }
    }
}
