//! DDS security: who is not in the keystore reads nothing and is not heard. Needs `--features security` and the `openssl` program.
#![cfg(feature = "security")]

use node_kit::{
    RosArguments,
    environment::{Network, Security},
    node::{Kit, NodeError, NodeShell, Process},
    qos::QosPreset,
};
use std::{
    path::{Path, PathBuf},
    process::Command,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use volant_msgs::std_msgs::msg::Header;

/// What each listener heard: its own name, and the talker's.
static HEARD: Mutex<Vec<(String, String)>> = Mutex::new(Vec::new());

fn heard(listener: &str, talker: &str) -> usize {
    let heard = HEARD.lock().unwrap_or_else(PoisonError::into_inner);
    heard.iter().filter(|(l, t)| l == listener && t == talker).count()
}

struct Talker(node_kit::node::Publisher<Header>, String);

impl NodeShell for Talker {
    const NAME: &'static str = "talker";
    type Parameters = ();
    type Input = ();

    fn start(kit: &mut Kit<()>, (): ()) -> Result<Self, NodeError> {
        kit.timer(Duration::from_millis(50), || ());
        let name = kit.name().base().to_owned();
        Ok(Self(kit.advertise("/secret", QosPreset::State)?, name))
    }

    fn handle(&mut self, _: &mut Kit<()>, (): ()) {
        self.0.publish(Header { frame_id: self.1.clone(), ..Header::default() });
    }
}

struct Listener(String);

impl NodeShell for Listener {
    const NAME: &'static str = "listener";
    type Parameters = ();
    type Input = Arc<Header>;

    fn start(kit: &mut Kit<Arc<Header>>, (): ()) -> Result<Self, NodeError> {
        kit.subscribe("/secret", QosPreset::State, Some)?;
        Ok(Self(kit.name().base().to_owned()))
    }

    fn handle(&mut self, _: &mut Kit<Arc<Header>>, message: Arc<Header>) {
        let mut heard = HEARD.lock().unwrap_or_else(PoisonError::into_inner);
        heard.push((self.0.clone(), message.frame_id.clone()));
    }
}

fn named(name: &str) -> RosArguments {
    let mut arguments = RosArguments::default();
    arguments.remap("__node", name);
    arguments
}

fn keystore(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch_config/setup/make-keystore");
    let status = Command::new(script).arg(&folder).args(["/rig/climber", "/rig/platform"]).status().unwrap();
    assert!(status.success());
    folder
}

fn join(name: &str, security: Option<Security>) -> Process {
    let mut process = Process::new(Network { domain_id: 31, security, ..Network::default() }).unwrap();
    process.start::<Talker>(&named(&format!("{name}_talker"))).unwrap();
    process.start::<Listener>(&named(&format!("{name}_listener"))).unwrap();
    process
}

#[test]
fn who_has_no_key_of_the_keystore_reads_and_injects_nothing() {
    let (ours, theirs) = (keystore("ours"), keystore("theirs"));
    let climber = join("climber", Some(Security::enforced(&ours, "/rig/climber")));
    let platform = join("platform", Some(Security::enforced(&ours, "/rig/platform")));
    let nobody = join("nobody", None);
    let stranger = join("stranger", Some(Security::enforced(&theirs, "/rig/climber")));
    for _ in 0..100 {
        if heard("platform_listener", "climber_talker") > 20
            && heard("climber_listener", "platform_talker") > 20
        {
            break;
        }
        std::thread::sleep(Duration::from_millis(200));
    }
    std::thread::sleep(Duration::from_secs(2));
    // Those who may, hear each other; and everybody hears himself, so that the outsiders were at work.
    assert!(heard("platform_listener", "climber_talker") > 20, "{:?}", HEARD.lock());
    assert!(heard("climber_listener", "platform_talker") > 20);
    for alone in ["nobody", "stranger"] {
        assert!(heard(&format!("{alone}_listener"), &format!("{alone}_talker")) > 20);
        for insider in ["climber", "platform"] {
            assert_eq!(heard(&format!("{alone}_listener"), &format!("{insider}_talker")), 0, "{alone} reads");
            assert_eq!(
                heard(&format!("{insider}_listener"), &format!("{alone}_talker")),
                0,
                "{alone} injects"
            );
        }
    }
    drop((climber, platform, nobody, stranger));
}

#[test]
fn without_its_keys_an_enforced_process_does_not_start() {
    let security = Some(Security::enforced("/nowhere", "/rig/climber"));
    let error = Process::new(Network { domain_id: 32, security, ..Network::default() }).err().unwrap();
    assert!(error.to_string().contains("/nowhere/enclaves/rig/climber/cert.pem"), "{error}");
}
