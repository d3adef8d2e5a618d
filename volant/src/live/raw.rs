//! Serialized messages: DDS payloads with the encapsulation header of four bytes that bags have.

use rustdds::{
    RepresentationIdentifier,
    bytes::Bytes,
    no_key::{Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter},
};
use std::convert::Infallible;

/// Bytes of a message, with their header.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Raw(pub Vec<u8>);

/// Serialization adapter that passes bytes unchanged.
#[derive(Clone, Copy, Debug)]
pub struct RawAdapter;

const ENCODINGS: [RepresentationIdentifier; 2] =
    [RepresentationIdentifier::CDR_BE, RepresentationIdentifier::CDR_LE];

impl DeserializerAdapter<Raw> for RawAdapter {
    type Error = Infallible;
    type Decoded = Raw;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &ENCODINGS
    }

    fn transform_decoded(decoded: Raw) -> Raw {
        decoded
    }
}

impl DefaultDecoder<Raw> for RawAdapter {
    type Decoder = Self;
    const DECODER: Self = Self;
}

impl Decode<'_, Raw> for RawAdapter {
    type Error = Infallible;

    fn decode_bytes(
        self,
        bytes: &[u8],
        encoding: RepresentationIdentifier,
    ) -> Result<Raw, Infallible> {
        let kind = u8::from(encoding == RepresentationIdentifier::CDR_LE);
        let mut data = Vec::with_capacity(bytes.len() + 4);
        data.extend_from_slice(&[0, kind, 0, 0]);
        data.extend_from_slice(bytes);
        Ok(Raw(data))
    }
}

impl SerializerAdapter<Raw> for RawAdapter {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Raw) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(value.0.get(4..).unwrap_or_default()))
    }
}

/// The inverse of [`node_kit::node::dds_type_name`]; `None` for a type that is not a ROS message.
pub fn ros_type_name(dds: &str) -> Option<String> {
    let (package, name) = dds.strip_suffix('_')?.split_once("::dds_::")?;
    Some(format!("{}/{name}", package.replace("::", "/")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use node_kit::node::dds_type_name;

    #[test]
    fn type_names_go_both_ways() {
        for (ros, dds) in [
            ("sensor_msgs/msg/Imu", "sensor_msgs::msg::dds_::Imu_"),
            (
                "rcl_interfaces/srv/GetParameters_Request",
                "rcl_interfaces::srv::dds_::GetParameters_Request_",
            ),
        ] {
            assert_eq!(dds_type_name(ros), dds);
            assert_eq!(ros_type_name(dds).as_deref(), Some(ros));
        }
        assert_eq!(ros_type_name("HelloWorld"), None);
    }

    #[test]
    fn bytes_keep_their_header() {
        for (encoding, header) in ENCODINGS.into_iter().zip([[0, 0, 0, 0], [0, 1, 0, 0]]) {
            let Ok(raw) = RawAdapter.decode_bytes(&[7, 8], encoding);
            assert_eq!(raw.0[..4], header);
            assert_eq!(raw.0[4..], [7, 8]);
        }
        let Ok(bytes) = RawAdapter::to_bytes(&Raw(vec![0, 1, 0, 0, 9]));
        assert_eq!(bytes[..], [9]);
    }
}
