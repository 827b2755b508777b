//! The device that computes the networks.

use serde::{Deserialize, Serialize};
use tch::{Cuda, Device, no_grad};

use super::decision::{ActMode, Decision, Observation};

/// The device that computes the networks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum ComputeDevice {
    /// The CPU.
    Cpu,
    /// A CUDA GPU, by its number.
    Cuda(usize),
}

impl ComputeDevice {
    /// Returns whether this is a GPU.
    pub fn is_cuda(self) -> bool {
        matches!(self, Self::Cuda(_))
    }

    /// Returns the device, if this build of libtorch sees it.
    ///
    /// # Errors
    /// [`NoDevice`].
    pub fn find(self) -> Result<Device, NoDevice> {
        match self {
            Self::Cpu => Ok(Device::Cpu),
            Self::Cuda(number) => {
                let present = Cuda::device_count().max(0) as usize;
                if number < present {
                    Ok(Device::Cuda(number))
                } else {
                    Err(NoDevice { number, present })
                }
            }
        }
    }
}

impl TryFrom<String> for ComputeDevice {
    type Error = String;

    fn try_from(name: String) -> Result<Self, String> {
        let number = match name.as_str() {
            "cpu" => return Ok(Self::Cpu),
            "cuda" => Some(0),
            _ => name.strip_prefix("cuda:").and_then(|number| number.parse().ok()),
        };
        number
            .map(Self::Cuda)
            .ok_or_else(|| format!("`{name}` is no device; write cpu, cuda or cuda:<number>"))
    }
}

impl From<ComputeDevice> for String {
    fn from(device: ComputeDevice) -> Self {
        match device {
            ComputeDevice::Cpu => "cpu".to_owned(),
            ComputeDevice::Cuda(number) => format!("cuda:{number}"),
        }
    }
}

/// The requested device does not exist.
#[derive(Debug, thiserror::Error)]
#[error(
    "there is no device cuda:{number}: libtorch sees {present}; `scripts/bootstrap --gpu` installs a libtorch with CUDA, and \
     `iwol doctor` says what it sees"
)]
pub struct NoDevice {
    number: usize,
    present: usize,
}

/// Makes one decision without gradients, on the device that holds the networks.
pub(super) fn act_on(
    device: Device,
    input: &Observation,
    mode: &ActMode,
    act: impl Fn(&Observation, &ActMode) -> Decision,
) -> Decision {
    no_grad(|| {
        if device == Device::Cpu {
            return act(input, mode);
        }
        act(&input.to(device), &mode.to(device)).to(Device::Cpu)
    })
}
