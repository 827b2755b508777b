//! Collectors of mean data of edges and lanes.

domain! {
    /// Calls for collectors of mean data. SUMO 1.15 lists them, and has no other calls for them.
    MeanData, "meandata", MEAN_DATA
}
identifiers! { MeanData, "meandata" }
