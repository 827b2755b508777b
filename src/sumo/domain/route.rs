//! Routes.

domain! {
    /// Calls for routes.
    Route, "route", ROUTE
}
identifiers! { Route, "route" }

getters! { Route, "route";
    /// Edges in driving order.
    get_edges "getEdges" VAR_EDGES 0x54 -> Vec<String>;
}

setters! { Route, "route";
    /// Adds a route of these edges in driving order.
    add "add" 0x80 (edges: &[impl AsRef<str>]);
}
