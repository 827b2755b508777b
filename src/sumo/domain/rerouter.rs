//! Rerouters.

domain! {
    /// Calls for rerouters.
    Rerouter, "rerouter", REROUTER
}
identifiers! { Rerouter, "rerouter" }
