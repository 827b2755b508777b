//! Polygons.

use crate::sumo::value::{Color, Doubles, Points};

domain! {
    /// Calls for polygons.
    Polygon, "polygon", POLYGON
}
identifiers! { Polygon, "polygon" }

getters! { Polygon, "polygon";
    /// Type.
    get_type "getType" VAR_TYPE 0x4f -> String;
    /// Points \[m\].
    get_shape "getShape" VAR_SHAPE 0x4e -> Vec<[f64; 2]>;
    /// Colour.
    get_color "getColor" VAR_COLOR 0x45 -> Color;
    /// Whether the polygon is filled.
    get_filled "getFilled" VAR_FILL 0x55 -> bool;
    /// Width of the outline \[m\].
    get_line_width "getLineWidth" VAR_WIDTH 0x4d -> f64;
}

/// Appearance of a new polygon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance<'a> {
    /// Colour.
    pub color: Color,
    /// Whether the polygon is filled.
    pub fill: bool,
    /// Type.
    pub kind: &'a str,
    /// Layer; higher layers cover lower ones.
    pub layer: i32,
    /// Width of the outline \[m\].
    pub line_width: f64,
}

impl Default for Appearance<'_> {
    /// Returns the appearance of a red outline.
    fn default() -> Self {
        Appearance {
            color: Color::rgb(255, 0, 0),
            fill: false,
            kind: "",
            layer: 0,
            line_width: 1.0,
        }
    }
}

/// Movement and fading of a polygon.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Dynamics<'a> {
    /// The vehicle, person or other object that the polygon follows; empty for none.
    pub tracked: &'a str,
    /// Times of the changes \[s\], ascending; the first is 0.
    pub time_span: &'a [f64],
    /// Opacity at each of the times, 0 to 255; empty: the polygon does not fade.
    pub alpha_span: &'a [f64],
    /// Whether the dynamics start again after the last time; otherwise the polygon is removed then.
    pub looped: bool,
    /// Whether the polygon rotates with the object that it follows.
    pub rotate: bool,
}

setters! { Polygon, "polygon";
    /// Sets the type.
    set_type "setType" 0x4f (kind: &str);
    /// Sets the colour.
    set_color "setColor" 0x45 (color: Color);
    /// Sets the width of the outline \[m\].
    set_line_width "setLineWidth" 0x4d (width: f64);
    /// Removes the polygon from a layer.
    remove "remove" 0x81 (layer: i32);
    /// Sets the points \[m\].
    set_shape "setShape" 0x4e {shape: &[[f64; 2]]} => Points(shape);
    /// Sets whether the polygon is filled.
    set_filled "setFilled" 0x55 {filled: bool} => i32::from(filled);
    /// Adds a polygon with these points \[m\].
    add "add" 0x80 {shape: &[[f64; 2]], appearance: &Appearance<'_>} => {
        let Appearance { color, fill, kind, layer, line_width } = *appearance;
        (kind, color, u8::from(fill), layer, Points(shape), line_width)
    };
    /// Starts movement or fading of the polygon.
    add_dynamics "addDynamics" 0x5c {dynamics: &Dynamics<'_>} => {
        let Dynamics { tracked, time_span, alpha_span, looped, rotate } = *dynamics;
        (tracked, Doubles(time_span), Doubles(alpha_span), u8::from(looped), u8::from(rotate))
    };
}
