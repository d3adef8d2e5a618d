//! CDR, the encoding of messages on the wire and in bags (OMG DDSI-RTPS 2.5, section 10).
//!
//! A header of four bytes (`00 01 00 00` little endian, `00 00 …` big endian) precedes the fields;
//! each field is aligned to its own size, counted from the end of the header. The fields are
//! encoded by `cdr-encoding`, which the middleware uses too; here are the header and what may
//! follow the last field. As on the wire, a string is read without regard to its terminating byte.
//!
//! Reading cannot panic, and no allocation exceeds what the remaining bytes can hold, whatever
//! lengths they claim (`test/tests/hostile_input.rs`, `test/fuzz`).

use crate::Message;
use byteorder::{BigEndian, ByteOrder, LittleEndian};
use cdr_encoding::CdrDeserializer;
use serde::{Deserialize, Deserializer, de::Error as _};
use thiserror::Error;

/// Invalid bytes: type, place and what is wrong.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct CdrError(String);

/// Length of the header; alignment counts from its end.
const HEADER: usize = 4;
/// Most bytes of padding that writers add at the end of a message.
const LARGEST_PADDING: usize = 7;

/// Encodes a message in little endian, header included, as in a bag and on the wire.
pub fn to_bytes<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    // Neither memory nor the encoding of a message fails: it has no map, and its sequences know
    // their lengths.
    let written = cdr_encoding::to_writer::<M, LittleEndian, _>(&mut bytes, message);
    debug_assert!(written.is_ok(), "{written:?}");
    bytes
}

/// Decodes a message in either byte order, header included.
///
/// # Errors
/// [`CdrError`] with the type and the place: missing or excess bytes, a sequence beyond its bound,
/// invalid UTF-8, a bool other than 0 or 1, an encoding other than plain CDR.
pub fn from_bytes<M: Message>(bytes: &[u8]) -> Result<M, CdrError> {
    let (message, read) = match bytes {
        [0, 0, _, _, body @ ..] => read::<M, BigEndian>(body),
        [0, 1, _, _, body @ ..] => read::<M, LittleEndian>(body),
        _ => {
            let header = &bytes[..bytes.len().min(HEADER)];
            return Err(CdrError(format!(
                "the bytes begin with {header:02x?}, which is not plain CDR (00 00 or 00 01)"
            )));
        }
    };
    let message = message.map_err(|error| {
        let (name, at, length) = (M::TYPE_NAME, HEADER + read, bytes.len());
        CdrError(format!("the bytes are no {name}: {error} (behind byte {at} of {length})"))
    })?;
    let count = bytes.len() - HEADER - read;
    if count > LARGEST_PADDING {
        let text = "bytes remain after the last field: the message has another type";
        return Err(CdrError(format!("{count} {text}")));
    }
    Ok(message)
}

/// Decodes the fields, and returns how many bytes were read.
fn read<M: Message, B: ByteOrder>(body: &[u8]) -> (cdr_encoding::Result<M>, usize) {
    let mut decoder = CdrDeserializer::<B>::new(body);
    (M::deserialize(&mut decoder), decoder.bytes_consumed())
}

/// Decodes a sequence of at most `BOUND` elements, from the wire too.
pub(crate) fn bounded<'de, D, T, const BOUND: usize>(from: D) -> Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    let items = Vec::deserialize(from)?;
    if items.len() > BOUND {
        let excess =
            format!("a sequence of {} elements, more than its bound of {BOUND}", items.len());
        return Err(D::Error::custom(excess));
    }
    Ok(items)
}
