//! Points of interest.

use super::{Color, Highlight};

domain! {
    /// Calls for points of interest.
    Poi, "poi", POI
}
identifiers! { Poi, "poi" }

getters! { Poi, "poi";
    /// Type.
    get_type "getType" VAR_TYPE 0x4f -> String;
    /// Position \[m\].
    get_position "getPosition" VAR_POSITION 0x42 -> [f64; 2];
    /// Colour.
    get_color "getColor" VAR_COLOR 0x45 -> Color;
    /// Width of the image \[m\].
    get_width "getWidth" VAR_WIDTH 0x4d -> f64;
    /// Height of the image \[m\].
    get_height "getHeight" VAR_HEIGHT 0xbc -> f64;
    /// Angle of the image \[deg\].
    get_angle "getAngle" VAR_ANGLE 0x43 -> f64;
    /// Path of the image file.
    get_image_file "getImageFile" VAR_IMAGEFILE 0x93 -> String;
}

setters! { Poi, "poi";
    /// Sets the type.
    set_type "setType" 0x4f (kind: &str);
    /// Sets the position \[m\].
    set_position "setPosition" 0x42 (position: [f64; 2]);
    /// Sets the colour.
    set_color "setColor" 0x45 (color: Color);
    /// Sets the width of the image \[m\].
    set_width "setWidth" 0x4d (width: f64);
    /// Sets the height of the image \[m\].
    set_height "setHeight" 0xbc (height: f64);
    /// Sets the angle of the image \[deg\].
    set_angle "setAngle" 0x43 (angle: f64);
    /// Sets the path of the image file.
    set_image_file "setImageFile" 0x93 (file: &str);
    /// Removes the point from a layer.
    remove "remove" 0x81 (layer: i32);
    /// Adds a point of interest at a position \[m\].
    add "add" 0x80 {position: [f64; 2], appearance: &Appearance<'_>} => {
        let Appearance { color, kind, layer, image_file, width, height, angle } = *appearance;
        (kind, color, layer, position, image_file, width, height, angle)
    };
    /// Draws a circle around the point in the graphical interface. SUMO refuses circles that do not
    /// fade (`fade` is `None`).
    highlight "highlight" 0x6c (highlight: &Highlight);
}

/// Appearance of a new point of interest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance<'a> {
    /// Colour.
    pub color: Color,
    /// Type.
    pub kind: &'a str,
    /// Layer; higher layers cover lower ones.
    pub layer: i32,
    /// Path of the image file; empty for none.
    pub image_file: &'a str,
    /// Width of the image \[m\].
    pub width: f64,
    /// Height of the image \[m\].
    pub height: f64,
    /// Angle of the image \[deg\].
    pub angle: f64,
}

impl Default for Appearance<'_> {
    /// Returns the appearance of a red point.
    fn default() -> Self {
        let color = Color::rgb(255, 0, 0);
        Appearance {
            color,
            kind: "",
            layer: 0,
            image_file: "",
            width: 1.0,
            height: 1.0,
            angle: 0.0,
        }
    }
}
