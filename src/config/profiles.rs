//! Profiles: sizes of rollouts and updates with which a kind of machine is busy.
//!
//! More cores get more parts of the same minibatch. Larger minibatches do not pay on CPUs, whose
//! time is that of the arithmetic, and 16 times as large ones do not learn with these schedules
//! (docs/lab/speed.md#larger-minibatches); a GPU gets four times as large ones, because it waits
//! for the start of each operation otherwise.

use super::Config;
use crate::algo::ComputeDevice;

/// Sizes with which a kind of machine is busy. They replace defaults; presets, files, `--set` and
/// flags override them. Together with a named preset, which is for a purpose on any machine, only
/// the device and the shards count.
#[derive(Debug)]
pub struct Profile {
    /// Name on the command line and in files.
    pub name: &'static str,
    /// The machines for which it is meant.
    pub machines: &'static str,
    /// Factor of the number of worlds and of the samples per minibatch. Rollouts hold as many
    /// steps, and the learning rate grows with the factor's square root.
    scale: u32,
    /// Number of parts of a minibatch, and at most of a step's decisions, that are processed at the
    /// same time.
    shards: usize,
    device: ComputeDevice,
}

/// Number of cores from which a machine counts as a workstation.
const WORKSTATION_CORES: usize = 8;
/// Least number of samples per shard unless the number of shards is given. A guess: what smaller
/// parts cost has not been measured.
const LEAST_SHARD: usize = 256;

/// All profiles. The first one has the declared defaults.
pub const PROFILES: [Profile; 3] = [
    Profile {
        name: "laptop",
        machines: "up to 7 cores",
        scale: 1,
        shards: 2,
        device: ComputeDevice::Cpu,
    },
    Profile {
        name: "workstation",
        machines: "8 cores or more",
        scale: 1,
        shards: 8,
        device: ComputeDevice::Cpu,
    },
    Profile {
        name: "gpu",
        machines: "a GPU with CUDA",
        scale: 4,
        shards: 1,
        device: ComputeDevice::Cuda(0),
    },
];

impl Profile {
    /// The settings that profiles change.
    pub(super) const SETTINGS: [&str; 6] = [
        "device",
        "ppo.learning_rate",
        "ppo.minibatch",
        "ppo.shards",
        "train.envs",
        "train.rollout_steps",
    ];

    /// Returns the profile called `name`.
    pub fn named(name: &str) -> Option<&'static Self> {
        PROFILES.iter().find(|profile| profile.name == name)
    }

    /// Returns the profile for this machine.
    pub fn of_this_machine() -> &'static Self {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let [laptop, workstation, gpu] = &PROFILES;
        match () {
            () if gpu.device.find().is_ok() => gpu,
            () if cores >= WORKSTATION_CORES => workstation,
            () => laptop,
        }
    }
}

impl Config {
    /// Takes over a profile's device and number of shards.
    pub(super) fn use_cores(&mut self, profile: &Profile) {
        self.learner.ppo.shards = profile.shards;
        self.device = profile.device;
    }

    /// Takes over a profile's sizes.
    pub(super) fn use_sizes(&mut self, profile: &Profile) {
        let scale = profile.scale as usize;
        self.train.envs *= scale;
        self.train.rollout_steps /= scale;
        let ppo = &mut self.learner.ppo;
        ppo.minibatch *= scale;
        ppo.learning_rate *= f64::from(profile.scale).sqrt();
    }

    /// Leaves out shards for which a minibatch has too few samples.
    pub(super) fn follow_minibatch(&mut self) {
        let ppo = &mut self.learner.ppo;
        ppo.shards = ppo.shards.min(ppo.minibatch / LEAST_SHARD).max(1);
    }
}
