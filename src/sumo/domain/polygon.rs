//! Polygons.

use super::{Argument as _, Color, Scope};
use crate::sumo::{batch::Call, constants::Domain};

domain! {
    /// Calls for polygons.
    Polygon, "polygon", POLYGON
}
identifiers! { Polygon, "polygon", POLYGON }

getters! { Polygon, "polygon", POLYGON;
    /// Type.
    get_type "getType" VAR_TYPE 0x4f -> String;
    /// Points \[m\].
    get_shape "getShape" VAR_SHAPE 0x4e -> Vec<[f64; 2]>;
    /// Colour.
    get_color "getColor" VAR_COLOR 0x45 -> Color;
    /// Whether its inside is coloured.
    get_filled "getFilled" VAR_FILL 0x55 -> bool;
    /// Width of its outline \[m\].
    get_line_width "getLineWidth" VAR_WIDTH 0x4d -> f64;
}

setters! { Polygon, "polygon", POLYGON;
    /// Sets the type.
    set_type "setType" 0x4f (kind: &str);
    /// Sets the colour.
    set_color "setColor" 0x45 (color: Color);
    /// Sets the width of its outline \[m\].
    set_line_width "setLineWidth" 0x4d (width: f64);
    /// Removes it from a layer.
    remove "remove" 0x81 (layer: i32);
}

/// What a new polygon looks like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Appearance<'a> {
    /// Colour.
    pub color: Color,
    /// Whether its inside is coloured.
    pub fill: bool,
    /// Type.
    pub kind: &'a str,
    /// Layer; the higher covers the lower.
    pub layer: i32,
    /// Width of its outline \[m\].
    pub line_width: f64,
}

impl Default for Appearance<'_> {
    /// A red outline.
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

/// How a polygon moves and fades.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Dynamics<'a> {
    /// The vehicle, person or other object that it follows; empty for none.
    pub tracked: &'a str,
    /// Times of the changes, the first 0, ascending \[s\].
    pub time_span: &'a [f64],
    /// Opacity at each of the times, 0 to 255; empty: it does not fade.
    pub alpha_span: &'a [f64],
    /// Whether it starts again when the last time is reached; else it is removed.
    pub looped: bool,
    /// Whether it turns with what it follows.
    pub rotate: bool,
}

impl<S: Scope> Polygon<'_, S> {
    /// Sets the points \[m\].
    pub fn set_shape(&mut self, id: &str, shape: &[[f64; 2]]) -> S::Output<()> {
        super::set(
            self.0,
            Call::set("polygon.setShape", Domain::POLYGON, VAR_SHAPE.number()),
            id,
            |w| {
                w.polygon(shape);
            },
        )
    }

    /// Sets whether its inside is coloured.
    pub fn set_filled(&mut self, id: &str, filled: bool) -> S::Output<()> {
        super::set(
            self.0,
            Call::set("polygon.setFilled", Domain::POLYGON, VAR_FILL.number()),
            id,
            |w| {
                w.integer(filled.into());
            },
        )
    }

    /// Makes a new polygon of points \[m\].
    pub fn add(
        &mut self,
        id: &str,
        shape: &[[f64; 2]],
        appearance: &Appearance<'_>,
    ) -> S::Output<()> {
        super::set(self.0, Call::set("polygon.add", Domain::POLYGON, 0x80), id, |w| {
            let Appearance { color, fill, kind, layer, line_width } = *appearance;
            w.compound(6).string(kind);
            color.write(w);
            u8::from(fill).write(w);
            w.integer(layer).polygon(shape).double(line_width);
        })
    }

    /// Lets it move or fade from now on.
    pub fn add_dynamics(&mut self, id: &str, dynamics: &Dynamics<'_>) -> S::Output<()> {
        super::set(self.0, Call::set("polygon.addDynamics", Domain::POLYGON, 0x5c), id, |w| {
            let Dynamics { tracked, time_span, alpha_span, looped, rotate } = *dynamics;
            w.compound(5).string(tracked).double_list(time_span).double_list(alpha_span);
            u8::from(looped).write(w);
            u8::from(rotate).write(w);
        })
    }
}
