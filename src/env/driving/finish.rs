//! Where the trip of an agent ends.

use super::agents::Slot;
use super::map::Map;

impl Slot {
    /// Returns the position of an agent's centre on its route at its finish \[m\]: where the route
    /// has its finish line, or where SUMO may remove an agent of a route file.
    pub(crate) fn finish(&self, map: &Map) -> f64 {
        let route = &map.routes[self.route];
        let end = self.end_of_trip(map);
        end.map_or(route.arrival, |end| route.on_path(end - self.size[0] / 2.0))
    }

    /// Returns the position of the front of an agent of a route file, on the lanes of its present
    /// route, at which SUMO may remove it \[m\]; `None` for an agent of a spawn place.
    pub(super) fn end_of_trip(&self, map: &Map) -> Option<f64> {
        let end = self.departure?.end;
        if self.route == self.assigned {
            return Some(end);
        }
        let length = |route: usize| map.routes[route].lanes().length();
        Some(end + length(self.route) - length(self.assigned))
    }
}
