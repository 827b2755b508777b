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

/// Whether a release of SUMO is the one that Debian 12 has, or older. Later ones mend and add calls.
fn is_old(release: &str) -> bool {
    let numbers: Vec<u32> = release.split('.').map_while(|part| part.parse().ok()).collect();
    numbers < vec![1, 16]
}

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
