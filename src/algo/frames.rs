//! From the worlds' frames to the rows of a rollout. All policies, in training and in evaluation, get
//! their tensors from such rows ([`Observation::at`](super::Observation::at), `Batch`).

use crate::env::Worlds;
use crate::rollout::Rollout;

/// Stores the worlds' frames before decision `t` as row `t` of a rollout: observations, privileged
/// states, masks, and which agents act. Rows of worlds that `worlds` lacks stay as they are.
pub fn store_frames(worlds: &dyn Worlds, rollout: &mut Rollout, t: usize) {
    let s = rollout.sizes;
    for e in 0..worlds.count() {
        let frame = worlds.view(e).frame;
        let cell = |width| rollout.cell(t, e, width);
        let (observation, state, comm, each) =
            (cell(s.observation), cell(s.state), cell(s.agents), cell(1));
        if s.choices > 0 {
            let available = cell(s.choices);
            rollout.available[available].copy_from_slice(&frame.available);
        }
        rollout.observation[observation].copy_from_slice(&frame.observation);
        rollout.state[state].copy_from_slice(&frame.state);
        rollout.comm[comm].copy_from_slice(&frame.comm);
        rollout.active[each.clone()].copy_from_slice(&frame.active);
        rollout.start[each].copy_from_slice(&frame.start);
        if !frame.sharing.is_empty() && t < s.steps {
            rollout.sharing.resize(s.steps * s.envs * s.agents * s.agents, 0.0);
            let cell = rollout.cell(t, e, s.agents);
            rollout.sharing[cell].copy_from_slice(&frame.sharing);
        }
    }
}
