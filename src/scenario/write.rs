//! Writes a scenario as XML that the reader accepts.

use std::{
    fmt::{self, Write},
    path::Path,
};

use super::{Border, Control, Intention, Lidar, NeighbourOrder, Scenario, Steering, Traffic};

impl Scenario {
    /// Returns the scenario as the text of a file, from which [`Scenario::parse`] restores the same
    /// scenario. Paths that begin with the folder of [`Scenario::path`] are written relative to it.
    pub fn to_xml(&self) -> String {
        let mut xml = String::new();
        // Writing to a string cannot fail.
        let _ = self.write(&mut xml);
        xml
    }

    fn write(&self, xml: &mut String) -> fmt::Result {
        let xsi = "xmlns:xsi=\"http://www.w3.org/2001/XMLSchema-instance\" xsi:noNamespaceSchemaLocation=\"scenario.xsd\"";
        writeln!(xml, "<?xml version=\"1.0\" encoding=\"UTF-8\"?>")?;
        writeln!(xml, "<scenario name=\"{}\" {xsi}>", escape(&self.name))?;
        writeln!(xml, "    <description>{}</description>", escape(&self.description))?;
        let a = self.agents;
        writeln!(
            xml,
            "    <agents min=\"{}\" max=\"{}\" default=\"{}\"/>",
            a.min, a.max, a.default
        )?;
        writeln!(xml, "    <routes>")?;
        for route in &self.routes {
            let (id, edges) = (escape(&route.id), escape(&route.edges.join(" ")));
            let lane = route.lane.map_or(String::new(), |lane| format!(" lane=\"{lane}\""));
            let reserved = if route.reserved { " reserved=\"true\"" } else { "" };
            write!(xml, "        <route id=\"{id}\" edges=\"{edges}\"{lane} ")?;
            write!(xml, "arrivalPos=\"{}\"{reserved}", route.arrival_pos)?;
            if route.off_lane != 1.0 {
                write!(xml, " offLane=\"{}\"", route.off_lane)?;
            }
            writeln!(xml, "/>")?;
        }
        writeln!(xml, "    </routes>\n    <nets>")?;
        let folder = self.path.parent().unwrap_or(Path::new(""));
        for net in &self.nets {
            let file = net.file.strip_prefix(folder).unwrap_or(&net.file);
            writeln!(xml, "        <net file=\"{}\">", escape(&file.to_string_lossy()))?;
            for row in &net.spawns {
                let ids = row
                    .routes
                    .iter()
                    .filter_map(|&i| self.routes.get(i))
                    .map(|route| route.id.as_str());
                let route = ids.collect::<Vec<_>>().join(" ");
                let (first, spacing, count) = (row.first, row.spacing, row.count);
                write!(xml, "            <spawn route=\"{}\" first=\"{first}\" ", escape(&route))?;
                writeln!(xml, "spacing=\"{spacing}\" count=\"{count}\"/>")?;
            }
            writeln!(xml, "        </net>")?;
        }
        writeln!(xml, "    </nets>")?;
        let v = self.vehicle;
        writeln!(
            xml,
            "    <vehicle length=\"{}\" width=\"{}\" maxSpeed=\"{}\"/>",
            v.length, v.width, v.max_speed
        )?;
        let j = self.jitter;
        writeln!(
            xml,
            "    <jitter longitudinal=\"{}\" lateral=\"{}\"/>",
            j.longitudinal, j.lateral
        )?;
        let c = &self.control;
        let mode = if c.steering.is_some() { "steering" } else { "throttle" };
        write!(
            xml,
            "    <control mode=\"{mode}\" interval=\"{}\" accel=\"{}\" drag=\"{}\" ",
            c.interval, c.accel, c.drag
        )?;
        let brake: Vec<String> = c.brake.iter().map(|(m, d)| format!("{m}:{d}")).collect();
        write!(xml, "brake=\"{}\"", brake.join(" "))?;
        if c.initial_throttle != Control::INITIAL_THROTTLE {
            write!(xml, " initialThrottle=\"{}\"", c.initial_throttle)?;
        }
        if let Some(s) = c.steering {
            write!(xml, ">\n        <steering maxAngle=\"{}\"", s.max_angle)?;
            let otherwise = Steering::default();
            for (key, value, otherwise) in [
                ("frontAxle", s.front_axle, otherwise.front_axle),
                ("rearAxle", s.rear_axle, otherwise.rear_axle),
                ("track", s.track, otherwise.track),
                ("friction", s.friction, otherwise.friction),
                ("yawInertia", s.yaw_inertia, otherwise.yaw_inertia),
            ] {
                if value != otherwise {
                    write!(xml, " {key}=\"{value}\"")?;
                }
            }
            writeln!(xml, " reverse=\"{}\"/>\n    </control>", s.reverse)?;
        } else {
            writeln!(xml, "/>")?;
        }
        let o = self.observation;
        write!(
            xml,
            "    <observation groups=\"{}\" detectionRange=\"{}\" ",
            o.groups.name(),
            o.detection_range
        )?;
        write!(xml, "neighbours=\"{}\" conflictStreams=\"{}\" ", o.neighbours, o.conflict_streams)?;
        write!(xml, "streamVehicles=\"{}\"", o.stream_vehicles)?;
        if o.neighbour_order != NeighbourOrder::default() {
            write!(xml, " neighbourOrder=\"{}\"", o.neighbour_order.name())?;
        }
        write!(xml, " intention=\"{}\"", o.intention.name())?;
        if o.intention == Intention::Signalled {
            write!(xml, " signalDistance=\"{}\"", o.signal_distance)?;
        }
        if o.encounters > 0 {
            write!(xml, " encounters=\"{}\"", o.encounters)?;
        }
        if o.foresight > 0.0 {
            write!(xml, " foresight=\"{}\"", o.foresight)?;
        }
        if o.priority_distance > 0.0 {
            write!(xml, " priorityDistance=\"{}\"", o.priority_distance)?;
        }
        if o.borders > 0.0 {
            write!(xml, " borders=\"{}\"", o.borders)?;
        }
        if o.lidar != Lidar::default() {
            write!(xml, " lidarBeams=\"{}\" lidarRange=\"{}\"", o.lidar.beams, o.lidar.range)?;
        }
        writeln!(xml, "/>")?;
        let r = self.reward;
        write!(
            xml,
            "    <reward progress=\"{}\" speed=\"{}\" arrive=\"{}\" ",
            r.progress, r.speed, r.arrive
        )?;
        write!(
            xml,
            "outOfRoad=\"{}\" crash=\"{}\" cooperation=\"{}\"",
            r.out_of_road, r.crash, r.cooperation
        )?;
        if r.share_range.is_finite() {
            write!(xml, " shareRange=\"{}\"", r.share_range)?;
        }
        writeln!(xml, "/>")?;
        let t = &self.termination;
        write!(xml, "    <termination horizon=\"{}\" wreckTime=\"{}\"", t.horizon, t.wreck_time)?;
        if t.border != Border::Line {
            write!(xml, " border=\"{}\"", t.border.name())?;
        }
        if !t.broken_lines.is_empty() {
            write!(xml, " brokenLines=\"{}\"", escape(&t.broken_lines.join(" ")))?;
        }
        writeln!(xml, "/>")?;
        writeln!(xml, "    <communication range=\"{}\"/>", self.communication.range)?;
        if self.traffic != Traffic::default() {
            let t = &self.traffic;
            write!(xml, "    <traffic penetration=\"{}\"", t.penetration)?;
            if let Some(kind) = &t.kind {
                write!(xml, " type=\"{}\"", escape(kind))?;
            }
            if !t.files.is_empty() {
                let files = t
                    .files
                    .iter()
                    .map(|file| file.strip_prefix(folder).unwrap_or(file).to_string_lossy());
                write!(xml, " files=\"{}\"", escape(&files.collect::<Vec<_>>().join(" ")))?;
            }
            writeln!(xml, " capacity=\"{}\"/>", t.capacity)?;
        }
        writeln!(xml, "</scenario>")
    }
}

/// Escapes text for an attribute or an element.
pub(super) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\t' => escaped.push_str("&#9;"),
            '\n' => escaped.push_str("&#10;"),
            '\r' => escaped.push_str("&#13;"),
            c => escaped.push(c),
        }
    }
    escaped
}
