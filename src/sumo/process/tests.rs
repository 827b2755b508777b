//! Tests of finding SUMO, of ports that another program has taken, and of the kept standard error.

use super::*;

#[test]
fn sumo_home_goes_before_path_and_files_must_be_executable() {
    let folder = tempfile::tempdir().unwrap();
    let make = |name: &str, mode| {
        let bin = folder.path().join(name);
        fs::create_dir_all(&bin).unwrap();
        fs::write(bin.join("sumo"), "").unwrap();
        fs::set_permissions(bin.join("sumo"), fs::Permissions::from_mode(mode)).unwrap();
        bin
    };
    let (home, plain, path) = (make("home/bin", 0o755), make("plain", 0o644), make("path", 0o755));
    let path_value = std::env::join_paths([&plain, &path]).unwrap();
    let home_value = folder.path().join("home");
    let found = find_in("sumo", Some(home_value.as_os_str()), Some(&path_value)).unwrap();
    assert_eq!(found, home.join("sumo"));
    let found = find_in("sumo", None, Some(&path_value)).unwrap();
    assert_eq!(found, path.join("sumo"));
    match find_in("sumo", Some(OsStr::new("/nowhere")), Some(plain.as_os_str())) {
        Err(Error::NotFound { looked_in, .. }) => {
            assert_eq!(looked_in, [PathBuf::from("/nowhere/bin"), plain]);
        }
        other => panic!("{other:?}"),
    }
    assert!(find_in("sumo", None, None).unwrap_err().to_string().contains("SUMO_HOME"));
}

#[test]
fn a_port_that_was_lost_is_replaced() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let busy = taken.local_addr().unwrap().port();
    let mut asked = 0;
    let (_net, options) = empty_net().unwrap();
    let started = Process::start_on(&options, || {
        asked += 1;
        if asked <= 2 { Ok(busy) } else { free_port() }
    });
    let (process, ..) = started.unwrap();
    assert_ne!(process.port(), busy);
    assert_eq!(asked, 3);
}

#[test]
fn ports_that_are_always_lost_end_in_an_error() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let busy = taken.local_addr().unwrap().port();
    let result = Process::start_on(&Options::default(), || Ok(busy));
    assert!(matches!(result, Err(Error::PortTaken { port }) if port == busy));
}

#[test]
fn a_race_that_sumo_itself_loses_counts_as_a_lost_port() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let busy = taken.local_addr().unwrap().port();
    let mut process = Process::spawn(&find_sumo().unwrap(), &[], busy).unwrap();
    assert!(process.exited(Duration::from_secs(20)).is_some());
    assert!(matches!(process.port_lost(), Some(Error::PortTaken { port }) if port == busy));
}

#[test]
fn a_stranger_that_answers_like_sumo_is_not_mistaken_for_it() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    let stranger = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        let _ = stream.read(&mut [0; 64]);
        let answer =
            [0, 0, 0, 24, 7, 0, 0, 0, 0, 0, 0, 13, 0, 0, 0, 0, 20, 0, 0, 0, 3, b'a', b'b', b'c'];
        stream.write_all(&answer).unwrap();
        // Keeps the connection open until the other end closes it.
        let _ = stream.read(&mut [0; 64]);
    });
    let sleeper = Process::spawn(Path::new("/bin/sh"), &["-c".into(), "sleep 60".into()], port);
    let mut process = sleeper.unwrap();
    assert!(matches!(process.connect(&Options::default()), Err(Error::PortTaken { .. })));
    stranger.join().unwrap();
}

#[test]
fn only_the_last_lines_of_standard_error_are_kept() {
    let script = "i=0; while [ $i -lt 3000 ]; do echo line $i >&2; i=$((i+1)); done; exit 3";
    let mut process =
        Process::spawn(Path::new("/bin/sh"), &["-c".into(), script.into()], 1).unwrap();
    match process.exited(Duration::from_secs(20)) {
        Some(Error::Exited { status, stderr_tail }) => {
            assert!(status.contains('3'), "{status}");
            assert_eq!(stderr_tail.lines().last(), Some("line 2999"));
            assert_eq!(stderr_tail.lines().count(), TAIL_LINES);
        }
        other => panic!("{other:?}"),
    }
}
