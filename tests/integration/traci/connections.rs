//! Connections and processes: the handshake, strangers on a port, termination of SUMO, and that no
//! SUMO process outlives its owner.

use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener};
use std::path::Path;
use std::process::{Command as Program, Stdio};
use std::thread;
use std::time::{Duration, Instant};

use iwol_sumo::sumo::constants::{self as c};
use iwol_sumo::sumo::process::{Installation, Options, Process};
use iwol_sumo::sumo::{Client, Error, Renewal, Simulation};

use super::simulation::{EAST, NORTH, add, speed, start};

fn lives(pid: u32) -> bool {
    // A zombie process still has a folder in `/proc`, but an empty command line.
    std::fs::read(format!("/proc/{pid}/cmdline")).is_ok_and(|line| !line.is_empty())
}

/// Waits until the process ends; returns `false` if it is still there after 10 s.
fn ends(pid: u32) -> bool {
    let start = Instant::now();
    while lives(pid) && start.elapsed() < Duration::from_secs(10) {
        thread::sleep(Duration::from_millis(2));
    }
    !lives(pid)
}

fn signal(name: &str, pid: u32) {
    let status = Program::new("kill").args([name, &pid.to_string()]).status().unwrap();
    assert!(status.success());
}

#[test]
fn the_handshake_names_the_version_and_connecting_is_quick() {
    let mut times = Vec::new();
    for _ in 0..5 {
        let begin = Instant::now();
        let simulation = start(1);
        times.push(begin.elapsed().as_millis());
        assert!(simulation.version().api >= c::MINIMUM_API_VERSION);
        assert!(simulation.version().software.starts_with("SUMO"));
    }
    println!("from nothing to the first answer: {times:?} ms");
    let version = Installation::find().unwrap().version().unwrap();
    assert_eq!(version.software, format!("SUMO {}", version.release()));
}

#[test]
fn a_killed_sumo_is_a_fatal_error_and_a_restart_begins_anew() {
    let mut simulation = start(1);
    simulation.step(&add(0, EAST, 50.0)).unwrap();
    let old = simulation.pid();
    signal("-KILL", old);
    let error = (0..3).find_map(|_| simulation.step(&[speed(0, 1.0)]).err()).expect("an error");
    assert!(matches!(&error, Error::Exited { status, .. } if status.contains('9')), "{error}");
    assert!(error.is_fatal());
    assert!(simulation.step(&[]).is_err_and(|e| e.is_fatal()));
    assert_eq!(simulation.renew().unwrap(), Renewal::Restarted);
    assert_ne!(simulation.pid(), old);
    let snapshot = simulation.step(&add(0, NORTH, 20.0)).unwrap();
    assert_eq!(snapshot.time, 0.1);
    assert_eq!(snapshot.vehicles[0].unwrap().distance, 20.0);
    // A restart between send and receive works too, and ends the old process.
    let old = simulation.pid();
    simulation.send(&[]).unwrap();
    simulation.renew().unwrap();
    assert!(!lives(old));
    assert_eq!(simulation.step(&[]).unwrap().vehicles, [None]);
}

#[test]
fn what_sumo_says_when_it_dies_is_in_the_error() {
    let arguments = ["--net-file", "no/such.net.xml"].map(Into::into).to_vec();
    match Process::start(&Options { arguments, ..Options::default() }) {
        Err(Error::Exited { stderr_tail, .. }) => {
            assert!(stderr_tail.contains("such.net.xml"), "{stderr_tail}");
        }
        other => panic!("{other:?}"),
    }
}

/// Starts a listener that answers the first bytes that it receives with `answer`.
fn impostor(answer: &'static [u8]) -> (SocketAddr, thread::JoinHandle<()>) {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let address = listener.local_addr().unwrap();
    let work = move || {
        let (mut stream, _) = listener.accept().unwrap();
        let _ = stream.read(&mut [0; 64]);
        let _ = stream.write_all(answer);
        let _ = stream.read(&mut [0; 64]);
    };
    (address, thread::spawn(work))
}

#[test]
fn a_stranger_that_speaks_something_else_is_refused() {
    let strangers: [&[u8]; 3] = [
        b"HTTP/1.1 400 Bad Request\r\n\r\n",
        b"SSH-2.0-OpenSSH_9.2\r\n",
        &[0, 0, 0, 9, 1, 2, 3, 4, 5],
    ];
    for answer in strangers {
        let (address, peer) = impostor(answer);
        let mut client = Client::connect(address, Duration::from_secs(5)).unwrap();
        let error = client.handshake().unwrap_err();
        assert!(matches!(error, Error::Protocol { .. }) && error.is_fatal(), "{error}");
        drop(client);
        peer.join().unwrap();
    }
}

#[test]
fn a_stranger_that_says_nothing_is_a_timeout() {
    let (address, peer) = impostor(b"");
    let mut client = Client::connect(address, Duration::from_millis(100)).unwrap();
    assert!(matches!(client.handshake(), Err(Error::Timeout { .. })));
    drop(client);
    peer.join().unwrap();
}

#[test]
fn an_older_traci_is_refused_with_both_numbers() {
    const ANSWER: &[u8] = &[
        0, 0, 0, 31, 7, 0, 0, 0, 0, 0, 0, 20, 0, 0, 0, 0, 19, 0, 0, 0, 10, b'S', b'U', b'M', b'O',
        b' ', b'1', b'.', b'8', b'.', b'0',
    ];
    let (address, peer) = impostor(ANSWER);
    let mut client = Client::connect(address, Duration::from_secs(5)).unwrap();
    match client.handshake() {
        Err(Error::Version { found: 19, minimum: 20, peer }) => assert_eq!(peer, "SUMO 1.8.0"),
        other => panic!("{other:?}"),
    }
    drop(client);
    peer.join().unwrap();
}

#[test]
fn a_busy_port_is_named() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let busy = listener.local_addr().unwrap().port();
    let options = Options { port: Some(busy), ..Options::default() };
    match Process::start(&options) {
        Err(error @ Error::PortTaken { port }) => {
            assert_eq!(port, busy);
            assert!(error.to_string().contains(&busy.to_string()) && error.hint().is_some());
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn nothing_listens_where_nobody_is() {
    let address = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap().local_addr().unwrap();
    assert!(matches!(Client::connect(address, Duration::from_secs(1)), Err(Error::Connect { .. })));
}

#[test]
fn no_sumo_is_left_after_a_drop() {
    let simulation = start(1);
    let pid = simulation.pid();
    assert!(lives(pid));
    drop(simulation);
    assert!(!Path::new(&format!("/proc/{pid}")).exists(), "not waited for");
}

#[test]
fn no_sumo_is_left_after_a_panic() {
    let (send, receive) = std::sync::mpsc::channel();
    let panicked = thread::spawn(move || {
        let simulation = start(1);
        send.send(simulation.pid()).unwrap();
        panic!("on purpose, with SUMO {} alive", simulation.pid());
    });
    let pid = receive.recv().unwrap();
    assert!(panicked.join().is_err());
    assert!(!Path::new(&format!("/proc/{pid}")).exists());
}

#[test]
fn sumo_outlives_the_thread_that_asked_for_it() {
    let mut simulation = thread::spawn(|| start(1)).join().unwrap();
    thread::sleep(Duration::from_millis(100));
    simulation.step(&[]).unwrap();
}

/// Environment variable that makes the test below act as the victim: the test runs itself a second
/// time with this variable, and the second run starts SUMO and waits to be killed. The value is the
/// path of the file to which the victim writes SUMO's process identifier.
const VICTIM: &str = "IWOL_TEST_VICTIM";

/// Runs the test below as a victim, kills it, and asserts that its SUMO ends.
fn kill_owner() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("pid");
    let mut victim = Program::new(std::env::current_exe().unwrap())
        .arg("no_sumo_that_loads_is_left_after_its_owner_is_killed")
        .env(VICTIM, &file)
        .stdout(Stdio::null())
        .spawn()
        .unwrap();
    let begin = Instant::now();
    let pid: u32 = loop {
        let text = std::fs::read_to_string(&file).unwrap_or_default();
        match text.strip_suffix('\n').map(str::parse) {
            Some(pid) => break pid.unwrap(),
            None => assert!(begin.elapsed() < Duration::from_secs(20), "the victim starts no SUMO"),
        }
        thread::sleep(Duration::from_millis(2));
    };
    // During `exec`, a process briefly has no command line.
    while !lives(pid) {
        assert!(begin.elapsed() < Duration::from_secs(20), "SUMO ended by itself");
        thread::sleep(Duration::from_millis(1));
    }
    victim.kill().unwrap();
    victim.wait().unwrap();
    let ended = ends(pid);
    if !ended {
        signal("-KILL", pid);
    }
    assert!(ended, "SUMO {pid} was an orphan");
}

/// Tests that a SUMO that is still loading ends with its owner. While SUMO loads, it has no
/// connection whose end it could notice; the script stands for a SUMO that never finishes loading.
#[test]
fn no_sumo_that_loads_is_left_after_its_owner_is_killed() {
    let Some(file) = std::env::var_os(VICTIM) else {
        return kill_owner();
    };
    let script = "echo $$ > \"$0\"; exec sleep 60";
    let arguments = vec!["-c".into(), script.into(), file];
    let options = Options { binary: Some("/bin/sh".into()), arguments, ..Options::default() };
    panic!("{:?}", Process::start(&options));
}
