//! The TraCI client.

mod batches;
mod calls;
mod client;
mod connections;
mod json;
mod python_client;
mod sessions;
mod simulation;
mod subscriptions;
mod world;

use iwol_sumo::sumo::Error;

const NET: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/sumo_nets/intersection/arm30.net.xml");

/// Returns call, object and message of a refusal, after which the connection is usable.
fn refused<T: std::fmt::Debug>(result: Result<T, Error>) -> (String, String, String) {
    match result {
        Err(error @ Error::Refused { .. }) => {
            assert!(!error.is_fatal());
            let Error::Refused { call, id, message, .. } = error else { unreachable!() };
            (call, id, message)
        }
        other => panic!("not refused: {other:?}"),
    }
}
