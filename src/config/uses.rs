//! What a run's settings are of use for: training, evaluating its policy, starting from that.

use super::Config;
use crate::algo;

/// Why a `--set` makes no sense in an evaluation, where it is of something that the program takes from elsewhere.
pub fn no_matter_of_evaluation(set: &str) -> Option<String> {
    let (key, _) = set.split_once('=')?;
    let where_from = match key.trim() {
        "seed" => "episodes follow from --seed",
        "algorithm" => "the method is the checkpoint's",
        "device" => "the device is --device's",
        "init_from" | "steps" => "nothing is trained",
        _ => return None,
    };
    Some(format!("{set}: has no effect in an evaluation: {where_from}"))
}

impl Config {
    /// Why nothing can be trained with these settings.
    pub fn cannot_be_trained(&self) -> Option<&'static str> {
        let disturbed = !self.channel.is_perfect();
        disturbed.then_some("[channel] is for evaluation; in training messages arrive as they were sent: leave it out")
    }

    /// Why the policy of a run with these settings cannot be used with those that are `asked` for, as far as can be told before it is trained.
    pub fn cannot_serve(&self, asked: &Self) -> Option<String> {
        let as_many = if self.env.penetration == asked.env.penetration {
            algo::check_agents(&self.algorithm, self.agents.into(), asked.agents.into())
        } else {
            // How many learn is known once the scenario is set up.
            Ok(())
        };
        let unfit =
            as_many.and_then(|()| algo::check_channel(&self.algorithm, &asked.channel)).err();
        unfit.map(|unfit| unfit.to_string())
    }
}
