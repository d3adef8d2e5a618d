use super::*;
use crate::names::{NameKind, resolve};

fn words(text: &str) -> Vec<String> {
    text.split_whitespace().map(str::to_owned).collect()
}

#[test]
fn the_arguments_of_ros2_launch_are_parsed() {
    let folder = tempfile::tempdir().unwrap();
    let (a, b) = (folder.path().join("a.yaml"), folder.path().join("b.yaml"));
    std::fs::write(
        &a,
        "/**: {ros__parameters: {sub: {x: 1}, y: 2, z: 3}}\nother: {ros__parameters: {y: 9}}",
    )
    .unwrap();
    std::fs::write(&b, "/robot1/est: {ros__parameters: {y: 5}}").unwrap();
    let line = format!(
        "--custom x --ros-args --log-level debug --ros-args -r __node:=est -r __ns:=/robot1 \
         --params-file {} --params-file {} -r /imu:=/sensors/imu -r pose:=~/pose -p z:=4.5 \
         -p other:y:=7 -- tail",
        a.display(),
        b.display()
    );
    let (ros, rest) = RosArguments::parse(words(&line)).unwrap();
    assert_eq!(rest, words("--custom x tail"));
    let node = ros.node_name("pose_fusion").unwrap();
    assert_eq!(node.fully_qualified(), "/robot1/est");
    assert_eq!(ros.level(&node), Level::Debug);
    let given = ros.overrides(&node);
    assert_eq!(given["sub.x"].value, ParameterValue::Integer(1));
    assert_eq!(given["y"].value, ParameterValue::Integer(5));
    assert_eq!(given["z"].value, ParameterValue::Double(4.5));
    assert_eq!(given["y"].origin, b.display().to_string());
    assert_eq!(resolve(&node, &ros.remaps(), NameKind::Topic, "pose").unwrap(), "/robot1/est/pose");
    assert_eq!(resolve(&node, &ros.remaps(), NameKind::Topic, "/imu").unwrap(), "/sensors/imu");
}

#[test]
fn every_mistake_is_named() {
    for (line, needle, usage) in [
        ("--ros-args -r", "-r", true),
        ("--ros-args -r a", "from:=to", true),
        ("--ros-args -p a", "name:=value", true),
        ("--ros-args -p a:={b:1", "-p a", true),
        ("--ros-args -p /rig1/fusion:a:=1", "without a namespace", true),
        ("--ros-args -r */fusion:a:=b", "without a namespace", true),
        ("--ros-args --log-level loud", "loud", true),
        ("--ros-args --bogus", "--bogus", true),
        ("--ros-args --params-file /no/such.yaml", "/no/such.yaml", false),
    ] {
        let error = RosArguments::parse(words(line)).unwrap_err();
        assert!(error.to_string().contains(needle), "{line}: {error}");
        assert_eq!(error.is_usage(), usage, "{line}");
    }
}

#[test]
fn node_prefixes_limit_rules_to_one_node_of_a_process() {
    let rules = "--ros-args -r a:__node:=first -r b:__ns:=/two -r first:__ns:=/one -r a:__ns:=/no";
    let (ros, _) = RosArguments::parse(words(rules)).unwrap();
    assert_eq!(ros.node_name("a").unwrap().fully_qualified(), "/one/first");
    assert_eq!(ros.node_name("b").unwrap().fully_qualified(), "/two/b");
}

#[test]
fn a_loggers_own_level_wins_over_that_of_all() {
    for line in ["--log-level a:=debug --log-level warn", "--log-level warn --log-level a:=debug"] {
        let (ros, _) = RosArguments::parse(words(&format!("--ros-args {line}"))).unwrap();
        let level = |name| ros.level(&NodeName::new("/", name).unwrap());
        assert_eq!((level("a"), level("b")), (Level::Debug, Level::Warn), "{line}");
    }
}

#[test]
fn another_nodes_parameter_is_allowed_only_where_it_is_given_for_all() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("rig.yaml");
    let node = NodeName::new("/", "pose_fusion").unwrap();
    for (selector, line, right) in [
        ("/**", "", true),
        ("imu_driver", "", true),
        ("pose_fusion", "", false),
        ("imu_driver", "-p port:=a", true),
        ("imu_driver", "-p imu_driver:port:=a", true),
        ("imu_driver", "-p pose_fusion:port:=a", false),
    ] {
        let rig = "/**: {ros__parameters: {markers: {size: 0.076}";
        let text = match selector {
            "/**" => format!("{rig}, port: a}}}}"),
            _ => format!("{rig}}}}}\n{selector}: {{ros__parameters: {{port: a}}}}"),
        };
        std::fs::write(&path, text).unwrap();
        let (mut ros, _) = RosArguments::parse(words(&format!("--ros-args {line}"))).unwrap();
        ros.add_file(path.clone()).unwrap();
        ros.allow_of_others(["port".to_owned()]);
        let declared = ros.declare::<()>(&node);
        assert_eq!(declared.is_ok(), right, "{selector} {line}: {declared:?}");
    }
}

#[test]
fn a_mistyped_node_name_is_rejected_and_that_of_another_node_is_not() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("params.yaml");
    let check_in = |file: &str, selector: &str, node: &str, kind: &str| {
        let text = format!("{file}\n{selector}: {{ros__parameters: {{x: 1}}}}");
        std::fs::write(&path, text).unwrap();
        let mut ros = RosArguments::default();
        ros.add_file(path.clone()).unwrap();
        ros.check_node_names(&NodeName::new("/", node).unwrap(), kind)
    };
    let rig = "/**: {ros__parameters: {markers: {size: 0.076}}}";
    let check = |selector: &str, node: &str, kind: &str| check_in(rig, selector, node, kind);
    for selector in
        ["/pose_fusoin", "pose_fusio", "/rig1/posefusion", "/Pose_Fusion", "/**/pose_fusin"]
    {
        let error = check(selector, "pose_fusion", "pose_fusion").unwrap_err();
        assert!(error.to_string().contains(&format!("`{selector}` matches no node")), "{error}");
        assert!(!error.is_usage());
    }
    for selector in
        ["/rig1/*", "/pose_fusion", "/rig1/pose_fusion", "pose_fusion_b", "imu_driver", "est"]
    {
        check(selector, "est", "pose_fusion").unwrap();
    }
    for selector in ["imu2_driver", "climber_driver", "robot_state_publisher"] {
        check(selector, "imu1_driver", "imu_driver").unwrap();
    }
    // Other programs' nodes, in a file that is no rig's.
    for selector in ["ins_driver", "mpu_driver", "icm_driver"] {
        let doubtful = check_in("", selector, "imu_driver", "imu_driver").unwrap();
        assert_eq!(doubtful.len(), 1, "{selector}");
        assert!(doubtful[0].to_string().contains(selector), "{doubtful:?}");
    }
    for (rule, right) in [
        ("-p pose_fusio:x:=1", false),
        ("-r posefusion:imu/data:=imu", false),
        ("-p pose_fusion:x:=1", true),
        ("-r imu_driver:imu/data:=imu", true),
    ] {
        let (ros, _) = RosArguments::parse(words(&format!("--ros-args {rule}"))).unwrap();
        let name = NodeName::new("/", "pose_fusion").unwrap();
        let result = ros.check_node_names(&name, "pose_fusion");
        assert_eq!(result.is_ok(), right, "{rule}: {result:?}");
        assert!(result.is_ok() || result.is_err_and(|error| error.is_usage()), "{rule}");
    }
}
