//! Computes the actions of a policy in the worlds of an evaluation.

use rand::RngExt as _;

use super::{Knowledge, Policy, WORLDS};
use crate::env::{self, EnvSpec, Worlds};
use crate::replay::{RecordedDiagnostics, Recorder};
use crate::rng::{self, Rng, Seed};

/// A policy with a state of its own, such as a trained one.
pub trait Controller {
    /// Returns an actor that draws all its random numbers from `seed`, by episode and step.
    fn actor<'a>(&'a self, spec: &'a EnvSpec, seed: Seed) -> Box<dyn Actor + 'a>;
}

/// Chooses the actions of all worlds of an evaluation.
pub trait Actor {
    /// Forgets everything about the present worlds. The next decisions are for other worlds.
    fn begin(&mut self);

    /// Chooses the actions of all worlds, and returns diagnostics of the decision in the world
    /// `watched`.
    ///
    /// # Errors
    /// [`env::Error::Policy`] if the policy cannot choose them.
    fn act(
        &mut self,
        worlds: &dyn Worlds,
        actions: &mut [f32],
        watched: Option<usize>,
    ) -> Result<RecordedDiagnostics, env::Error>;

    /// Returns how well the policy's latent predicted its targets so far.
    fn knowledge(&self) -> Vec<Knowledge> {
        Vec::new()
    }

    /// Returns the bits that a vehicle sent per decision, of each episode so far; empty for policies
    /// without messages.
    fn message_bits(&self) -> Vec<f64> {
        Vec::new()
    }
}

/// Computes actions from frames. All randomness depends only on seed, episode and step.
pub(super) struct PolicyDriver<'a> {
    pub(super) policy: &'a Policy<'a>,
    spec: &'a EnvSpec,
    seed: Seed,
    pub(super) actions: Vec<f32>,
    pub(super) actor: Option<Box<dyn Actor + 'a>>,
    pub(super) recorder: Option<&'a mut Recorder>,
}

impl<'a> PolicyDriver<'a> {
    pub(super) fn new(
        policy: &'a Policy<'a>,
        spec: &'a EnvSpec,
        seed: Seed,
        recorder: Option<&'a mut Recorder>,
    ) -> Self {
        let actor = match policy {
            Policy::Learned(controller) => Some(controller.actor(spec, seed)),
            _ => None,
        };
        Self { policy, spec, seed, actions: Vec::new(), actor, recorder }
    }

    /// Forgets everything about the present worlds. The next decisions are for other worlds.
    pub(super) fn begin(&mut self) {
        self.actions = vec![0.0; WORLDS * self.spec.agents * self.spec.actions.len()];
        if let Some(actor) = &mut self.actor {
            actor.begin();
        }
    }

    pub(super) fn act(&mut self, worlds: &dyn Worlds) -> Result<(), env::Error> {
        let watched = self.recorder.as_ref().and_then(|recorder| recorder.watches(worlds));
        let mut diagnostics = RecordedDiagnostics::default();
        let width = self.spec.agents * self.spec.actions.len();
        match self.policy {
            Policy::Constant(action) if action.len() != self.spec.actions.len() => {
                let (found, wanted) = (action.len(), self.spec.actions.len());
                let text = format!("the constant action has {found} numbers, not {wanted}");
                return Err(env::Error::Policy(text));
            }
            Policy::Constant(action) => {
                for actions in self.actions.chunks_mut(action.len()) {
                    actions.copy_from_slice(action);
                }
            }
            Policy::Rule => worlds.follow_rule(&mut self.actions),
            Policy::Nothing => {}
            Policy::Gaussian | Policy::Uniform => {
                for (e, actions) in (0..worlds.count()).zip(self.actions.chunks_mut(width)) {
                    let view = worlds.view(e);
                    let mut rng = self.seed.index(view.episode).index(u64::from(view.step)).rng();
                    if let Some(choices) = self.spec.actions.choices() {
                        choose(&view.frame.available, choices, &mut rng, actions);
                        continue;
                    }
                    if matches!(self.policy, Policy::Gaussian) {
                        rng::fill_normal(&mut rng, actions);
                    } else {
                        actions.fill_with(|| rng.random_range(-1.0..1.0));
                    }
                }
            }
            Policy::Learned(_) => {
                let actor = self.actor.as_mut().expect("a trained policy has an actor");
                diagnostics = actor.act(worlds, &mut self.actions, watched)?;
            }
        }
        if let (Some(recorder), Some(e)) = (&mut self.recorder, watched) {
            let actions = if matches!(self.policy, Policy::Nothing) {
                &[][..]
            } else {
                &self.actions[e * width..][..width]
            };
            recorder.decide(worlds, e, actions, &diagnostics);
        }
        Ok(())
    }
}

/// Draws one of the open choices for each agent, all with the same chance. `available` is `[N, K]`.
fn choose(available: &[f32], choices: usize, rng: &mut Rng, actions: &mut [f32]) {
    for (open, action) in available.chunks_exact(choices).zip(actions) {
        let open: Vec<usize> = (0..choices).filter(|&choice| open[choice] > 0.5).collect();
        let drawn = rng::below(rng, open.len().max(1));
        *action = open.get(drawn).copied().unwrap_or(0) as f32;
    }
}
