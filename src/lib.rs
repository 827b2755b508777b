//! Multi-vehicle coordination in SUMO.
//!
//! Debian's SUMO simulates the traffic. This crate drives the agents' vehicles in lock-step with it
//! and trains agents that learn to coordinate: IWoL (implicit and explicit) and its baselines.
//!
//! - [`sumo`]: TraCI client, SUMO processes, nets
//! - [`scenario`]: description of a task, as data
//! - [`mod@env`]: the multi-agent environments; [`inspect`]: views and trial runs of a scenario
//! - `nn`, `rollout`, `algo`: the learners
//! - `config`, `train`, [`evaluate`], `sweep`, `checkpoint`, [`record`], [`plot`], `report`,
//!   [`replay`]: running them
//! - [`metrics`]: the registry of what is measured; `curves`: learning curves; [`stats`]: intervals
//!   and aggregates over seeds; [`provenance`]: the program and machine that computed a result
//!
//! # Without libtorch
//!
//! The TraCI client, scenarios, environments and the evaluation of drivers without training need no
//! libtorch. A project that uses only them turns the default feature `learn` off:
//!
//! ```toml
//! [dependencies]
//! iwol-sumo = { version = "0.2", default-features = false }
//! ```
//!
//! The feature `libsumo` adds SUMO inside the process, besides processes of its own.

pub mod env;
pub mod evaluate;
mod fnv;
pub mod inspect;
mod markup;
pub mod metrics;
pub mod plot;
pub mod provenance;
pub mod record;
pub mod replay;
pub mod rng;
pub mod scenario;
pub mod stats;
pub mod suggest;
pub mod sumo;

#[cfg(feature = "learn")]
pub mod algo;
#[cfg(feature = "learn")]
pub mod checkpoint;
#[cfg(feature = "learn")]
pub mod config;
#[cfg(feature = "learn")]
pub mod curves;
#[cfg(feature = "learn")]
pub mod nn;
#[cfg(feature = "learn")]
pub mod report;
#[cfg(feature = "learn")]
pub mod rollout;
#[cfg(feature = "learn")]
pub mod sweep;
#[cfg(feature = "learn")]
pub mod train;

/// Runs the examples of the documentation as doctests.
#[cfg(doctest)]
#[doc = include_str!("../docs/guide/traci_client.md")]
struct TraciClient;
