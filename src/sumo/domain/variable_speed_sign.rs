//! Variable speed signs.

domain! {
    /// Calls for variable speed signs.
    VariableSpeedSign, "variablespeedsign", VARIABLE_SPEED_SIGN
}
identifiers! { VariableSpeedSign, "variablespeedsign" }

getters! { VariableSpeedSign, "variablespeedsign";
    /// The lanes whose speed limit the sign sets.
    get_lanes "getLanes" VAR_LANES 0x30 -> Vec<String>;
}
