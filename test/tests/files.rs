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
    path::{Path, PathBuf},
    process::{Child, Command, Output, Stdio},
    time::{Duration, Instant},
};
use tempfile::TempDir;
use volant_test::live::{Scenario, bag::from_sensors, processes::executables};

fn command(words: &[&str]) -> Command {
    let mut command = Command::new(executables().join("volant"));
    command.args(words).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn volant(words: &[&str]) -> Output {
    command(words).output().unwrap()
}

/// A folder with a recording, its rig file and a replay of it with the truth.
struct Place(TempDir);

impl Place {
    fn new(seconds: f64) -> Self {
        let place = Self(TempDir::new().unwrap());
        let scenario = Scenario::swing(3, seconds).unwrap();
        let topic = topics::absolute::CLIMBER_TRANSFORM;
        from_sensors(&place.path("in.mcap"), &scenario, topic, |sample| {
            convert::climber_message(sample, &scenario.rig.frames)
        })
        .unwrap();
        fs::write(place.path("rig.yaml"), RIG_YAML).unwrap();
        place
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    fn text(&self, name: &str) -> String {
        self.path(name).into_os_string().into_string().unwrap()
    }

    fn replay(&self, out: &str, more: &[&str]) -> Command {
        let [bag, rig, out] = ["in.mcap", "rig.yaml", out].map(|name| self.text(name));
        let words = ["replay", &bag, "--rig", &rig, "--out", &out];
        command(&[&words, more].concat())
    }

    fn names(&self) -> Vec<String> {
        names(self.0.path())
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<_> =
        entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// Asserts exit status 1 and one line with these words.
fn refused(output: &Output, words: &[&str]) {
    let printed = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{printed}");
    assert_eq!(printed.lines().count(), 1, "{printed}");
    for word in words {
        assert!(printed.contains(word), "`{word}` is not in: {printed}");
    }
}

fn succeeded(output: &Output) {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

#[test]
fn a_replay_replaces_a_file_only_on_request_and_never_an_input() {
    let place = Place::new(3.0);
    succeeded(&place.replay("out.mcap", &[]).output().unwrap());
    let replayed = fs::read(place.path("out.mcap")).unwrap();
    let [bag, rig] = ["in.mcap", "rig.yaml"].map(|name| fs::read(place.path(name)).unwrap());
    fs::write(place.path("out.mcap"), "former").unwrap();
    refused(&place.replay("out.mcap", &[]).output().unwrap(), &["exists already", "--overwrite"]);
    assert_eq!(fs::read(place.path("out.mcap")).unwrap(), b"former");
    succeeded(&place.replay("out.mcap", &["--overwrite"]).output().unwrap());
    assert!(fs::read(place.path("out.mcap")).unwrap() == replayed);
    symlink(place.path("in.mcap"), place.path("soft.mcap")).unwrap();
    fs::hard_link(place.path("in.mcap"), place.path("hard.mcap")).unwrap();
    fs::hard_link(place.path("rig.yaml"), place.path("rig.mcap")).unwrap();
    for name in ["in.mcap", "soft.mcap", "hard.mcap", "rig.mcap"] {
        let output = place.replay(name, &["--overwrite"]).output().unwrap();
        refused(&output, &[name, "the output is the input"]);
    }
    // A member of the input folder.
    fs::create_dir(place.path("bag")).unwrap();
    let recovered = place.text("bag/bag_0.mcap");
    succeeded(&volant(&["bag", "recover", &place.text("in.mcap"), "--out", &recovered]));
    let member = fs::read(&recovered).unwrap();
    let words = ["bag", "recover", &place.text("bag"), "--out", &recovered, "--overwrite"];
    refused(&volant(&words), &["bag_0.mcap", "the output is the input"]);
    assert!(fs::read(&recovered).unwrap() == member);
    // A folder is an output too, and is never replaced.
    succeeded(&place.replay("folder", &[]).output().unwrap());
    refused(&place.replay("folder", &["--overwrite"]).output().unwrap(), &["is a folder"]);
    assert!(place.path("folder/folder_0.mcap").is_file());
    // A failure leaves nothing.
    fs::write(place.path("wrong.yaml"), "/pose_fusoin: {ros__parameters: {model: paper}}").unwrap();
    let params = place.text("wrong.yaml");
    let output = place.replay("new.mcap", &["--params-file", &params]).output().unwrap();
    refused(&output, &["`/pose_fusoin` matches no node", "`pose_fusion`"]);
    assert!(fs::read(place.path("in.mcap")).unwrap() == bag);
    assert!(fs::read(place.path("rig.yaml")).unwrap() == rig);
    assert!(place.names().iter().all(|n| !n.contains("partial") && n != "new.mcap"));
}

#[test]
fn an_evaluation_replaces_a_file_only_on_request_and_never_an_input() {
    let place = Place::new(3.0);
    succeeded(&place.replay("out.mcap", &[]).output().unwrap());
    let [out, truth, csv] = ["out.mcap", "in.mcap", "out.csv"].map(|name| place.text(name));
    let evaluate = |more: &[&str]| {
        volant(&[&["evaluate", &out, "--truth", &truth, "--csv", &csv], more].concat())
    };
    succeeded(&evaluate(&[]));
    let table = fs::read(&csv).unwrap();
    fs::write(&csv, "former").unwrap();
    refused(&evaluate(&[]), &["out.csv", "exists already", "--overwrite"]);
    let page = place.text("page.html");
    refused(&evaluate(&["--report", &page]), &["out.csv"]);
    assert!(!place.path("page.html").exists());
    assert_eq!(fs::read(&csv).unwrap(), b"former");
    for input in [&out, &truth] {
        refused(&evaluate(&["--overwrite", "--json", input]), &["the output is the input"]);
    }
    assert_eq!(fs::read(&csv).unwrap(), b"former");
    succeeded(&evaluate(&["--overwrite", "--report", &page]));
    assert!(fs::read(&csv).unwrap() == table && place.path("page.html").is_file());
    let nowhere = volant(&["evaluate", &out, "--truth", &truth, "--csv", "/proc/out.csv"]);
    refused(&nowhere, &["/proc/out.csv: cannot be written"]);
}

#[test]
fn a_full_disk_leaves_the_former_file() {
    let place = Place::new(3.0);
    let disk = place.text("disk");
    fs::create_dir(&disk).unwrap();
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
        bag = place.text("in.mcap"),
        rig = place.text("rig.yaml"),
    );
    let output = inside(&script).unwrap();
    refused(&output, &["out.mcap", "No space left on device", "the space on the disk"]);
    assert_eq!(output.stdout, b"former\n", "nothing else is left");
}

/// `nohup` ignores SIGHUP, and so does what it starts.
#[test]
fn a_replay_that_was_started_to_ignore_a_hangup_goes_on() {
    let place = Place::new(60.0);
    let replay = place.replay("out.mcap", &["--smooth"]);
    let mut command = Command::new("sh");
    command.args(["-c", "trap '' HUP; exec \"$@\"", "sh"]).arg(replay.get_program());
    command.args(replay.get_args()).stdout(Stdio::null()).stderr(Stdio::piped());
    let child = command.spawn().unwrap();
    let (status, stderr) = signaled(place.0.path(), child, Signal::HUP);
    assert_eq!(status, Some(0), "{stderr}");
    assert_eq!(place.names(), ["in.mcap", "out.mcap", "rig.yaml"]);
}

/// Interrupts a replay as soon as it writes, and returns its exit status and standard error.
fn interrupted(place: &Place, signal: Signal, more: &[&str]) -> (Option<i32>, String) {
    let child = place.replay("out.mcap", more).spawn().unwrap();
    signaled(place.0.path(), child, signal)
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
    let output = child.wait_with_output().unwrap();
    (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
}

#[test]
fn an_interrupted_replay_leaves_the_former_file_and_reports_it() {
    let place = Place::new(60.0);
    let (status, stderr) = interrupted(&place, Signal::TERM, &["--smooth"]);
    assert_eq!(status, Some(143), "{stderr}");
    assert!(stderr.contains("interrupted") && stderr.contains("out.mcap was not written"));
    assert_eq!(place.names(), ["in.mcap", "rig.yaml"]);
    // A terminal that is closed.
    let (status, stderr) = interrupted(&place, Signal::HUP, &["--smooth"]);
    assert_eq!(status, Some(129), "{stderr}");
    assert_eq!(place.names(), ["in.mcap", "rig.yaml"]);
    fs::write(place.path("out.mcap"), "former").unwrap();
    let (status, stderr) = interrupted(&place, Signal::INT, &["--smooth", "--overwrite"]);
    assert_eq!(status, Some(130), "{stderr}");
    assert!(stderr.contains("out.mcap is the former one"), "{stderr}");
    assert_eq!(fs::read(place.path("out.mcap")).unwrap(), b"former");
    assert_eq!(place.names(), ["in.mcap", "out.mcap", "rig.yaml"]);
}

#[test]
fn a_folder_of_the_users_is_left_alone_by_the_simulated_rig() {
    let place = TempDir::new().unwrap();
    let out = place.path().to_str().unwrap();
    for name in ["bag/metadata.yaml", "01/notes.txt", "rig.yaml"] {
        let path: &Path = &place.path().join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, "mine").unwrap();
    }
    for words in [
        &["demo", "--out", out][..],
        &["soak", "--out", out],
        &["faults", "--out", out],
        &["hosts", "--out", out],
    ] {
        refused(&volant(words), &["not from an earlier run", "nothing is removed"]);
    }
    // Nor is a table replaced, or written over an input.
    let table = place.path().join("rig.yaml");
    let table = table.to_str().unwrap();
    refused(&volant(&["faults", "--table", table]), &["rig.yaml", "exists already"]);
    let bags = place.path().to_str().unwrap();
    let words = ["robustness", "--bags", bags, "--table", table, "--overwrite"];
    refused(&volant(&words), &["rig.yaml", "the output is the input"]);
    for name in ["bag/metadata.yaml", "01/notes.txt", "rig.yaml"] {
        assert_eq!(fs::read(place.path().join(name)).unwrap(), b"mine", "{name}");
    }
}

#[test]
fn a_name_that_nothing_has_and_a_table_without_a_folder_are_errors_before_the_work() {
    let place = TempDir::new().unwrap();
    let path = |name: &str| place.path().join(name).into_os_string().into_string().unwrap();
    let paths = ["out", "no/table.md", "", "no"].map(path);
    let [out, table, bags, markers] = paths.each_ref().map(String::as_str);
    fs::create_dir(path("run")).unwrap();
    for name in ["run/in.mcap", "run/truth.mcap"] {
        fs::write(path(name), "").unwrap();
    }
    for (words, named) in [
        (vec!["faults", "--out", out, "--only", "no such row"], "--only no such row"),
        (vec!["hosts", "--out", out, "--only", "no such row"], "--only no such row"),
        (vec!["checks", "--fault", "no such fault"], "--fault no such fault"),
        (vec!["checks", "--only", "no such recording"], "no such recording"),
        (vec!["robustness", "--bags", bags, "--only", "no such recording"], "no such recording"),
        (vec!["robustness", "--bags", bags, "--markers", markers], "run.mcap is not there"),
        (vec!["faults", "--out", out, "--table", table], "table.md"),
        (vec!["hosts", "--out", out, "--table", table], "table.md"),
    ] {
        refused(&volant(&words), &[named]);
    }
    assert!(!Path::new(out).exists());
}

#[test]
fn simulated_runs_replace_nothing_unasked_and_none_is_left_half_written() {
    let place = TempDir::new().unwrap();
    let out = place.path().to_str().unwrap();
    let simulate = |more: &[&str]| {
        command(&[&["simulate", "--out", out, "--runs", "2", "--seconds"], more].concat())
    };
    assert_eq!(simulate(&["1", "--runs", "0"]).output().unwrap().status.code(), Some(2));
    let last = u64::MAX.to_string();
    assert_eq!(simulate(&["1", "--seed", &last]).output().unwrap().status.code(), Some(2));
    // The second run exists: the first one is not written either.
    let mine = place.path().join("run_00002/rig.yaml");
    fs::create_dir_all(mine.parent().unwrap()).unwrap();
    fs::write(&mine, "mine").unwrap();
    refused(&simulate(&["1"]).output().unwrap(), &["run_00002/rig.yaml", "exists already"]);
    assert_eq!(fs::read(&mine).unwrap(), b"mine");
    assert!(!place.path().join("run_00001").exists());
    succeeded(&simulate(&["1", "--overwrite"]).output().unwrap());
    let bag = place.path().join("run_00001/in.mcap");
    let former = fs::read(&bag).unwrap();
    let folder = place.path().join("run_00001");
    let child = simulate(&["3600", "--overwrite"]).spawn().unwrap();
    let (status, stderr) = signaled(&folder, child, Signal::INT);
    assert_eq!(status, Some(130), "{stderr}");
    assert!(fs::read(&bag).unwrap() == former);
    assert_eq!(names(&folder), ["in.mcap", "rig.yaml"], "nothing else is left");
}

#[test]
fn a_reproduction_keeps_other_results_and_replaces_its_own_on_request() {
    let place = TempDir::new().unwrap();
    let out = place.path().to_str().unwrap();
    fs::write(place.path().join("fig-11.csv"), "mine").unwrap();
    let reproduce = |more: &[&str]| volant(&[&["reproduce", "fig-9", "--out", out], more].concat());
    succeeded(&reproduce(&[]));
    let csv = fs::read(place.path().join("fig-9.csv")).unwrap();
    refused(&reproduce(&[]), &["fig-9.csv", "exists already"]);
    succeeded(&reproduce(&["--overwrite"]));
    assert!(fs::read(place.path().join("fig-9.csv")).unwrap() == csv);
    // Another name's result in the same folder replaces the report.
    fs::remove_file(place.path().join("fig-9.csv")).unwrap();
    fs::remove_file(place.path().join("fig-9.svg")).unwrap();
    succeeded(&reproduce(&[]));
    fs::write(place.path().join("report.html"), "mine").unwrap();
    refused(&volant(&["reproduce", "fig-9", "--out", out]), &["exists already"]);
    assert_eq!(fs::read(place.path().join("fig-11.csv")).unwrap(), b"mine");
    let names = fs::read_dir(place.path()).unwrap().count();
    assert_eq!(names, 4, "fig-9.csv, fig-9.svg, fig-11.csv and report.html");
}
