//! An environment whose worlds are divided among the ranks.

use std::path::Path;
use std::sync::atomic::Ordering;

use super::message::{Place, Told, decoded, encoded};
use super::{Team, gather_numbers, part, part_of};
use crate::env::{
    Backdrop, EnvSpec, Environment, EpisodeRecord, Error, Frame, Picture, Stream, WorldState,
    WorldView, Worlds,
};

/// An environment of which each rank simulates a part of the worlds, and every rank sees all.
pub(crate) struct Divided {
    environment: Box<dyn Environment>,
    team: Team,
}

impl Divided {
    /// Divides an environment.
    pub(crate) fn new(environment: Box<dyn Environment>, team: &Team) -> Self {
        Self { environment, team: team.clone() }
    }

    /// Returns the stream of this rank's worlds.
    fn own(&self, stream: &Stream) -> Stream {
        let own = part(&*self.team.ranks, stream.worlds);
        let first = stream.episodes.start + own.start as u64;
        Stream { worlds: own.len(), episodes: first..stream.episodes.end, ..stream.clone() }
    }

    fn all(&self, count: usize, own: Result<Box<dyn Worlds>, Error>) -> Result<All, Error> {
        let spec = self.environment.spec();
        let mut all = All {
            own: None,
            width: spec.agents * spec.actions.len(),
            frames: vec![Frame::default(); count],
            places: Vec::new(),
            finished: Vec::new(),
            team: self.team.clone(),
        };
        all.exchange(own)?;
        Ok(all)
    }
}

impl Environment for Divided {
    fn name(&self) -> &str {
        self.environment.name()
    }

    fn spec(&self) -> &EnvSpec {
        self.environment.spec()
    }

    fn cooperation(&self) -> f64 {
        self.environment.cooperation()
    }

    fn start(&self, stream: &Stream) -> Result<Box<dyn Worlds>, Error> {
        let own = self.own(stream);
        let own = if own.worlds == 0 { Ok(none()) } else { self.environment.start(&own) };
        Ok(Box::new(self.all(stream.worlds, own)?))
    }

    fn restore(&self, stream: &Stream, states: &[WorldState]) -> Result<Box<dyn Worlds>, Error> {
        let states = &states[part(&*self.team.ranks, stream.worlds)];
        let own = self.own(stream);
        let own = if own.worlds == 0 { Ok(none()) } else { self.environment.restore(&own, states) };
        Ok(Box::new(self.all(stream.worlds, own)?))
    }

    fn backdrop(&self) -> Result<Backdrop, Error> {
        self.environment.backdrop()
    }

    fn description(&self, folder: &Path) -> std::io::Result<Option<(&'static str, String)>> {
        self.environment.description(folder)
    }
}

/// The worlds of all ranks.
struct All {
    /// This rank's; `None` until they are there.
    own: Option<Box<dyn Worlds>>,
    /// Numbers per world that its actions are, N · A.
    width: usize,
    frames: Vec<Frame>,
    places: Vec<Place>,
    finished: Vec<EpisodeRecord>,
    team: Team,
}

impl All {
    /// Tells all ranks what has come of a step, and notes what they tell.
    ///
    /// # Errors
    /// The error of this rank, or that of the first rank that has one: all ranks fail together.
    fn exchange(&mut self, own: Result<Box<dyn Worlds>, Error>) -> Result<(), Error> {
        let stop = self.team.asked.load(Ordering::Relaxed);
        let (bytes, failed) = match own {
            Ok(mut own) => {
                let finished = own.take_finished().into_iter().map(Into::into).collect();
                let bytes = encoded(Told { stop, finished, ..Told::default() }, &*own);
                self.own = Some(own);
                (bytes, None)
            }
            Err(error) => {
                let told = Told { stop, error: Some(error.to_string()), ..Told::default() };
                (encoded(told, &Nothing), Some(error))
            }
        };
        let all = self.team.ranks.all_gather(&bytes);
        self.places.clear();
        let mut others = None;
        for (rank, bytes) in all.iter().enumerate() {
            let theirs = part_of(rank, self.team.ranks.size(), self.frames.len());
            let told = decoded(bytes, &mut self.frames[theirs]);
            self.places.extend(told.worlds);
            self.finished.extend(told.finished.into_iter().map(EpisodeRecord::from));
            if told.stop {
                self.team.stop.store(true, Ordering::Relaxed);
            }
            others = others.or_else(|| Some(Error::Rank { rank, what: told.error? }));
        }
        failed.or(others).map_or(Ok(()), Err)
    }
}

impl Worlds for All {
    fn count(&self) -> usize {
        self.frames.len()
    }

    fn view(&self, e: usize) -> WorldView<'_> {
        let place = &self.places[e];
        WorldView {
            frame: &self.frames[e],
            episode: place.episode,
            step: place.step,
            phase: place.phase(),
        }
    }

    fn step(&mut self, actions: &[f32]) -> Result<(), Error> {
        let (own, width) = (part(&*self.team.ranks, self.frames.len()), self.width);
        let mut worlds = self.own.take().expect("the worlds are there");
        let stepped = worlds.step(&actions[own.start * width..own.end * width]);
        self.exchange(stepped.map(|()| worlds))
    }

    fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        std::mem::take(&mut self.finished)
    }

    fn states(&self) -> Vec<WorldState> {
        let own = self.own.as_ref().map(|own| own.states()).unwrap_or_default();
        let mut bytes = Vec::new();
        ciborium::into_writer(&own, &mut bytes).expect("memory can be written");
        let all = self.team.ranks.all_gather(&bytes);
        let of = |bytes: &Vec<u8>| -> Vec<WorldState> {
            ciborium::from_reader(&bytes[..]).expect("a message of this program")
        };
        all.iter().flat_map(of).collect()
    }

    fn picture(&self, _e: usize) -> Option<Picture> {
        None
    }

    fn counters(&self) -> Vec<(&'static str, f64)> {
        let own = self.own.as_ref().map(|own| own.counters()).unwrap_or_default();
        let values: Vec<f64> = own.iter().map(|(_, value)| *value).collect();
        let all = gather_numbers(&*self.team.ranks, &values);
        let sum = |k: usize| all.iter().skip(k).step_by(own.len()).sum();
        own.iter().enumerate().map(|(k, (name, _))| (*name, sum(k))).collect()
    }
}

/// No worlds: of a rank that could not go on, or where there are fewer worlds than ranks.
struct Nothing;

fn none() -> Box<dyn Worlds> {
    Box::new(Nothing)
}

impl Worlds for Nothing {
    fn count(&self) -> usize {
        0
    }

    fn view(&self, _e: usize) -> WorldView<'_> {
        unreachable!("there are no worlds")
    }

    fn step(&mut self, _actions: &[f32]) -> Result<(), Error> {
        Ok(())
    }

    fn take_finished(&mut self) -> Vec<EpisodeRecord> {
        Vec::new()
    }

    fn states(&self) -> Vec<WorldState> {
        Vec::new()
    }

    fn picture(&self, _e: usize) -> Option<Picture> {
        None
    }
}
