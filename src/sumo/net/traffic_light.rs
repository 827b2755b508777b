//! Traffic lights of a net: their programs, and what their signals say.

use super::{Connection, Net, Path};

/// What a signal says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aspect {
    /// Red: vehicles stop (SUMO's `r`).
    Red,
    /// Red and yellow together: green comes next, and vehicles still stop (SUMO's `u`).
    RedYellow,
    /// Yellow: vehicles stop if they can (SUMO's `y` and `Y`).
    Yellow,
    /// Green for vehicles that give way to streams with priority (SUMO's `g`).
    Green,
    /// Green with priority (SUMO's `G`).
    Priority,
    /// Vehicles stop first and then give way, as at a red light with a green arrow to the right
    /// (SUMO's `s`).
    Stop,
    /// Off: the signs of the junction count (SUMO's `o` and `O`).
    Off,
}

impl Aspect {
    /// Returns what the letter of a signal in SUMO's states says.
    pub fn of(letter: u8) -> Self {
        match letter {
            b'r' => Self::Red,
            b'u' => Self::RedYellow,
            b'y' | b'Y' => Self::Yellow,
            b'g' => Self::Green,
            b'G' => Self::Priority,
            b's' => Self::Stop,
            _ => Self::Off,
        }
    }

    /// Returns what the signal with this index says in a state of its traffic light.
    pub fn in_state(state: &str, signal: usize) -> Self {
        state.as_bytes().get(signal).map_or(Self::Off, |&letter| Self::of(letter))
    }

    /// Whether a vehicle that has not stopped before the signal may not pass it.
    pub fn demands_stop(self) -> bool {
        matches!(self, Self::Red | Self::RedYellow | Self::Stop)
    }

    /// Returns what the signal says to a vehicle that has stopped before it.
    #[must_use]
    pub fn after_stop(self) -> Self {
        if self == Self::Stop { Self::Green } else { self }
    }
}

/// The signal of a connection.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Signal {
    /// Index into [`Net::traffic_lights`](super::Net::traffic_lights).
    pub traffic_light: usize,
    /// Index of the signal in the states of the traffic light.
    pub index: usize,
}

/// A traffic light with the program with which SUMO starts: the last one in the file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TrafficLight {
    /// SUMO id.
    pub id: String,
    /// Type of the program in SUMO, such as `static` or `actuated`; `off` if the program is off.
    pub kind: String,
    /// By how much the program lags behind SUMO's clock \[ms\].
    pub offset: i64,
    /// Phases; empty for programs without phases, such as those of rail signals.
    pub phases: Vec<Phase>,
}

/// A phase of a program.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Phase {
    /// Duration, above 0 \[ms\]. The phases of an actuated program may take more or less time.
    pub duration: i64,
    /// One letter for each signal.
    pub state: String,
    /// Index of the next phase, if it is not the following one.
    pub next: Option<usize>,
}

impl TrafficLight {
    /// Whether the phases always take their durations.
    pub fn is_static(&self) -> bool {
        self.kind == "static" && !self.phases.is_empty()
    }

    /// Whether the program can be started in any of its phases.
    pub fn can_start_anywhere(&self) -> bool {
        ["static", "actuated", "delay_based"].contains(&self.kind.as_str())
            && !self.phases.is_empty()
    }

    /// Returns the sum of the phases' durations \[ms\].
    pub fn cycle(&self) -> i64 {
        self.phases.iter().map(|phase| phase.duration).sum()
    }

    /// Returns the phase in which SUMO starts the program at `time` on its clock, and how long the
    /// phase still takes \[ms\].
    ///
    /// # Panics
    /// If the program has no phases.
    pub fn at(&self, time: i64) -> (usize, i64) {
        let mut passed = (time - self.offset).rem_euclid(self.cycle());
        let mut index = 0;
        while passed >= self.phases[index].duration {
            passed -= self.phases[index].duration;
            index += 1;
        }
        (index, self.phases[index].duration - passed)
    }

    /// Returns the time until a signal of a static program says something else than in `phase`,
    /// which still takes `remaining` \[ms\]; `None` if it never does, or if the program is not
    /// static.
    pub fn until_change(&self, phase: usize, remaining: i64, signal: usize) -> Option<i64> {
        if !self.is_static() {
            return None;
        }
        let says = |phase: usize| Some(Aspect::in_state(&self.phases.get(phase)?.state, signal));
        let now = says(phase)?;
        let (mut index, mut time) = (phase, remaining);
        for _ in 0..self.phases.len() {
            index = self.phases[index].next.unwrap_or((index + 1) % self.phases.len());
            if says(index)? != now {
                return Some(time);
            }
            time += self.phases[index].duration;
        }
        None
    }
}

impl Net {
    /// Returns the signals on a path of vehicles: the index of the lane at whose end the signal is,
    /// in the order of the path's lanes, and the signal.
    pub fn signals_on(&self, path: &Path) -> Vec<(usize, Signal)> {
        let pairs = path.lanes.windows(2).enumerate();
        let signal = |(index, pair): (usize, &[usize])| {
            let onto = |c: &&Connection| c.via.unwrap_or(c.to) == pair[1];
            Some((index, self.connections_from(pair[0]).find(onto)?.signal?))
        };
        pairs.filter_map(signal).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn light(offset: i64, phases: &[(i64, &str)]) -> TrafficLight {
        let phase = |&(duration, state): &(i64, &str)| Phase {
            duration,
            state: state.to_owned(),
            next: None,
        };
        TrafficLight {
            id: "a".to_owned(),
            kind: "static".to_owned(),
            offset,
            phases: phases.iter().map(phase).collect(),
        }
    }

    #[test]
    fn a_program_starts_where_its_offset_says() {
        let phases = [(15_000, "Gr"), (3_000, "yr"), (15_000, "rG"), (3_000, "ry")];
        assert_eq!(light(0, &phases).at(0), (0, 15_000));
        assert_eq!(light(0, &phases).at(36_000 + 15_100), (1, 2_900));
        assert_eq!(light(4_000, &phases).at(0), (2, 1_000), "as SUMO starts it");
        assert_eq!(light(-4_000, &phases).at(0), (0, 11_000));
    }

    #[test]
    fn the_time_to_change_passes_over_phases_in_which_the_signal_stays() {
        let mut light = light(0, &[(15_000, "Gr"), (3_000, "yr"), (2_000, "rr"), (9_000, "rG")]);
        assert_eq!(light.until_change(0, 400, 0), Some(400));
        assert_eq!(light.until_change(0, 400, 1), Some(400 + 3_000 + 2_000));
        assert_eq!(light.until_change(2, 0, 0), Some(9_000));
        light.phases[2].next = Some(1);
        assert_eq!(light.until_change(1, 100, 1), None, "always red from here on");
        light.kind = "actuated".to_owned();
        assert_eq!(light.until_change(0, 400, 0), None);
    }

    const NET: &str = "sumo_nets/signals/signals.net.xml";

    /// Reads the shipped net with other texts.
    fn read(changes: &[(&str, &str)]) -> Result<Net, String> {
        let mut text = std::fs::read_to_string(NET).unwrap();
        for (from, to) in changes {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        Net::parse(&text, std::path::Path::new(NET)).map_err(|error| error.to_string())
    }

    #[test]
    fn connections_have_their_signals() {
        let net = read(&[]).unwrap();
        assert_eq!(net.traffic_lights.len(), 1);
        assert!(net.traffic_lights[0].is_static() && net.traffic_lights[0].cycle() == 40_000);
        let path = net.route_path(&["west_in", "north_out"].map(String::from)).unwrap();
        // The left turn has two lanes over the junction, and one signal before them.
        assert_eq!(path.lanes.len(), 4);
        assert_eq!(net.signals_on(&path), [(0, Signal { traffic_light: 0, index: 11 })]);
    }

    #[test]
    fn the_last_program_counts() {
        let more = "</tlLogic><tlLogic id=\"centre\" programID=\"b\" offset=\"1.5\" type=\"actuated\">\
                    <phase minDur=\"7\" state=\"GGGGGGGGGGGG\" next=\"0\"/></tlLogic>";
        let net = read(&[("</tlLogic>", more)]).unwrap();
        let [light] = &net.traffic_lights[..] else { panic!("{:?}", net.traffic_lights) };
        assert_eq!((light.kind.as_str(), light.offset), ("actuated", 1500));
        let state = "GGGGGGGGGGGG".to_owned();
        assert_eq!(light.phases, [Phase { duration: 7000, state, next: Some(0) }]);
        let off = "</tlLogic><tlLogic id=\"centre\" programID=\"off\" type=\"static\"/>";
        assert_eq!(read(&[("</tlLogic>", off)]).unwrap().traffic_lights[0].kind, "off");
    }

    #[test]
    fn rail_crossings_make_their_own_traffic_lights() {
        let light = [("<tlLogic id=\"centre\"", "<tlLogic id=\"other\"")];
        let unknown = read(&light).unwrap_err();
        assert!(unknown.contains("tl=`centre` names nothing in this net"), "{unknown}");
        let rail = ("type=\"traffic_light\"", "type=\"rail_crossing\"");
        let net = read(&[light[0], rail, ("linkIndex=\"3\"", "linkIndex=\"-1\"")]).unwrap();
        assert_eq!(net.traffic_lights[1].kind, "rail_crossing");
        let signals = net.connections.iter().filter(|c| c.signal.is_some()).count();
        assert_eq!(signals, 11, "the index -1 is no signal");
    }

    #[test]
    fn programs_that_do_not_fit_are_refused() {
        let refused = |from: &str, to: &str| read(&[(from, to)]).unwrap_err();
        let short = refused("state=\"rrrrrrrrrrrr\"", "state=\"rrrrrrrrrrr\"");
        assert!(short.contains("`11` is not a valid linkIndex"), "{short}");
        let next = refused("state=\"rrrrrrrrrrrr\"", "state=\"rrrrrrrrrrrr\" next=\"6\"");
        assert!(next.contains("`6` is not a valid next of <phase>"), "{next}");
        let short = refused("duration=\"2\"", "duration=\"0\"");
        assert!(short.contains("`0` is not a valid duration of <phase>"), "{short}");
    }
}
