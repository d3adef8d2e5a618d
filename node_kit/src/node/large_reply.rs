//! Replies that do not fit into one datagram of RustDDS.
//!
//! RustDDS 0.15.1 splits a sample of more than about 1.3 kB into DATA_FRAG submessages, and writes
//! them malformed if they have inline QoS (an `Option`'s tag before the parameter list), which a
//! reply with the identity of its request always has. No peer can read them: `ros2 param dump` of a
//! node with many parameters would wait for ever.
//!
//! Such a reply is sent through RustDDS, which numbers and announces it and receives the
//! acknowledgment, and besides as Fast DDS sends up to 64 kB: one DATA submessage in one datagram,
//! with the same writer and number. A reader uses the copy that it can read, once.

use rustdds::{DomainParticipant, SampleIdentity};
use std::{
    collections::BTreeSet,
    net::{Ipv4Addr, SocketAddr, UdpSocket},
};

/// Largest reply that is sent through RustDDS only, bytes: it fits a datagram of 1500 with all
/// headers.
pub(super) const FITS: usize = 1300;
/// Largest reply, bytes: a UDP datagram (65507) less the headers below.
pub(super) const LONGEST: usize = 65_000;

const VENDOR: [u8; 2] = [0x01, 0x12];
const INFO_TIMESTAMP: u8 = 0x09;
const DATA: u8 = 0x15;
// Flags of a submessage, used in two expressions; a type of bitflags 2.13 would be longer.
const LITTLE_ENDIAN: u8 = 0x01;
const INLINE_QOS: u8 = 0x02;
const WITH_DATA: u8 = 0x04;
/// `PID_RELATED_SAMPLE_IDENTITY` of the RPC specification, and Fast DDS's own number from before
/// it.
const RELATED_SAMPLE_IDENTITY: [u16; 2] = [0x0083, 0x800f];
const SENTINEL: u16 = 0x0001;

/// The datagram: RTPS header, time, one DATA submessage.
///
/// `sample` is the identity of the reply from RustDDS, `request` the identity of its request,
/// `payload` the reply as CDR with its header of four bytes, `stamp` the time of sending in units
/// of 2⁻³² s since 1970.
fn datagram(
    sample: &SampleIdentity,
    request: &SampleIdentity,
    payload: &[u8],
    stamp: u64,
) -> Vec<u8> {
    let (writer, number) = (sample.writer_guid.to_bytes(), i64::from(sample.sequence_number));
    let mut bytes = Vec::with_capacity(payload.len() + 128);
    bytes.extend_from_slice(b"RTPS");
    // Protocol 2.4, as RustDDS.
    bytes.extend_from_slice(&[2, 4]);
    bytes.extend_from_slice(&VENDOR);
    bytes.extend_from_slice(&writer[..12]);

    bytes.extend_from_slice(&[INFO_TIMESTAMP, LITTLE_ENDIAN, 8, 0]);
    put_halves(&mut bytes, stamp);

    let mut body = Vec::with_capacity(payload.len() + 96);
    body.extend_from_slice(&[0, 0]);
    // Octets between this field and the inline QoS.
    body.extend_from_slice(&16u16.to_le_bytes());
    // Any matched reader: each client finds its own request in the inline QoS.
    body.extend_from_slice(&[0; 4]);
    body.extend_from_slice(&writer[12..]);
    put_halves(&mut body, number.cast_unsigned());
    let (client, request) = (request.writer_guid.to_bytes(), i64::from(request.sequence_number));
    for parameter in RELATED_SAMPLE_IDENTITY {
        body.extend_from_slice(&parameter.to_le_bytes());
        body.extend_from_slice(&24u16.to_le_bytes());
        body.extend_from_slice(&client);
        put_halves(&mut body, request.cast_unsigned());
    }
    body.extend_from_slice(&SENTINEL.to_le_bytes());
    body.extend_from_slice(&[0, 0]);
    body.extend_from_slice(payload);
    // Submessages end at a multiple of four bytes.
    body.resize(body.len().next_multiple_of(4), 0);

    bytes.extend_from_slice(&[DATA, LITTLE_ENDIAN | INLINE_QOS | WITH_DATA]);
    // 0 stands for "to the end of the datagram".
    bytes.extend_from_slice(&u16::try_from(body.len()).unwrap_or(0).to_le_bytes());
    bytes.extend_from_slice(&body);
    bytes
}

/// Writes a 64-bit number as RTPS has it: the high half first, each half in the byte order of the
/// submessage.
fn put_halves(bytes: &mut Vec<u8>, number: u64) {
    bytes.extend_from_slice(&((number >> 32) as u32).to_le_bytes());
    bytes.extend_from_slice(&(number as u32).to_le_bytes());
}

/// Reply that is sent beside RustDDS.
pub(super) struct LargeReply {
    datagram: Vec<u8>,
    socket: UdpSocket,
    readers: BTreeSet<SocketAddr>,
}

impl LargeReply {
    /// Prepares the reply for every discovered reader of the DDS topic `replies`.
    ///
    /// # Errors
    /// The system's error if it refuses a socket.
    pub fn new(
        participant: &DomainParticipant,
        replies: &str,
        sample: &SampleIdentity,
        request: &SampleIdentity,
        payload: &[u8],
    ) -> std::io::Result<Self> {
        let readers = participant
            .discovered_readers()
            .iter()
            .filter(|r| r.subscription_topic_data.topic_name() == replies)
            .flat_map(|r| &r.reader_proxy.unicast_locator_list)
            .filter(|locator| locator.is_udp())
            .map(|locator| SocketAddr::from(*locator))
            .filter(SocketAddr::is_ipv4)
            .collect();
        let stamp = rustdds::Timestamp::now().to_ticks();
        Ok(Self {
            datagram: datagram(sample, request, payload, stamp),
            socket: UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?,
            readers,
        })
    }

    /// Sends the reply to all readers once. An unreachable reader ends by its lease.
    pub fn send(&self) {
        for reader in &self.readers {
            let _ = self.socket.send_to(&self.datagram, reader);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustdds::{GUID, SequenceNumber};

    #[test]
    fn the_datagram_has_the_layout_of_the_specification() {
        let identity = |first: u8, number: i64| SampleIdentity {
            writer_guid: GUID::from_bytes(std::array::from_fn(|i| first + i as u8)),
            sequence_number: SequenceNumber::from(number),
        };
        let bytes = datagram(
            &identity(0x10, 7),
            &identity(0x40, (2 << 32) | 3),
            &[0, 1, 0, 0, 9],
            5 << 32 | 6,
        );
        assert_eq!(bytes[..8], *b"RTPS\x02\x04\x01\x12");
        assert_eq!(bytes[8..20], std::array::from_fn::<u8, 12, _>(|i| 0x10 + i as u8));
        assert_eq!(bytes[20..32], [9, 1, 8, 0, 5, 0, 0, 0, 6, 0, 0, 0]);
        // DATA, flags and length: 20 bytes up to the inline QoS, in it twice 28 and the sentinel, 5
        // of payload, padded.
        assert_eq!(bytes[32..36], [0x15, 7, 88, 0]);
        assert_eq!(bytes[36..40], [0, 0, 16, 0]);
        assert_eq!(bytes[40..56], [0, 0, 0, 0, 0x1c, 0x1d, 0x1e, 0x1f, 0, 0, 0, 0, 7, 0, 0, 0]);
        assert_eq!(bytes[56..60], [0x83, 0, 24, 0]);
        assert_eq!(bytes[76..84], [2, 0, 0, 0, 3, 0, 0, 0]);
        assert_eq!(bytes[84..88], [0x0f, 0x80, 24, 0]);
        assert_eq!(bytes[112..], [1, 0, 0, 0, 0, 1, 0, 0, 9, 0, 0, 0]);
    }
}
