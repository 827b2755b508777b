//! A step of a recording as an SVG picture, for papers and web pages.

use std::fmt::Write as _;

use super::{Recording, Status};
use crate::markup::escape as escaped;
use crate::plot::path;

/// Margin around the net \[m\], where vehicles are as long as cars.
const MARGIN: f64 = 4.0;
/// Length of a car \[m\]: lines and letters shrink where bodies are smaller.
const CAR: f64 = 4.5;
/// Size of the caption's letters, as a share of the picture's width.
const LETTERS: f64 = 0.015;
/// Fills of areas: of the ground, and of those on it by their names.
const ZONES: [&str; 4] = [
    "fill=\"#d2d6da\"",
    "fill=\"#009e73\" fill-opacity=\".3\"",
    "fill=\"#cc79a7\" fill-opacity=\".35\"",
    "fill=\"#e69f00\" fill-opacity=\".3\"",
];
/// Colours of the palette of Okabe and Ito.
const DRIVING: &str = "#0072b2";
const ARRIVED: &str = "#009e73";
const CRASHED: &str = "#d55e00";
/// Colour of background traffic and pedestrians.
const OTHER: &str = "#59616b";
/// Pedestrians are recognised by a width below this limit, and drawn as circles with it as the
/// radius \[m\].
const PERSON: f64 = 0.6;

impl Recording {
    /// Draws the net, the vehicles and the communication links at `step` (the last step if there
    /// are fewer), and where the agents have been until then, with a scale and a caption below. One
    /// metre is one SVG unit.
    pub fn still(&self, step: usize) -> String {
        let step = step.min(self.steps - 1);
        let unit = (self.vehicle.length / CAR).min(1.0);
        let zones = || self.zones.iter().flat_map(|zone| &zone.shape);
        let points = || self.lanes.iter().flat_map(|lane| &lane.shape).chain(zones());
        let end = |axis: usize, sign: f64| {
            points().map(|p| sign * p[axis]).fold(f64::NEG_INFINITY, f64::max) * sign
        };
        let (left, bottom, right, top) = (end(0, -1.0), end(1, -1.0), end(0, 1.0), end(1, 1.0));
        let margin = unit * MARGIN;
        let (left, bottom, right, top) =
            (left - margin, bottom - margin, right + margin, top + margin);
        let mut svg = String::new();
        let (width, letters) = (right - left, LETTERS * (right - left));
        let strip = 2.4 * letters;
        // SVG's y axis points down.
        let _ = writeln!(
            svg,
            "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"{left:.2} {:.2} {:.2} {:.2}\" width=\"900\">\n\
             <title>{}, step {step}</title>\n<g transform=\"scale(1 -1)\" fill=\"none\" stroke-linecap=\"round\">",
            -top,
            width,
            top - bottom + strip,
            escaped(&format!("{}, {}", self.scenario, self.policy)),
        );
        let mut names: Vec<&str> = Vec::new();
        for zone in &self.zones {
            let known = names.iter().position(|name| *name == zone.name);
            let number = known.unwrap_or_else(|| {
                names.push(&zone.name);
                names.len() - 1
            });
            let fill = ZONES[number % ZONES.len()];
            let corners = zone.shape.iter().map(|[x, y]| format!("{x:.3},{y:.3} "));
            let _ = writeln!(svg, "<polygon points=\"{}\" {fill}/>", corners.collect::<String>());
        }
        for internal in [true, false] {
            for lane in self.lanes.iter().filter(|lane| lane.internal == internal && !lane.crossing)
            {
                let color = if internal { "#e4e6e8" } else { "#d2d6da" };
                let _ = writeln!(
                    svg,
                    "<path d=\"{}\" stroke=\"{color}\" stroke-linecap=\"butt\" stroke-linejoin=\"round\" stroke-width=\"{:.2}\"/>",
                    path(&lane.shape),
                    lane.width
                );
            }
        }
        for lane in self.lanes.iter().filter(|lane| lane.crossing) {
            let _ = writeln!(
                svg,
                "<path d=\"{0}\" stroke=\"#d2d6da\" stroke-linecap=\"butt\" stroke-width=\"{1:.2}\"/><path d=\"{0}\" stroke=\"#fff\" stroke-linecap=\"butt\" stroke-dasharray=\".5 .5\" stroke-width=\"{1:.2}\"/>",
                path(&lane.shape),
                lane.width
            );
        }
        for wall in &self.walls {
            let _ = writeln!(svg, "<path d=\"{}Z\" fill=\"#b9a78f\"/>", path(wall));
        }
        for signal in &self.signals {
            let color = match signal.states.as_bytes()[step] {
                b'r' | b'u' => "#cc2b2b",
                b'y' | b'Y' | b's' => "#e0a800",
                b'g' | b'G' => "#12933f",
                _ => OTHER,
            };
            let _ = writeln!(
                svg,
                "<path d=\"{}\" stroke=\"{color}\" stroke-linecap=\"butt\" stroke-width=\".8\"/>",
                path(&signal.line)
            );
        }
        for track in self.tracks(step) {
            let _ = writeln!(
                svg,
                "<path d=\"{}\" stroke=\"{DRIVING}\" stroke-opacity=\".3\" stroke-width=\"{:.3}\"/>",
                path(&track),
                0.3 * unit
            );
        }
        let vehicles = self.vehicles(step);
        // As in the player: lines of messages are solid, those of mere range dashed and grey.
        let link = if self.communicates {
            format!("stroke=\"#8a6d00\" stroke-opacity=\".35\" stroke-width=\"{:.3}\"", 0.25 * unit)
        } else {
            format!(
                "stroke=\"#59616b\" stroke-opacity=\".35\" stroke-width=\"{:.3}\" stroke-dasharray=\"{:.3} {:.3}\"",
                0.15 * unit,
                0.6 * unit,
                0.8 * unit
            )
        };
        let links = self.links(step);
        for &(i, j) in &links {
            let mutual = links.contains(&(j, i));
            if mutual && j < i {
                continue;
            }
            let [to, from] = [i, j].map(|k| vehicles[k].1);
            let head = if mutual { String::new() } else { arrowhead(to, from, unit) };
            let _ = writeln!(
                svg,
                "<path d=\"M{:.2} {:.2}L{:.2} {:.2}{head}\" {link}/>",
                to[0], to[1], from[0], from[1]
            );
        }
        let (people, others): (Vec<&[f64; 6]>, Vec<&[f64; 6]>) =
            self.others.get(step).into_iter().flatten().partition(|other| other[4] < PERSON * unit);
        for [x, y, heading, l, w, wreck] in others {
            let _ = writeln!(
                svg,
                "<g transform=\"translate({x:.2} {y:.2}) rotate({:.1})\"><rect x=\"{:.2}\" y=\"{:.2}\" width=\"{l:.2}\" \
                 height=\"{w:.2}\" rx=\"{:.2}\" fill=\"{OTHER}\"/>{}</g>",
                heading.to_degrees(),
                -l / 2.0,
                -w / 2.0,
                0.4 * unit,
                if *wreck > 0.0 { cross(*l, *w, unit) } else { String::new() },
            );
        }
        for [x, y, _, _, _, wreck] in people {
            let color = if *wreck > 0.0 { CRASHED } else { OTHER };
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{PERSON}\" fill=\"{color}\" stroke=\"#fff\" stroke-width=\".2\"/>"
            );
        }
        let sizes = self.sizes(step);
        let mut numbers = String::new();
        for (number, (status, [x, y, heading])) in vehicles.iter().enumerate() {
            let color = match status {
                Status::Driving => DRIVING,
                Status::Arrived => ARRIVED,
                Status::Failed => CRASHED,
                Status::Gone => continue,
            };
            let (l, w) = (sizes[number].length, sizes[number].width);
            let _ = writeln!(
                svg,
                "<g transform=\"translate({x:.2} {y:.2})\"><g transform=\"rotate({:.1})\">\
                 <rect x=\"{:.2}\" y=\"{:.2}\" width=\"{l:.2}\" height=\"{w:.2}\" rx=\"{:.2}\" fill=\"{color}\"/>\
                 <rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"#fff\" fill-opacity=\".8\"/>{}</g></g>",
                heading.to_degrees(),
                -l / 2.0,
                -w / 2.0,
                0.4 * unit,
                l * 0.15,
                -w * 0.38,
                l * 0.13,
                w * 0.76,
                if *status == Status::Failed { cross(l, w, unit) } else { String::new() },
            );
            // The number stands to the left of the body, clear of it in every direction.
            let (size, (sin, cos)) = (2.2 * unit, heading.sin_cos());
            let away = w / 2.0 + 0.6 * size;
            let _ = writeln!(
                numbers,
                "<text transform=\"translate({:.2} {:.2}) scale(1 -1)\" dy=\".35em\" font-size=\"{size:.2}\">{number}</text>",
                x - away * sin,
                y + away * cos,
            );
        }
        let _ = writeln!(
            svg,
            "<g font-family=\"sans-serif\" text-anchor=\"middle\" fill=\"#1b1f24\" stroke=\"#fff\" stroke-width=\"{:.2}\" paint-order=\"stroke\">\n{numbers}</g>\n</g>",
            0.4 * unit
        );
        svg.push_str(&self.caption(step, [left, strip - bottom], letters));
        svg.push_str("</svg>\n");
        svg
    }

    /// Returns a scale, and what the picture shows, in a line of letters of this size \[m\] above
    /// the lower left corner of the picture.
    fn caption(&self, step: usize, [left, bottom]: [f64; 2], letters: f64) -> String {
        let scale = scale_of(0.12 * letters / LETTERS);
        let (x, y) = (left + letters, bottom - 0.9 * letters);
        let text = format!(
            "{scale} m · {} · {} · episode {} · {:.1} s",
            self.scenario,
            self.policy,
            self.episode,
            step as f64 * self.step_length
        );
        format!(
            "<path d=\"M{x:.2} {:.2}V{y:.2}H{end:.2}V{:.2}\" fill=\"none\" stroke=\"{OTHER}\" stroke-width=\"{:.3}\"/>\
             <text x=\"{:.2}\" y=\"{y:.2}\" font-family=\"sans-serif\" font-size=\"{letters:.3}\" fill=\"{OTHER}\">{}</text>\n",
            y - 0.4 * letters,
            y - 0.4 * letters,
            0.12 * letters,
            x + scale + 0.6 * letters,
            escaped(&text),
            end = x + scale
        )
    }
}

/// Returns the largest one of the lengths 1, 2 and 5 times a power of ten that is at most `most`.
fn scale_of(most: f64) -> f64 {
    let power = 10_f64.powf(most.log10().floor());
    [5.0, 2.0, 1.0]
        .map(|digit| digit * power)
        .into_iter()
        .find(|length| *length <= most)
        .unwrap_or(power)
}

/// Returns the path of an arrowhead before the vehicle at `to`, on a line from `from`; empty if
/// they are too close.
fn arrowhead(to: [f64; 3], from: [f64; 3], unit: f64) -> String {
    let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    let (length, gap) = (dx.hypot(dy), 3.2 * unit);
    if length.is_nan() || length < gap + 2.0 * unit {
        return String::new();
    }
    let [ux, uy] = [unit * dx / length, unit * dy / length];
    let [x, y] = [to[0] - 3.2 * ux, to[1] - 3.2 * uy];
    let wing = |side: f64| [x - 1.8 * ux + side * uy, y - 1.8 * uy - side * ux];
    let [a, b] = [wing(1.0), wing(-1.0)];
    format!("M{:.2} {:.2}L{x:.2} {y:.2}L{:.2} {:.2}", a[0], a[1], b[0], b[1])
}

fn cross(length: f64, width: f64, unit: f64) -> String {
    let (l, w) = (length / 2.0, width / 2.0);
    format!(
        "<path d=\"M-{l:.2} -{w:.2}L{l:.2} {w:.2}M-{l:.2} {w:.2}L{l:.2} -{w:.2}\" stroke=\"#000\" stroke-width=\"{:.3}\"/>",
        0.25 * unit
    )
}

#[cfg(test)]
mod tests {
    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;

    use super::super::tests::recording;

    /// Agents from route files have the sizes of their types.
    #[test]
    fn vehicles_are_drawn_with_their_own_sizes() {
        let mut recording = recording();
        let svg = recording.still(0);
        assert_eq!(svg.matches("width=\"4.50\" height=\"1.80\"").count(), 2);
        let column = super::super::Column::new("m", &[12.0, 4.5, 12.0, 4.5]);
        recording.columns.insert("length".to_owned(), column);
        let svg = recording.still(0);
        assert_eq!(svg.matches("width=\"12.00\" height=\"1.80\"").count(), 1);
        assert_eq!(svg.matches("width=\"4.50\" height=\"1.80\"").count(), 1);
    }

    #[test]
    fn scales_are_round_lengths() {
        for (most, scale) in [(0.05, 0.05), (0.9, 0.5), (1.0, 1.0), (49.0, 20.0), (999.0, 500.0)] {
            let found = super::scale_of(most);
            assert!((found - scale).abs() < 1e-9, "{most}: {found}");
        }
    }

    #[test]
    fn a_still_shows_those_who_are_there() {
        let svg = recording().still(1);
        // The picture shows one crashed agent with its cross and no other vehicle, one lane, and
        // one communication link.
        assert_eq!(svg.matches("<rect").count(), 2);
        assert!(svg.contains("stroke=\"#000\"") && svg.contains("a&lt;/script&gt;"));
        // The picture shows two agents and one vehicle of the background traffic.
        assert_eq!(recording().still(0).matches("<rect").count(), 5);
        assert!(svg.contains("#e0a800") && recording().still(0).contains("#cc2b2b"), "signals");
        assert_eq!(svg.matches("Z\" fill=\"#b9a78f\"").count(), 1, "a wall");
        assert_eq!(recording().still(99), svg, "beyond the end is the end");
        assert!(svg.contains(" · p · episode 0 · 0.1 s</text>"), "{svg}");
        // The lane is 9 m long, so that the picture is 17 m wide.
        assert!(svg.contains(">2 m · a&lt;"), "{svg}");
        assert_eq!(svg.matches("stroke-opacity=\".3\"").count(), 1, "where the first agent was");
        // At step 0 only the first agent hears the other one, which is 399 m to the east.
        let still = recording().still(0);
        let link = "M1.00 0.00L400.00 0.00M";
        assert!(still.contains(link), "the arrowhead follows the line: {still}");
        let mut recording = recording();
        recording.edges = Some(STANDARD.encode([0b10, 0b01, 0, 0]));
        assert!(recording.still(0).contains("M1.00 0.00L400.00 0.00\""), "both hear each other");
        roxmltree::Document::parse(&svg).expect("well-formed");
    }
}
