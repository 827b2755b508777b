//! Views of the graphical interface (`sumo-gui`). SUMO without a graphical interface refuses these
//! calls.

use crate::sumo::value::Points;

/// Identifier of the view that `sumo-gui` opens at the start.
pub const DEFAULT_VIEW: &str = "View #0";

domain! {
    /// Calls for the views of the graphical interface.
    Gui, "gui", GUI
}
identifiers! { Gui, "gui" }

getters! { Gui, "gui";
    /// Zoom \[%\].
    get_zoom "getZoom" VAR_VIEW_ZOOM 0xa0 -> f64;
    /// Centre of the view \[m\].
    get_offset "getOffset" VAR_VIEW_OFFSET 0xa1 -> [f64; 2];
    /// Colour scheme.
    get_schema "getSchema" VAR_VIEW_SCHEMA 0xa2 -> String;
    /// Rotation \[deg\].
    get_angle "getAngle" VAR_ANGLE 0x43 -> f64;
    /// Lower left and upper right corner \[m\].
    get_boundary "getBoundary" VAR_VIEW_BOUNDARY 0xa3 -> Vec<[f64; 2]>;
    /// Whether a view of this identifier exists.
    has_view "hasView" VAR_HAS_VIEW 0xa7 -> bool;
    /// The vehicle that the view follows; empty for none.
    get_tracked_vehicle "getTrackedVehicle" VAR_TRACK_VEHICLE 0xa6 -> String;
    /// Whether an object is selected; `kind` is the kind of object, such as `vehicle`.
    is_selected "isSelected" 0xa4 (kind: &str) -> bool;
}

setters! { Gui, "gui";
    /// Sets the zoom \[%\].
    set_zoom "setZoom" 0xa0 (zoom: f64);
    /// Sets the centre of the view \[m\].
    set_offset "setOffset" 0xa1 (centre: [f64; 2]);
    /// Sets the colour scheme.
    set_schema "setSchema" 0xa2 (scheme: &str);
    /// Sets the rotation \[deg\].
    set_angle "setAngle" 0x43 (angle: f64);
    /// Closes the view.
    remove_view "removeView" 0x81;
    /// Writes the view to an image file after the next step; -1 stands for the view's own width or
    /// height \[pixel\].
    screenshot "screenshot" 0xa5 [file: &str, width: i32, height: i32];
    /// Makes the view follow a vehicle; an empty identifier ends this.
    track_vehicle "trackVehicle" 0xa6 (vehicle: &str);
    /// Makes the view follow a vehicle or a person; an empty identifier ends this.
    track "track" 0xa6 (object: &str);
    /// Selects an object, or deselects it if it is selected; `kind` is the kind of object, such as
    /// `vehicle`.
    toggle_selection "toggleSelection" 0xa4 (kind: &str);
    /// Opens a view with a colour scheme.
    add_view "addView" 0x80 {scheme: &str, in_3d: bool} => (scheme, i32::from(in_3d));
    /// Sets the lower left and the upper right corner \[m\].
    set_boundary "setBoundary" 0xa3
        {lower_left: [f64; 2], upper_right: [f64; 2]} => Points(&[lower_left, upper_right]);
}
