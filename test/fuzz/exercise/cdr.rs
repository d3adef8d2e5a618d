//! Messages: CDR of each type that a node or a tool subscribes to or reads from a bag, by the codec
//! of bags and of the wire, and what the nodes make of them before a core sees them.

use climber_driver::{Climber, ClimberConfig};
use node_kit::{convert, parameters::messages};
use rig_model::Frames;
use std::{
    any::{Any, TypeId},
    cell::RefCell,
};
use volant_msgs::{
    Message, cdr,
    diagnostic_msgs::msg::DiagnosticArray,
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    lifecycle_msgs::srv::ChangeStateRequest,
    msg::{MarkerObservation, MarkerObservations, MarkerUpdates},
    nav_msgs::msg::Odometry,
    rcl_interfaces::{
        msg::{Parameter, ParameterEvent},
        srv::{
            DescribeParametersRequest, GetParametersRequest, ListParametersRequest,
            SetParametersAtomicallyRequest, SetParametersRequest,
        },
    },
    rosgraph_msgs::msg::Clock,
    sensor_msgs::msg::{
        CameraInfo, CompressedImage, Image, Imu, JointState, MagneticField, Temperature,
    },
    tf2_msgs::msg::TFMessage,
};

pub const WORDS: &[&[u8]] = &[
    b"\x00\x01\x00\x00",
    b"\x00\x00\x00\x00",
    b"\x00\x03\x00\x00",
    b"plumb_bob\0",
    b"equidistant\0",
    b"rgb8\0",
    b"jpeg\0",
    b"rail_x\0",
    b"world\0",
    b"climber\0",
    b"\x00\x00\x00\x00\x00\x00\xF8\x7F",
    b"\x00\x00\x00\x00\x00\x00\xF0\x7F",
];

thread_local! {
    static CLIMBER: RefCell<Option<Climber>> = const { RefCell::new(None) };
}

type Run = fn(&[u8]);

macro_rules! types {
    ($($t:ty),* $(,)?) => {
        /// One entry per type; the first byte of an input chooses.
        const TYPES: &[Run] = &[$(read::<$t>),*];

        /// A message of each type with nothing in it, preceded by its number.
        fn empty() -> Vec<Vec<u8>> {
            vec![$(seed(&<$t>::default())),*]
        }

        fn number<M: Message>() -> usize {
            let types = [$(TypeId::of::<$t>()),*];
            types.iter().position(|t| *t == TypeId::of::<M>()).unwrap_or(0)
        }
    };
}

types!(
    Image,
    CompressedImage,
    CameraInfo,
    JointState,
    MarkerObservations,
    MarkerUpdates,
    Imu,
    MagneticField,
    Temperature,
    TransformStamped,
    TFMessage,
    Odometry,
    PoseWithCovarianceStamped,
    Clock,
    DiagnosticArray,
    ParameterEvent,
    GetParametersRequest,
    SetParametersRequest,
    SetParametersAtomicallyRequest,
    DescribeParametersRequest,
    ListParametersRequest,
    ChangeStateRequest,
);

/// A message, preceded by the number of its type.
fn seed<M: Message>(message: &M) -> Vec<u8> {
    let mut seed = vec![number::<M>() as u8];
    seed.extend(cdr::to_bytes(message));
    seed
}

pub fn run(data: &[u8]) {
    let Some((which, bytes)) = data.split_first() else { return };
    TYPES[usize::from(*which) % TYPES.len()](bytes);
}

fn read<M: Message>(bytes: &[u8]) {
    let own = cdr::from_bytes::<M>(bytes);
    if let Ok(message) = &own {
        // What was read is written and read as the same: compared as bytes, since NaN is not
        // itself.
        let written = cdr::to_bytes(message);
        let again = cdr::from_bytes::<M>(&written).expect("what was written is read");
        assert_eq!(cdr::to_bytes(&again), written);
        consume(message);
    }
}

/// What a node does with a message before its core sees it.
fn consume(message: &dyn Any) {
    if let Some(m) = message.downcast_ref::<Imu>() {
        let sample = convert::imu_sample(m);
        assert!(
            sample.orientation.as_ref().is_none_or(|o| (o.enu_from_imu.norm() - 1.0).abs() < 1e-6)
        );
    } else if let Some(m) = message.downcast_ref::<MarkerObservations>() {
        let _ = convert::marker_observations(m);
    } else if let Some(m) = message.downcast_ref::<TransformStamped>() {
        if let Ok(sample) = convert::climber_sample(m, &Frames::default()) {
            assert!((sample.world_from_climber.rotation.norm() - 1.0).abs() < 1e-6);
        }
    } else if let Some(m) = message.downcast_ref::<TFMessage>() {
        for transform in &m.transforms {
            let _ = convert::isometry(&transform.transform, "fuzzed");
        }
    } else if let Some(m) = message.downcast_ref::<CameraInfo>() {
        if let Ok(camera) = convert::camera_model(m) {
            super::yaml::use_camera(&camera);
        }
    } else if let Some(m) = message.downcast_ref::<Odometry>() {
        let _ = convert::pose(&m.pose.pose, "fuzzed");
        let _ = convert::covariance6(&m.pose.covariance);
    } else if let Some(m) = message.downcast_ref::<PoseWithCovarianceStamped>() {
        let _ = convert::pose(&m.pose.pose, "fuzzed");
    } else if let Some(m) = message.downcast_ref::<Image>() {
        let mut scratch = marker_tracker::OwnedImage::default();
        let at = convert::stamp(&m.header.stamp);
        let (width, height, step) = (m.width as usize, m.height as usize, m.step as usize);
        let big = m.is_bigendian != 0;
        if let Ok(view) = marker_tracker::from_encoding(
            at,
            width,
            height,
            &m.encoding,
            big,
            step,
            &m.data,
            &mut scratch,
        ) {
            view.check().expect("an image with a consistent size");
        }
    } else if let Some(m) = message.downcast_ref::<CompressedImage>() {
        let _ = marker_tracker::decode_compressed(&m.format, &m.data);
    } else if let Some(m) = message.downcast_ref::<JointState>() {
        joints(m);
    } else if let Some(m) = message.downcast_ref::<SetParametersRequest>() {
        m.parameters.iter().for_each(parameter);
    } else if let Some(m) = message.downcast_ref::<SetParametersAtomicallyRequest>() {
        m.parameters.iter().for_each(parameter);
    }
}

fn parameter(parameter: &Parameter) {
    if let Some(value) = messages::value(&parameter.value) {
        let _ = value.to_string();
    }
}

/// One reading after the other into one climber, each at the time that it bears.
fn joints(m: &JointState) {
    CLIMBER.with_borrow_mut(|climber| {
        let climber = climber.get_or_insert_with(|| {
            Climber::new(ClimberConfig::default()).expect("its defaults are right")
        });
        let reading = convert::joint_reading(m);
        climber.handle(&reading, reading.stamp);
        while let Some(output) = climber.poll() {
            if let climber_driver::Output::Sample(sample) = output {
                assert!(sample.world_from_climber.translation.vector.iter().all(|x| x.is_finite()));
            }
        }
    });
}

pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = empty();
    let header =
        volant_msgs::std_msgs::msg::Header { frame_id: "world".into(), ..Default::default() };
    let joint_state = JointState {
        header: header.clone(),
        name: ["rail_x", "rail_y", "turn"].map(str::to_owned).to_vec(),
        position: vec![1.0, 2.0, 0.1],
        ..JointState::default()
    };
    seeds.push(seed(&joint_state));
    let markers = MarkerObservations {
        header: header.clone(),
        markers: (0..4)
            .map(|color| MarkerObservation {
                color,
                x: 3.5,
                y: 4.5,
                area: 9.0,
                ..Default::default()
            })
            .collect(),
    };
    seeds.push(seed(&markers));
    let camera = CameraInfo {
        width: 640,
        height: 480,
        distortion_model: "plumb_bob".into(),
        d: vec![-0.2, 0.1, 0.0, 0.0, 0.0],
        k: [600.0, 0.0, 320.0, 0.0, 600.0, 240.0, 0.0, 0.0, 1.0],
        ..CameraInfo::default()
    };
    seeds.push(seed(&camera));
    let image = Image {
        width: 4,
        height: 2,
        step: 12,
        encoding: "rgb8".into(),
        data: vec![7; 24],
        ..Image::default()
    };
    seeds.push(seed(&image));
    let image = CompressedImage {
        format: "png".into(),
        data: super::image::png(3, 2, 2, 8, 99),
        ..Default::default()
    };
    seeds.push(seed(&image));
    let transform =
        TransformStamped { header, child_frame_id: "climber".into(), ..Default::default() };
    seeds.push(seed(&transform));
    seeds.push(seed(&TFMessage { transforms: vec![transform.clone(), transform] }));
    let mut set = Parameter { name: "rate".into(), ..Parameter::default() };
    set.value.r#type = 3;
    set.value.double_value = 100.0;
    set.value.string_array_value = vec!["a".into(), String::new()];
    seeds.push(seed(&SetParametersRequest { parameters: vec![set.clone(), set] }));
    seeds
}
