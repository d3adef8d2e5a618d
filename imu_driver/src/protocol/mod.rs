//! Serial protocol of Xsens devices, without I/O.
//!
//! [`FrameParser`] finds frames in a stream; [`LegacyFormat::decode`] and [`mtdata2::decode`]
//! convert their data to a [`Measurement`] in SI units; [`Decoder`] handles both. Nothing here
//! allocates per frame, and no input can cause a panic: all slices are checked.
//!
//! Source: the vendor's low-level protocol manuals, verified with recordings of real devices.

pub mod configuration;
pub mod frame;
pub mod legacy;
pub mod measurement;
pub mod message;
pub mod mtdata2;
pub mod number;

pub use configuration::{Configuration, DeviceId, OutputEntry};
pub use frame::{Frame, FrameParser, ParserCounts, frame};
pub use legacy::{LegacyFormat, OutputMode, OutputSettings};
pub use measurement::{Attitude, GlobalFrame, Measurement, Orientation, Status};
pub use message::{DeviceError, MessageId};
pub use number::NumberFormat;

use thiserror::Error;

/// Error of decoding the data of a frame.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum DecodeError {
    /// The length does not fit the format.
    #[error(
        "{found} bytes of data, but the format has {expected}; \
         read the Configuration of the device again"
    )]
    Length {
        /// Length found, bytes.
        found: usize,
        /// Length of the format, bytes.
        expected: usize,
    },
    /// An MTData2 item exceeds the data.
    #[error("the MTData2 item at byte {offset} exceeds the {length} bytes of the message")]
    Overrun {
        /// Position of the item, bytes.
        offset: usize,
        /// Length of the data, bytes.
        length: usize,
    },
    /// The size of an MTData2 item does not fit its identifier.
    #[error("the MTData2 item {id:04X} has {size} bytes, which does not fit its identifier")]
    ItemSize {
        /// Identifier of the item.
        id: u16,
        /// Size of the item, bytes.
        size: u8,
    },
    /// The format of a legacy MTData message is unknown.
    #[error(
        "the format of MTData is unknown without a Configuration; \
         provide the Configuration of the device"
    )]
    NoConfiguration,
}

/// Decodes data messages of both kinds; reads the legacy format from Configuration messages.
#[derive(Clone, Copy, Debug, Default)]
pub struct Decoder {
    /// Format of MTData, if known.
    pub format: Option<LegacyFormat>,
}

impl Decoder {
    /// Decodes a frame; `Ok(None)` if it is not a data message.
    ///
    /// # Errors
    /// As [`LegacyFormat::decode`] and [`mtdata2::decode`], and [`DecodeError::NoConfiguration`].
    #[inline]
    pub fn decode(&mut self, frame: &Frame<'_>) -> Result<Option<Measurement>, DecodeError> {
        match frame.message {
            MessageId::MT_DATA => match &self.format {
                Some(format) => format.decode(frame.data).map(Some),
                None => Err(DecodeError::NoConfiguration),
            },
            MessageId::MT_DATA2 => mtdata2::decode(frame.data).map(Some),
            other => {
                if other == MessageId::REQ_CONFIGURATION.ack() {
                    self.format = Some(Configuration::from_data(frame.data)?.format);
                }
                Ok(None)
            }
        }
    }
}
