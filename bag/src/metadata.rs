//! rosbag2's `metadata.yaml` (version 9): which files a folder holds, and what is in them.

use super::Topic;
use ros_parameters::ParameterValue;
use serde::Deserialize;
use std::fmt::Write;

#[derive(Deserialize)]
struct Document {
    rosbag2_bagfile_information: Folder,
}

/// The used part of a folder's `metadata.yaml`.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Folder {
    /// `mcap`, `sqlite3`, …
    pub storage_identifier: String,
    /// The files in order.
    pub relative_file_paths: Vec<String>,
    /// `` or `zstd`.
    pub compression_format: Option<String>,
    /// `file` or `message`; `None` without compression.
    pub compression_mode: Option<String>,
}

impl Folder {
    /// Parses the file's text.
    ///
    /// # Errors
    /// A description of what is wrong with the text.
    pub fn parse(text: &str) -> Result<Self, String> {
        let document: Document = ros_parameters::yaml::parse(text)
            .and_then(serde_yaml_ng::from_value)
            .map_err(|e| format!("is not valid ({e})"))?;
        let mut folder = document.rosbag2_bagfile_information;
        let mode = folder.compression_mode.map(|mode| mode.to_lowercase());
        folder.compression_mode = mode.filter(|mode| mode != "none");
        Ok(folder)
    }
}

/// Contents of one file of a bag.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FileContents {
    /// Name relative to the folder.
    pub path: String,
    /// First and last log time, ns.
    pub span: Option<(u64, u64)>,
    /// Messages of each topic, up to the last one that it has.
    pub counts: Vec<u64>,
}

impl FileContents {
    /// Messages in it.
    fn count(&self) -> u64 {
        self.counts.iter().sum()
    }
}

/// The span that covers two spans of log times.
pub(super) fn join(a: Option<(u64, u64)>, b: Option<(u64, u64)>) -> Option<(u64, u64)> {
    a.into_iter().chain(b).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
}

/// Formats `metadata.yaml`.
pub(super) fn to_yaml<'a>(
    files: &[FileContents],
    topics: impl Iterator<Item = (&'a Topic, u64)>,
) -> String {
    let span = files.iter().map(|f| f.span).fold(None, join).unwrap_or_default();
    let count: u64 = files.iter().map(FileContents::count).sum();
    let times = |indent: &str, (start, end): (u64, u64)| {
        format!(
            "{indent}duration:\n{indent}  nanoseconds: {}\n{indent}starting_time:\n{indent}  \
             nanoseconds_since_epoch: {start}\n",
            end - start
        )
    };
    let mut out =
        String::from("rosbag2_bagfile_information:\n  version: 9\n  storage_identifier: mcap\n");
    out += &times("  ", span);
    // Writing to a string cannot fail.
    let _ = writeln!(out, "  message_count: {count}");
    out += "  topics_with_message_count:";
    let mut none = true;
    for (topic, count) in topics {
        none = false;
        let _ = write!(
            out,
            "\n    - topic_metadata:\n        name: {}\n        type: {}\n        \
             serialization_format: {}\n        offered_qos_profiles:",
            quoted(&topic.name),
            quoted(&topic.type_name),
            quoted(&topic.message_encoding)
        );
        match profiles(&topic.offered_qos_profiles) {
            Some(list) => {
                for line in list.lines() {
                    let _ = write!(out, "\n          {line}");
                }
            }
            None => out += " []",
        }
        let _ = write!(
            out,
            "\n        type_description_hash: {}\n      message_count: {count}",
            quoted(&topic.type_hash)
        );
    }
    out += if none { " []\n" } else { "\n" };
    out += "  compression_format: \"\"\n  compression_mode: \"\"\n  relative_file_paths:\n";
    for file in files {
        let _ = writeln!(out, "    - {}", quoted(&file.path));
    }
    out += "  files:\n";
    for file in files {
        let _ = writeln!(out, "    - path: {}", quoted(&file.path));
        out += &times("      ", file.span.unwrap_or_default());
        let _ = writeln!(out, "      message_count: {}", file.count());
    }
    out += "  custom_data: ~\n  ros_distro: jazzy\n";
    out
}

/// Formats the profiles of a topic, whose text another writer may have got wrong; `None` where they
/// are no YAML list, which rosbag2 requires here.
fn profiles(text: &str) -> Option<String> {
    let list = ros_parameters::yaml::parse(text).ok().filter(|value| value.is_sequence())?;
    serde_yaml_ng::to_string(&list).ok()
}

/// Names come from the network: quoted where YAML could misread them.
fn quoted(text: &str) -> String {
    ParameterValue::String(text.to_owned()).to_yaml()
}

#[cfg(test)]
mod tests {
    use super::{super::Qos, *};

    #[test]
    fn written_metadata_is_yaml_and_names_its_files() {
        let topic = Topic {
            name: "/odd: \"name\"".into(),
            ..Topic::of::<volant_msgs::std_msgs::msg::String>("/x", &Qos::LATCHED)
        };
        let files =
            [FileContents { path: "run 1_0.mcap".into(), span: Some((5, 9)), counts: vec![2] }];
        let text = to_yaml(&files, [(&topic, 2)].into_iter());
        let folder = Folder::parse(&text).unwrap();
        assert_eq!(folder.relative_file_paths, ["run 1_0.mcap"]);
        assert_eq!(folder.storage_identifier, "mcap");
        let value: serde_yaml_ng::Value = serde_yaml_ng::from_str(&text).unwrap();
        let topic =
            &value["rosbag2_bagfile_information"]["topics_with_message_count"][0]["topic_metadata"];
        assert_eq!(topic["name"], "/odd: \"name\"");
        assert_eq!(topic["offered_qos_profiles"][0]["durability"], "transient_local");
        assert_eq!(value["rosbag2_bagfile_information"]["duration"]["nanoseconds"], 4);
    }

    #[test]
    fn profiles_that_are_no_list_are_left_out() {
        for (profiles, expected) in [
            ("", 0),
            ("foo: bar: [baz\n\t- x", 0),
            ("history: 3\n", 0),
            ("'a\nb'", 0),
            ("---\n- {history: 3, depth: 1}\n- history: 3\n", 2),
        ] {
            let topic = Topic {
                offered_qos_profiles: profiles.into(),
                ..Topic::of::<volant_msgs::std_msgs::msg::String>("/x", &Qos::LATCHED)
            };
            let files = [FileContents { path: "run_0.mcap".into(), ..FileContents::default() }];
            let text = to_yaml(&files, [(&topic, 0)].into_iter());
            let folder = Folder::parse(&text).unwrap();
            assert_eq!(folder.relative_file_paths, ["run_0.mcap"], "{text}");
            let value: serde_yaml_ng::Value = serde_yaml_ng::from_str(&text).unwrap();
            let topics = &value["rosbag2_bagfile_information"]["topics_with_message_count"];
            let list = &topics[0]["topic_metadata"]["offered_qos_profiles"];
            assert_eq!(list.as_sequence().map(Vec::len), Some(expected), "{text}");
        }
    }

    #[test]
    fn a_foreign_file_is_an_error() {
        assert!(
            Folder::parse("just: some\nyaml: file\n")
                .unwrap_err()
                .contains("rosbag2_bagfile_information")
        );
        assert!(Folder::parse("{").is_err());
    }
}
