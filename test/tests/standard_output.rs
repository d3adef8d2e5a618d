//! Commands and manual of all executables together.
#![allow(clippy::unwrap_used)]

use std::process::Command;
use test_support::place::Place;

#[test]
fn the_help_of_volant_lists_the_commands_of_all_executables() {
    let folder = volant_test::live::processes::executables();
    let printed = |name: &str, words: &[&str]| {
        let output = Command::new(folder.join(name)).args(words).output().unwrap();
        assert!(output.status.success(), "{name}: {output:?}");
        String::from_utf8_lossy(&output.stdout).into_owned()
    };
    let help = printed("volant", &["--help"]);
    let commands = |help: &str, from: &str| -> Vec<String> {
        let rows = help.split(from).nth(1).unwrap().lines().skip(1);
        rows.take_while(|row| !row.is_empty())
            .filter_map(|row| Some(row.strip_prefix("  ")?.split_whitespace().next()?.to_owned()))
            .collect()
    };
    let listed: Vec<String> = help
        .lines()
        .filter_map(|row| row.strip_prefix("  ").filter(|r| r.starts_with(char::is_alphabetic)))
        .filter_map(|row| Some(row.split_whitespace().next()?.to_owned()))
        .collect();
    for name in commands(&printed("volant-rig", &["--help"]), "Commands:") {
        assert!(listed.contains(&name), "{name} is not in:\n{help}");
    }
    for name in ["imu", "calibrate", "replay", "record", "up", "completions", "manual"] {
        assert!(listed.iter().any(|l| l == name), "{name} is not in:\n{help}");
    }
    let mut once = listed.clone();
    once.sort();
    once.dedup();
    assert_eq!(once.len(), listed.len(), "{help}");
    // What is listed and here runs, prints its help, and completes.
    let completions = printed("volant", &["completions", "bash"]);
    for name in listed.iter().filter(|name| *name != "calibrate" && *name != "help") {
        assert!(printed("volant", &["help", name]).contains("Usage") || *name == "up", "{name}");
        assert!(completions.contains(&format!("volant,{name})")), "{name} is not completed");
    }
    for words in
        ["130  interrupted by SIGINT", "143  ended by SIGTERM", "2    the command line is wrong"]
    {
        assert!(help.contains(words), "{help}");
    }
}

#[test]
fn the_manual_has_a_page_for_each_command_and_replaces_none_unasked() {
    let place = Place::new();
    place.done("manual --out man");
    for (page, words) in [
        ("volant.1", "EXIT STATUS"),
        ("volant-replay.1", "overwrite"),
        ("volant-imu-decode.1", "csv"),
        ("volant-demo.1", "seed"),
        ("volant-calibrate-rig.1", "EXIT STATUS"),
    ] {
        let text = place.text(&format!("man/{page}"));
        assert!(text.contains(words) && text.starts_with(".ie"), "{page}: {text}");
    }
    let refused = place.failed("manual --out man");
    assert!(refused.contains("exists already") && refused.trim().lines().count() == 1, "{refused}");
    place.done("manual --out man --overwrite");
}
