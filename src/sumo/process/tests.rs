//! Tests of finding SUMO, of ports that another program has taken, and of the kept standard error.

use std::os::unix::fs::PermissionsExt as _;

use super::*;

/// Files that are or are not programs, in a temporary folder.
struct Files(tempfile::TempDir);

impl Files {
    fn new() -> Self {
        Files(tempfile::tempdir().unwrap())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn write(&self, name: &str, text: &str, mode: u32) -> PathBuf {
        let file = self.path(name);
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(&file, text).unwrap();
        fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
        file
    }

    /// Returns the installation for environment variables, whose values are lists of paths.
    fn find(&self, variables: &[(&str, &[&str])]) -> Result<Installation, Error> {
        Installation::find_by(|name| {
            let (_, paths) = variables.iter().find(|(variable, _)| *variable == name)?;
            Some(std::env::join_paths(paths.iter().map(|path| self.path(path))).unwrap())
        })
    }
}

/// The script of a Python package, as pip writes it.
const WHEEL: &str = "#!/venv/bin/python3\nimport sys\nfrom sumo import sumo\nsys.exit(sumo())\n";

#[test]
fn sumo_home_goes_before_path_and_files_must_be_executable() {
    let files = Files::new();
    let home = files.write("home/bin/sumo", "", 0o755);
    files.write("plain/sumo", "", 0o644);
    let path = files.write("path/sumo", "", 0o755);
    let found = files.find(&[("SUMO_HOME", &["home"]), ("PATH", &["plain", "path"])]).unwrap();
    assert_eq!((found.binary(), found.reason().as_str()), (home.as_path(), "in SUMO_HOME"));
    let found = files.find(&[("PATH", &["plain", "path"])]).unwrap();
    assert_eq!((found.binary(), found.reason().as_str()), (path.as_path(), "first in PATH"));
    let found = files.find(&[("SUMO_HOME", &["none"]), ("PATH", &["path"])]).unwrap();
    assert!(found.reason().contains("none/bin"), "{}", found.reason());
    match files.find(&[("SUMO_HOME", &["none"]), ("PATH", &["plain"])]) {
        Err(Error::NotFound { looked_in, .. }) => {
            assert_eq!(looked_in, [files.path("none/bin"), files.path("plain")]);
        }
        other => panic!("{other:?}"),
    }
    assert!(files.find(&[]).unwrap_err().to_string().contains("SUMO_HOME"));
}

#[test]
fn the_real_program_is_found_behind_the_script_of_a_python_package() {
    for (site, script) in [
        ("venv/lib/python3.11/site-packages", "venv/bin/sumo"),
        ("usr/local/lib/python3.13/dist-packages", "usr/local/bin/sumo"),
        ("target", "target/bin/sumo"),
    ] {
        let files = Files::new();
        let bin = format!("{site}/sumo/bin");
        let real = files.write(&format!("{bin}/sumo"), "\x7fELF", 0o755);
        let netconvert = files.write(&format!("{bin}/netconvert"), "\x7fELF", 0o755);
        files.write(&format!("{site}/sumo/__init__.py"), "", 0o644);
        files.write(&format!("{site}/sumo/data/xsd/net_file.xsd"), "", 0o644);
        files.write(script, WHEEL, 0o755);
        // Tools such as pipx link to the script.
        fs::create_dir(files.path("path")).unwrap();
        std::os::unix::fs::symlink(files.path(script), files.path("path/sumo")).unwrap();
        let found = files.find(&[("PATH", &["path"])]).unwrap();
        assert_eq!(found.binary(), fs::canonicalize(real).unwrap());
        assert!(found.reason().contains("path/sumo") && !found.is_script(), "{}", found.reason());
        assert_eq!(found.program("netconvert").unwrap(), fs::canonicalize(netconvert).unwrap());
        assert!(found.program("netgenerate").is_err());
        let site = fs::canonicalize(files.path(site)).unwrap();
        assert_eq!((found.home(), found.site()), (Some(site.join("sumo")), Some(site)));
        // Without a script in PATH, the package is found by itself.
        let variable = if script.starts_with("target") { "PYTHONPATH" } else { "VIRTUAL_ENV" };
        let prefix = script.strip_suffix("/bin/sumo").unwrap();
        let found = files.find(&[(variable, &[prefix]), ("PATH", &["none"])]).unwrap();
        assert!(found.binary().ends_with("sumo/bin/sumo"), "{found:?}");
    }
}

#[test]
fn another_script_is_used_as_it_is() {
    let files = Files::new();
    let script = files.write("path/sumo", "#!/bin/sh\nexec /opt/sumo \"$@\"\n", 0o755);
    let found = files.find(&[("PATH", &["path"])]).unwrap();
    assert!(found.binary() == script && found.is_script());
}

/// Waits until a process is gone.
fn is_gone(pid: u32) -> bool {
    let begin = Instant::now();
    while begin.elapsed() < Duration::from_secs(10) {
        // A process that nobody waits for stays in the list, without a command line.
        let line = fs::read(format!("/proc/{pid}/cmdline"));
        if line.is_ok_and(|line| line.is_empty()) || !PathBuf::from(format!("/proc/{pid}")).exists()
        {
            return true;
        }
        thread::sleep(POLL);
    }
    false
}

/// A script that runs SUMO as a child and writes the child's number to a file.
fn wrapper(files: &Files) -> (Options, PathBuf) {
    let (real, note) = (Installation::find().unwrap(), files.path("pid"));
    let text = format!(
        "#!/bin/sh\n{} \"$@\" &\necho $! > {}\nwait\n",
        real.binary().display(),
        note.display()
    );
    (Options { binary: Some(files.write("sumo", &text, 0o755)), ..Options::default() }, note)
}

#[test]
fn a_script_that_runs_sumo_as_a_child_counts_as_sumo_and_leaves_none() {
    let files = Files::new();
    let (mut options, note) = wrapper(&files);
    let (_net, arguments) = empty_net().unwrap();
    options.arguments = arguments;
    let number = || fs::read_to_string(&note).unwrap().trim().parse::<u32>().unwrap();
    let (process, mut client, version) = Process::start(&options).unwrap();
    assert!(version.software.starts_with("SUMO"));
    let child = number();
    assert_ne!(child, process.pid());
    client.simulation_step(0.0).unwrap();
    drop(process);
    assert!(is_gone(child), "SUMO outlives its script");
    // Killed from outside, the script takes SUMO along as well.
    let (mut process, _client, _) = Process::start(&options).unwrap();
    let child = number();
    std::process::Command::new("kill")
        .args(["-KILL", &process.pid().to_string()])
        .status()
        .unwrap();
    assert!(process.exited(Duration::from_secs(10)).is_some());
    assert!(is_gone(child), "SUMO outlives its script");
}

#[test]
fn a_sumo_that_hangs_while_it_loads_is_told_from_a_slow_one() {
    let patience = Patience { idle: Duration::from_secs(1), processor: Duration::from_secs(60) };
    let run = |script: &str, patience| {
        let mut process = shell(script, free_port().unwrap());
        process.patience = patience;
        let begin = Instant::now();
        let error = process.connect(&Options::default()).map(|(_, version)| version).unwrap_err();
        (error.to_string(), begin.elapsed())
    };
    let (error, _) = run("sleep 60", patience);
    assert!(error.contains("did nothing"), "{error}");
    // Busy for longer than a SUMO may be idle, and then with last words.
    let busy = "end=$(($(date +%s) + 3)); while [ $(date +%s) -lt $end ]; do :; done; exit 3";
    let (error, time) = run(busy, patience);
    assert!(error.contains("exit status: 3") && time > patience.idle, "{error} after {time:?}");
    let endless = "while :; do :; done";
    let (error, _) = run(endless, Patience { processor: Duration::from_millis(300), ..patience });
    assert!(error.contains("processor time"), "{error}");
}

#[test]
fn a_port_that_was_lost_is_replaced() {
    let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let busy = taken.local_addr().unwrap().port();
    let mut asked = 0;
    let (_net, arguments) = empty_net().unwrap();
    let options = Options { arguments, ..Options::default() };
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
    let sumo = Installation::find().unwrap();
    let mut process = Process::spawn(&sumo, &Options::default(), busy).unwrap();
    assert!(process.exited(Duration::from_secs(20)).is_some());
    assert!(matches!(process.port_lost(), Some(Error::PortTaken { port }) if port == busy));
}

/// Runs a shell's script in place of SUMO.
fn shell(script: &str, port: u16) -> Process {
    let sh = Installation::at(&PathBuf::from("/bin/sh"), "");
    let options = Options { arguments: vec!["-c".into(), script.into()], ..Options::default() };
    Process::spawn(&sh, &options, port).unwrap()
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
    let mut process = shell("sleep 60", port);
    assert!(matches!(process.connect(&Options::default()), Err(Error::PortTaken { .. })));
    stranger.join().unwrap();
}

#[test]
fn only_the_last_lines_of_standard_error_are_kept() {
    let script = "i=0; while [ $i -lt 3000 ]; do echo line $i >&2; i=$((i+1)); done; exit 3";
    let mut process = shell(script, 1);
    match process.exited(Duration::from_secs(20)) {
        Some(Error::Exited { status, stderr_tail }) => {
            assert!(status.contains('3'), "{status}");
            assert_eq!(stderr_tail.lines().last(), Some("line 2999"));
            assert_eq!(stderr_tail.lines().count(), TAIL_LINES);
        }
        other => panic!("{other:?}"),
    }
}
