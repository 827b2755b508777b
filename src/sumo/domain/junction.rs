//! Junctions.

domain! {
    /// Calls for junctions.
    Junction, "junction", JUNCTION
}
identifiers! { Junction, "junction" }

getters! { Junction, "junction";
    /// Position \[m\].
    get_position "getPosition" VAR_POSITION 0x42 -> [f64; 2];
    /// Position with height \[m\]; in SUMO's client this is `getPosition` with `includeZ`.
    get_position3d "getPosition3D" VAR_POSITION3D 0x39 -> [f64; 3];
    /// Outline \[m\].
    get_shape "getShape" VAR_SHAPE 0x4e -> Vec<[f64; 2]>;
}
