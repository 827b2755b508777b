//! What a learner must know about an environment: its sizes and the names of its features.

use serde::{Deserialize, Serialize};

/// What a learner must know about an environment. Only [`EnvSpec::agents`] depends on the number of
/// vehicles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct EnvSpec {
    /// Number of agent slots N.
    pub agents: usize,
    /// What an agent can do.
    pub actions: ActionSpace,
    /// The O features of one agent's observation.
    pub observation: Features,
    /// The S features of the privileged state as seen from one agent.
    pub state: Features,
    /// Largest number of other agents that an agent can hear at a time; `None` if it may hear all
    /// of them. Where it is much smaller than the number of agents, methods can save time.
    pub most_heard: Option<usize>,
    /// Metrics of an episode that the environment defines by itself.
    pub metrics: Vec<OwnMetric>,
}

/// A metric of an episode that an environment defines by itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OwnMetric {
    /// Name in tables, reports and JSON outputs.
    pub name: &'static str,
    /// Which values are better.
    pub better: Better,
    /// Which values are possible.
    pub values: Values,
    /// What it means, with its unit, in a sentence for reports; may be empty.
    pub meaning: &'static str,
}

/// Which values of a metric are possible.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Values {
    /// All numbers.
    #[default]
    Any,
    /// Numbers from 0 on.
    Positive,
    /// Shares from 0 to 1, which people see in percent.
    Rate,
}

impl OwnMetric {
    /// Returns a metric whose values are numbers of any kind.
    pub const fn new(name: &'static str, better: Better) -> Self {
        Self { name, better, values: Values::Any, meaning: "" }
    }

    /// Returns a metric whose values are counts or other numbers from 0 on.
    pub const fn count(name: &'static str, better: Better) -> Self {
        Self { name, better, values: Values::Positive, meaning: "" }
    }

    /// Returns a metric whose values are shares from 0 to 1.
    pub const fn rate(name: &'static str, better: Better) -> Self {
        Self { name, better, values: Values::Rate, meaning: "" }
    }

    /// Returns the same metric with a sentence that says what it means.
    #[must_use]
    pub const fn meaning(self, meaning: &'static str) -> Self {
        Self { meaning, ..self }
    }
}

/// Which values of a metric are better.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Better {
    /// Higher values.
    Higher,
    /// Lower values.
    Lower,
    /// Neither: the metric describes the episodes.
    #[default]
    Neither,
}

impl Default for ActionSpace {
    fn default() -> Self {
        Self::Continuous(Vec::new())
    }
}

/// What an agent can do.
#[derive(Debug, Clone, PartialEq)]
pub enum ActionSpace {
    /// An action is A numbers, each in -1..=1.
    Continuous(Vec<ActionDimension>),
    /// An action is one of K choices with these names, by its number. [`Frame::available`] says
    /// which ones are open.
    ///
    /// [`Frame::available`]: super::Frame::available
    Discrete(Vec<&'static str>),
}

impl ActionSpace {
    /// Returns how many numbers an action is: A, or 1 for the number of a choice.
    pub fn len(&self) -> usize {
        match self {
            Self::Continuous(dimensions) => dimensions.len(),
            Self::Discrete(_) => 1,
        }
    }

    /// Returns whether an action is nothing.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the number K of choices of a discrete action; `None` for a continuous one.
    pub fn choices(&self) -> Option<usize> {
        match self {
            Self::Continuous(_) => None,
            Self::Discrete(names) => Some(names.len()),
        }
    }

    /// Returns of each number of an action whether its exploration noise may last.
    pub fn noise_lasts(&self) -> Vec<bool> {
        match self {
            Self::Continuous(dimensions) => dimensions.iter().map(|one| one.noise_lasts).collect(),
            Self::Discrete(_) => vec![false],
        }
    }

    /// Returns with how many numbers networks read an action: A, or K.
    pub fn encoded(&self) -> usize {
        self.choices().unwrap_or_else(|| self.len())
    }

    /// Returns the names of an action's numbers.
    pub fn names(&self) -> Vec<&'static str> {
        match self {
            Self::Continuous(dimensions) => dimensions.iter().map(|one| one.name).collect(),
            Self::Discrete(_) => vec!["choice"],
        }
    }
}

impl From<Vec<ActionDimension>> for ActionSpace {
    fn from(dimensions: Vec<ActionDimension>) -> Self {
        Self::Continuous(dimensions)
    }
}

/// One dimension of the agents' actions, and the initial behaviour of an untrained policy in it.
#[derive(Debug, Clone, PartialEq)]
pub struct ActionDimension {
    /// Name, such as `throttle`.
    pub name: &'static str,
    /// Mean action of an untrained policy.
    pub initial_mean: f32,
    /// Factor on the scheduled standard deviation of the exploration noise.
    pub noise_scale: f32,
    /// Whether exploration noise lasts where `exploration.correlation` asks for it. Otherwise it is
    /// independent from step to step.
    pub noise_lasts: bool,
    /// Index of the observation feature that repeats this number of the agent's last action, clipped
    /// to -1..=1; `None` if agents do not observe it. A training panics if there is no such feature.
    pub feature: Option<usize>,
}

impl ActionDimension {
    /// Returns a dimension with an initial mean of 0 and the scheduled noise.
    pub const fn named(name: &'static str) -> Self {
        Self { name, initial_mean: 0.0, noise_scale: 1.0, noise_lasts: true, feature: None }
    }
}

/// A vector of named features, in groups that attention encoders take as tokens.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Features {
    /// The features, in order.
    pub list: Vec<Feature>,
    /// Consecutive groups that cover the list.
    pub groups: Vec<Group>,
    /// Whether perceptrons begin with a layer normalisation over the features (MAPPO's feature
    /// normalisation). It takes their mean and their scale away, and so most of what a few features
    /// say: of two, only which is larger.
    pub normalised: bool,
}

/// One number of an observation or a privileged state.
#[derive(Debug, Clone, PartialEq)]
pub struct Feature {
    /// Name, such as `neighbour_0.forward`.
    pub name: String,
    /// What one unit of the number means, such as `22.2 m/s`.
    pub unit: String,
    /// Smallest value.
    pub low: f32,
    /// Largest value.
    pub high: f32,
}

/// Name, unit, smallest and largest value of a feature, such as
/// `("speed", "10 m/s", 0.0, 1.0)`.
pub type Described = (&'static str, &'static str, f32, f32);

/// `count` tokens of `width` features each, starting at `offset`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Group {
    /// Name, such as `neighbour`.
    pub name: String,
    /// Index of the first feature.
    pub offset: usize,
    /// Features per token.
    pub width: usize,
    /// Number of tokens.
    pub count: usize,
    /// Index within the token of the feature that is 1 for a token that describes something and 0
    /// for padding; `None` for tokens without padding.
    pub presence: Option<usize>,
}

/// Returns how the names of the numbers of a part of a policy, `theirs`, differ from those that the
/// task defines, `ours`; `None` if they do not.
pub fn names_differ<T: AsRef<str>>(part: &str, theirs: &[T], ours: &[T]) -> Option<String> {
    if theirs.len() != ours.len() {
        return Some(format!(
            "the policy has {} numbers of {part}; the task and its settings define {}",
            theirs.len(),
            ours.len()
        ));
    }
    let mut pairs = theirs.iter().zip(ours).map(|(theirs, ours)| (theirs.as_ref(), ours.as_ref()));
    let (at, (theirs, ours)) = pairs.by_ref().enumerate().find(|(_, (one, other))| one != other)?;
    Some(format!(
        "number {at} of {part} is `{theirs}`; by the task and its settings it is `{ours}`"
    ))
}

impl Features {
    /// Number of features.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// Whether there are no features.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Returns the names of the features, in order.
    pub fn names(&self) -> Vec<String> {
        self.list.iter().map(|feature| feature.name.clone()).collect()
    }

    /// Returns one group of features, each of which is there once.
    pub fn of(name: &str, features: &[Described]) -> Self {
        let mut all = Self::default();
        all.push(name, 1, features);
        all
    }

    /// Returns these features followed by those of `other`.
    #[must_use]
    pub fn join(&self, other: &Self) -> Self {
        let mut joined = self.clone();
        let shift = self.len();
        joined.list.extend_from_slice(&other.list);
        joined.groups.extend(
            other
                .groups
                .iter()
                .map(|group| Group { offset: group.offset + shift, ..group.clone() }),
        );
        joined
    }

    /// Appends a group of `count` tokens with these features. A feature called `present` becomes
    /// the presence flag.
    pub fn push(&mut self, name: &str, count: usize, features: &[Described]) {
        if count == 0 {
            return;
        }
        let presence = features.iter().position(|f| f.0 == "present");
        self.groups.push(Group {
            name: name.to_owned(),
            offset: self.len(),
            width: features.len(),
            count,
            presence,
        });
        for token in 0..count {
            for &(feature, unit, low, high) in features {
                let name = if count == 1 {
                    format!("{name}.{feature}")
                } else {
                    format!("{name}_{token}.{feature}")
                };
                self.list.push(Feature { name, unit: unit.to_owned(), low, high });
            }
        }
    }
}
