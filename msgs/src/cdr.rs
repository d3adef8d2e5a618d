//! CDR, the encoding of messages on the wire and in bags (OMG DDSI-RTPS 2.5, section 10).
//!
//! A header of four bytes (`00 01 00 00` little endian, `00 00 …` big endian) precedes the fields;
//! each field is aligned to its own size, counted from the end of the header. The fields are encoded
//! by `cdr-encoding`, which the middleware uses too; here are the header and what may follow the
//! last field.
//!
//! Reading cannot panic, and no allocation exceeds what the remaining bytes can hold, whatever
//! lengths they claim (`test/tests/hostile_input.rs`, `test/fuzz`).

use crate::Message;
use byteorder::{BigEndian, LittleEndian};
use thiserror::Error;

/// Error of decoding a message.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CdrError {
    /// The header is not that of plain CDR.
    #[error("the bytes begin with {header:02x?}, which is not plain CDR (00 00 or 00 01)")]
    Encapsulation {
        /// The header found, at most four bytes.
        header: Vec<u8>,
    },
    /// The bytes are none of that type.
    #[error("the bytes are no {type_name}: {reason}")]
    Malformed {
        /// `package/msg/Type`.
        type_name: &'static str,
        /// Missing bytes, a bool other than 0 or 1, invalid UTF-8.
        reason: String,
    },
    /// Bytes remain after the last field: the message has another type.
    #[error("{count} bytes remain after the last field: the message has another type")]
    Trailing {
        /// Number of bytes.
        count: usize,
    },
}

/// Length of the header; alignment counts from its end.
const HEADER: usize = 4;
/// Most bytes of padding that writers add at the end of a message.
const LARGEST_PADDING: usize = 7;

/// Encodes a message in little endian, header included, as in a bag and on the wire.
pub fn to_bytes<M: Message>(message: &M) -> Vec<u8> {
    let mut bytes = vec![0, 1, 0, 0];
    // Fails for nothing that a message contains: maps and sequences of unknown length.
    let fields = cdr_encoding::to_vec::<M, LittleEndian>(message).unwrap_or_default();
    bytes.extend_from_slice(&fields);
    bytes
}

/// Decodes a message in either byte order, header included.
///
/// # Errors
/// [`CdrError`]: missing or excess bytes, invalid UTF-8, a bool other than 0 or 1, an encoding other
/// than plain CDR.
pub fn from_bytes<M: Message>(bytes: &[u8]) -> Result<M, CdrError> {
    let decoded = match bytes {
        [0, 0, _, _, body @ ..] => cdr_encoding::from_bytes::<M, BigEndian>(body),
        [0, 1, _, _, body @ ..] => cdr_encoding::from_bytes::<M, LittleEndian>(body),
        _ => {
            return Err(CdrError::Encapsulation {
                header: bytes[..bytes.len().min(HEADER)].to_vec(),
            });
        }
    };
    let (message, read) = decoded.map_err(|error| CdrError::Malformed {
        type_name: M::TYPE_NAME,
        reason: error.to_string(),
    })?;
    let count = bytes.len() - HEADER - read;
    if count > LARGEST_PADDING { Err(CdrError::Trailing { count }) } else { Ok(message) }
}
