//! Segments of overhead wires.

domain! {
    /// Calls for segments of overhead wires.
    OverheadWire, "overheadwire", OVERHEAD_WIRE
}
identifiers! { OverheadWire, "overheadwire" }
stopping_place! { OverheadWire, "overheadwire" }
