//! Tests of the whole against the real SUMO, with networks that train, and through the program's
//! command line. One binary, because each links libtorch.
//!
//! Tests that kill this process's children, or measure its memory, are in the binary `failures`.

#[path = "../support.rs"]
mod support;

mod authoring;
mod background_traffic;
mod built_in;
mod calibration;
mod command_line;
mod damaged_files;
mod dependencies;
mod environments;
mod flows;
mod hosting;
mod lane_changes;
mod layers;
mod learners;
mod levels;
mod nets;
mod onnx_policies;
mod pages;
mod policies;
mod pytorch_reference;
mod ranks;
mod recordings;
mod reports;
mod resuming;
mod route_files;
mod scenario_files;
mod signals;
mod steering;
mod sweeps;
mod traci;
