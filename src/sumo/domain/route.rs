//! Routes.

use super::Scope;
use crate::sumo::{batch::Call, constants::Domain};

domain! {
    /// Calls for routes.
    Route, "route", ROUTE
}
identifiers! { Route, "route", ROUTE }

getters! { Route, "route", ROUTE;
    /// Edges in driving order.
    get_edges "getEdges" VAR_EDGES 0x54 -> Vec<String>;
}

setters! { Route, "route", ROUTE;
    /// Adds a route of these edges in driving order.
    add "add" 0x80 (edges: &[impl AsRef<str>]);
}
