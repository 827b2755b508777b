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
//! - [`cli`]: the command line of the program `iwol`, for applications as well
//!
//! # Without libtorch
//!
//! The TraCI client, scenarios, environments and the evaluation of drivers without training need no
//! libtorch. A project that uses only them names a checkout of this repository, and turns the default
//! feature `learn` off:
//!
//! ```toml
//! [dependencies]
//! iwol-sumo = { path = "../iwol-sumo", default-features = false }
//! ```
//!
//! The feature `libsumo` adds SUMO inside the process, besides processes of its own.

// Modules that need libtorch leave themselves out of builds without the feature `learn`.
pub mod algo;
pub mod checkpoint;
pub mod cli;
pub mod config;
pub mod curves;
pub mod driving;
pub mod env;
pub mod evaluate;
mod fnv;
pub mod inspect;
mod markup;
pub mod metrics;
pub mod nn;
pub mod onnx;
pub mod plot;
pub mod provenance;
pub mod ranks;
pub mod record;
pub mod replay;
pub mod report;
pub mod rng;
pub mod rollout;
pub mod scenario;
pub mod stats;
pub mod suggest;
pub mod sumo;
pub mod sweep;
pub mod train;
pub mod words;

/// The tensors of the methods, in the version of this crate.
#[cfg(feature = "learn")]
pub use tch;

/// Runs the examples of the documentation as doctests.
#[cfg(doctest)]
#[doc = include_str!("../docs/guide/traci_client.md")]
struct TraciClient;
