//! Files are never lost: outputs of the executables beside existing files, inputs and the user's
//! folders, and what an interruption, a full disk or a folder that is not writable leaves.
#![allow(missing_docs, clippy::unwrap_used, clippy::disallowed_methods)]

use node_kit::convert;
use rig_model::topics;
use rig_simulator::RIG_YAML;
use rustix::process::{Pid, Signal, kill_process};
use std::{
    fs,
    os::unix::fs::symlink,
    path::Path,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};
use test_support::place::{Place, Ran, names};
use volant_test::live::{Scenario, bag::from_sensors, processes::executables};

/// Makes a folder with a recording and its rig file.
fn recorded(seconds: f64) -> Place {
    let place = Place::with_rig(RIG_YAML);
    let scenario = Scenario::swing(3, seconds).unwrap();
    let topic = topics::absolute::CLIMBER_TRANSFORM;
    from_sensors(&place.path("in.mcap"), &scenario, topic, |sample| {
        convert::climber_message(sample, &scenario.rig.frames)
    })
    .unwrap();
    place
}

/// Words of a replay of the recording to a bag, and further words.
fn replay(out: &str) -> String {
    format!("replay in.mcap --rig rig.yaml --out {out}")
}

fn spawn(command: &mut Command) -> Child {
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
}

#[test]
fn a_replay_replaces_a_file_only_on_request_and_never_an_input() {
    let place = recorded(3.0);
    place.done(&replay("out.mcap"));
    let replayed = place.read("out.mcap");
    let [bag, rig] = ["in.mcap", "rig.yaml"].map(|name| place.read(name));
    place.write("out.mcap", "former");
    place.fails(&replay("out.mcap"), &["exists already", "--overwrite"]);
    assert_eq!(place.read("out.mcap"), b"former");
    place.done(&replay("out.mcap --overwrite"));
    assert!(place.read("out.mcap") == replayed);
    symlink(place.path("in.mcap"), place.path("soft.mcap")).unwrap();
    fs::hard_link(place.path("in.mcap"), place.path("hard.mcap")).unwrap();
    fs::hard_link(place.path("rig.yaml"), place.path("rig.mcap")).unwrap();
    for name in ["in.mcap", "soft.mcap", "hard.mcap", "rig.mcap"] {
        let words = [name, "the output is the input"];
        place.fails(&replay(&format!("{name} --overwrite")), &words);
    }
    // A member of the input folder.
    fs::create_dir(place.path("bag")).unwrap();
    place.done("bag recover in.mcap --out bag/bag_0.mcap");
    let member = place.read("bag/bag_0.mcap");
    let words = ["bag_0.mcap", "the output is the input"];
    place.fails("bag recover bag --out bag/bag_0.mcap --overwrite", &words);
    assert!(place.read("bag/bag_0.mcap") == member);
    // A folder is an output too, and is never replaced.
    place.done(&replay("folder"));
    place.fails(&replay("folder --overwrite"), &["is a folder"]);
    assert!(place.path("folder/folder_0.mcap").is_file());
    // A failure leaves nothing.
    place.write("wrong.yaml", "/pose_fusoin: {ros__parameters: {model: paper}}");
    let words = ["`/pose_fusoin` matches no node", "`pose_fusion`"];
    place.fails(&replay("new.mcap --params-file wrong.yaml"), &words);
    assert!(place.read("in.mcap") == bag && place.read("rig.yaml") == rig);
    assert!(place.names().iter().all(|n| !n.contains("partial") && n != "new.mcap"));
}

#[test]
fn an_evaluation_replaces_a_file_only_on_request_and_never_an_input() {
    let place = recorded(3.0);
    place.done(&replay("out.mcap"));
    let evaluate = |csv: &str| format!("evaluate out.mcap --truth in.mcap --csv {csv}");
    place.done(&evaluate("out.csv"));
    let table = place.read("out.csv");
    place.write("out.csv", "former");
    place.fails(&evaluate("out.csv"), &["out.csv", "exists already", "--overwrite"]);
    place.fails(&evaluate("out.csv --report page.html"), &["out.csv"]);
    assert!(!place.path("page.html").exists());
    assert_eq!(place.read("out.csv"), b"former");
    for input in ["out.mcap", "in.mcap"] {
        let over_input = evaluate(&format!("out.csv --overwrite --json {input}"));
        place.fails(&over_input, &["the output is the input"]);
    }
    assert_eq!(place.read("out.csv"), b"former");
    place.done(&evaluate("out.csv --overwrite --report page.html"));
    assert!(place.read("out.csv") == table && place.path("page.html").is_file());
    place.fails(&evaluate("/proc/out.csv"), &["/proc/out.csv: cannot be written"]);
}

#[test]
fn a_full_disk_leaves_the_former_file() {
    let place = recorded(3.0);
    let disk = place.path("disk");
    fs::create_dir(&disk).unwrap();
    let disk = disk.display();
    let mount = format!("mount -t tmpfs -o size=16k none {disk}");
    let inside = |script: &str| Command::new("unshare").args(["-rm", "sh", "-c", script]).output();
    match inside(&mount) {
        Ok(output) if output.status.success() => {}
        other => return test_support::skip(format!("no disk can be mounted here: {other:?}")),
    }
    let script = format!(
        "{mount} && cd {disk} && echo former > out.mcap || exit 77; {volant} replay {bag} \
         --rig {rig} --out out.mcap --overwrite >&2; status=$?; cat *; exit $status",
        volant = executables().join("volant").display(),
        bag = place.path("in.mcap").display(),
        rig = place.path("rig.yaml").display(),
    );
    let ran = Ran::from(inside(&script).unwrap());
    ran.failed_with(&["out.mcap", "No space left on device", "the space on the disk"]);
    assert_eq!(ran.out, "former\n", "nothing else is left");
}

/// `nohup` ignores SIGHUP, and so does what it starts.
#[test]
fn a_replay_that_was_started_to_ignore_a_hangup_goes_on() {
    let place = recorded(60.0);
    let replay = place.command(&replay("out.mcap --smooth"));
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]).arg(replay.get_program());
    command.args(replay.get_args()).current_dir(place.folder());
    let (status, stderr) = signaled(place.folder(), spawn(&mut command), Signal::HUP);
    assert_eq!(status, Some(0), "{stderr}");
    assert_eq!(place.names(), ["in.mcap", "out.mcap", "rig.yaml"]);
}

/// Interrupts a replay as soon as it writes, and returns its exit status and standard error.
fn interrupted(place: &Place, signal: Signal, out: &str) -> (Option<i32>, String) {
    signaled(place.folder(), spawn(&mut place.command(&replay(out))), signal)
}

/// Signals a process as soon as it writes in a folder.
fn signaled(folder: &Path, child: Child, signal: Signal) -> (Option<i32>, String) {
    let deadline = Instant::now() + Duration::from_secs(20);
    while !names(folder).iter().any(|name| name.ends_with(".partial")) {
        assert!(Instant::now() < deadline, "it does not write");
        std::thread::sleep(Duration::from_millis(1));
    }
    let id = Pid::from_raw(i32::try_from(child.id()).unwrap()).unwrap();
    kill_process(id, signal).unwrap();
    let ran = Ran::from(child.wait_with_output().unwrap());
    (ran.status, ran.err)
}

#[test]
fn an_interrupted_replay_leaves_the_former_file_and_reports_it() {
    let place = recorded(60.0);
    let (status, stderr) = interrupted(&place, Signal::TERM, "out.mcap --smooth");
    assert_eq!(status, Some(143), "{stderr}");
    assert!(stderr.contains("interrupted") && stderr.contains("out.mcap was not written"));
    assert_eq!(place.names(), ["in.mcap", "rig.yaml"]);
    // A terminal that is closed.
    let (status, stderr) = interrupted(&place, Signal::HUP, "out.mcap --smooth");
    assert_eq!(status, Some(129), "{stderr}");
    assert_eq!(place.names(), ["in.mcap", "rig.yaml"]);
    place.write("out.mcap", "former");
    let (status, stderr) = interrupted(&place, Signal::INT, "out.mcap --smooth --overwrite");
    assert_eq!(status, Some(130), "{stderr}");
    assert!(stderr.contains("out.mcap is the former one"), "{stderr}");
    assert_eq!(place.read("out.mcap"), b"former");
    assert_eq!(place.names(), ["in.mcap", "out.mcap", "rig.yaml"]);
}

#[test]
fn a_folder_of_the_users_is_left_alone_by_the_simulated_rig() {
    let place = Place::new();
    let out = place.folder().display();
    for name in ["bag/metadata.yaml", "01/notes.txt", "rig.yaml"] {
        fs::create_dir_all(place.path(name).parent().unwrap()).unwrap();
        place.write(name, "mine");
    }
    for command in ["demo", "soak", "faults", "hosts"] {
        let words = ["not from an earlier run", "nothing is removed"];
        place.fails(&format!("{command} --out {out}"), &words);
    }
    // Nor is a table replaced, or written over an input.
    let table = format!("--table {out}/rig.yaml");
    place.fails(&format!("faults {table}"), &["rig.yaml", "exists already"]);
    let words = ["rig.yaml", "the output is the input"];
    place.fails(&format!("robustness --bags {out} {table} --overwrite"), &words);
    for name in ["bag/metadata.yaml", "01/notes.txt", "rig.yaml"] {
        assert_eq!(place.read(name), b"mine", "{name}");
    }
}

#[test]
fn a_name_that_nothing_has_and_a_table_without_a_folder_are_errors_before_the_work() {
    let place = Place::new();
    let here = place.folder().display();
    fs::create_dir(place.path("run")).unwrap();
    for name in ["run/in.mcap", "run/truth.mcap"] {
        place.write(name, "");
    }
    for (arguments, named) in [
        (format!("faults --out {here}/out --only no-such-row"), "--only no-such-row"),
        (format!("hosts --out {here}/out --only no-such-row"), "--only no-such-row"),
        ("checks --fault no-such-fault".to_owned(), "--fault no-such-fault"),
        ("checks --only no-such-recording".to_owned(), "no-such-recording"),
        (format!("robustness --bags {here} --only no-such-recording"), "no-such-recording"),
        (format!("robustness --bags {here} --markers {here}/no"), "run.mcap is not there"),
        (format!("faults --out {here}/out --table {here}/no/table.md"), "table.md"),
        (format!("hosts --out {here}/out --table {here}/no/table.md"), "table.md"),
    ] {
        place.fails(&arguments, &[named]);
    }
    assert!(!place.path("out").exists());
}

#[test]
fn simulated_runs_replace_nothing_unasked_and_none_is_left_half_written() {
    let place = Place::new();
    let out = place.folder().display();
    let simulate = |seconds: &str| format!("simulate --out {out} --runs 2 --seconds {seconds}");
    assert_eq!(place.volant(&simulate("1 --runs 0")).status, Some(2));
    assert_eq!(place.volant(&simulate(&format!("1 --seed {}", u64::MAX))).status, Some(2));
    // The second run exists: the first one is not written either.
    fs::create_dir(place.path("run_00002")).unwrap();
    place.write("run_00002/rig.yaml", "mine");
    place.fails(&simulate("1"), &["run_00002/rig.yaml", "exists already"]);
    assert_eq!(place.read("run_00002/rig.yaml"), b"mine");
    assert!(!place.path("run_00001").exists());
    place.done(&simulate("1 --overwrite"));
    let former = place.read("run_00001/in.mcap");
    let folder = place.path("run_00001");
    let child = spawn(&mut place.command(&simulate("3600 --overwrite")));
    let (status, stderr) = signaled(&folder, child, Signal::INT);
    assert_eq!(status, Some(130), "{stderr}");
    assert!(place.read("run_00001/in.mcap") == former);
    assert_eq!(names(&folder), ["in.mcap", "rig.yaml"], "nothing else is left");
}

#[test]
fn a_reproduction_keeps_other_results_and_replaces_its_own_on_request() {
    let place = Place::new();
    place.write("fig-11.csv", "mine");
    let reproduce = format!("reproduce fig-9 --out {}", place.folder().display());
    place.done(&reproduce);
    let csv = place.read("fig-9.csv");
    place.fails(&reproduce, &["fig-9.csv", "exists already"]);
    place.done(&format!("{reproduce} --overwrite"));
    assert!(place.read("fig-9.csv") == csv);
    // Another name's result in the same folder replaces the report.
    fs::remove_file(place.path("fig-9.csv")).unwrap();
    fs::remove_file(place.path("fig-9.svg")).unwrap();
    place.done(&reproduce);
    place.write("report.html", "mine");
    place.fails(&reproduce, &["exists already"]);
    assert_eq!(place.read("fig-11.csv"), b"mine");
    assert_eq!(place.names(), ["fig-11.csv", "fig-9.csv", "fig-9.svg", "report.html"]);
}
