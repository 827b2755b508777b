//! Multi-vehicle coordination in SUMO.
//!
//! Debian's SUMO simulates the traffic. This crate drives the agents' vehicles in lock-step with it
//! and trains agents that learn to coordinate: IWoL (implicit and explicit) and its baselines.
//!
//! - [`sumo`]: TraCI client, SUMO processes, nets
//! - [`scenario`]: description of a task, as data
//! - [`mod@env`]: the multi-agent environments; [`inspect`]: views and trial runs of a scenario
//! - [`nn`], [`rollout`], [`algo`]: the learners
//! - [`config`], [`train`], [`evaluate`], [`sweep`], [`checkpoint`], [`record`], [`plot`],
//!   [`report`], [`replay`]: running them
//! - [`stats`]: intervals and aggregates over seeds; [`provenance`]: the program and machine that
//!   computed a result

pub mod algo;
pub mod checkpoint;
pub mod config;
pub mod env;
pub mod evaluate;
mod fnv;
pub mod inspect;
pub mod nn;
pub mod plot;
pub mod provenance;
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

/// Runs the examples of the documentation as doctests.
#[cfg(doctest)]
#[doc = include_str!("../docs/guide/traci_client.md")]
struct TraciClient;
