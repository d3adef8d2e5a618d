//! The units' serial protocol, bytes in and values out, without I/O: worth using alone.
//!
//! [`FrameParser`] finds frames in a stream; [`LegacyFormat::decode`] and [`mtdata2::decode`] turn their data into a
//! [`Measurement`] in SI units; [`Decoder`] does both for whatever comes. Nothing here allocates per frame, and no input
//! makes it panic: every access is by a checked slice.
//!
//! Source: the vendor's low-level protocol manuals, checked against real recordings.

pub mod command;
pub mod configuration;
pub mod frame;
pub mod legacy;
pub mod measurement;
pub mod message;
pub mod mtdata2;
pub mod number;

pub use command::{Command, Reply};
pub use configuration::{Configuration, DeviceId, OutputEntry};
pub use frame::{Frame, FrameParser, ParserCounts, frame, write_frame};
pub use legacy::{LegacyFormat, OrientationForm, OutputMode, OutputSettings};
pub use measurement::{Attitude, GlobalFrame, Measurement, Orientation, Status, Utc};
pub use message::{DeviceError, MessageId};
pub use number::NumberFormat;

use thiserror::Error;

/// Why the data of a whole frame could not be read.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum DecodeError {
    /// Not as long as the format says.
    #[error("{found} bytes of data where the format has {expected}; read the unit's configuration anew")]
    Length {
        /// Bytes found.
        found: usize,
        /// Bytes that the format has.
        expected: usize,
    },
    /// An MTData2 item claims more bytes than there are.
    #[error("the MTData2 item at byte {offset} runs past the end ({length} bytes)")]
    Overrun {
        /// Where the item starts.
        offset: usize,
        /// Length of the data.
        length: usize,
    },
    /// A known MTData2 item with a size that it cannot have.
    #[error("the MTData2 item {id:04X} has {size} bytes, which its identifier does not allow")]
    ItemSize {
        /// Its identifier.
        id: u16,
        /// Its size.
        size: u8,
    },
    /// A legacy MTData before its format is known.
    #[error("MTData without a Configuration: its format is not known; give the Configuration of its unit")]
    NoConfiguration,
    /// No data message at all.
    #[error("{message} is no data message")]
    NotData {
        /// What it is.
        message: MessageId,
    },
}

/// Decodes data messages of both kinds; learns the legacy format from the Configuration messages that pass by.
#[derive(Clone, Copy, Debug, Default)]
pub struct Decoder {
    /// The legacy format, once it is known.
    pub format: Option<LegacyFormat>,
}

impl Decoder {
    /// The measurement in a frame; `Ok(None)` for a frame that is no data message.
    ///
    /// # Errors
    /// As [`LegacyFormat::decode`] and [`mtdata2::decode`], and [`DecodeError::NoConfiguration`].
    #[inline]
    pub fn decode(&mut self, frame: &Frame<'_>) -> Result<Option<Measurement>, DecodeError> {
        let mut m = Measurement::default();
        Ok(self.decode_into(frame, &mut m)?.then_some(m))
    }

    /// [`Decoder::decode`] into a measurement that is at hand; `Ok(false)` for a frame that is no data message.
    ///
    /// # Errors
    /// As [`Decoder::decode`].
    #[inline]
    pub fn decode_into(&mut self, frame: &Frame<'_>, m: &mut Measurement) -> Result<bool, DecodeError> {
        match frame.message {
            MessageId::MT_DATA => match &self.format {
                Some(format) => format.decode_into(frame.data, m).map(|()| true),
                None => Err(DecodeError::NoConfiguration),
            },
            MessageId::MT_DATA2 => mtdata2::decode_into(frame.data, m).map(|()| true),
            other => {
                if other == MessageId::REQ_CONFIGURATION.ack() {
                    self.format = Some(Configuration::from_data(frame.data)?.format);
                }
                Ok(false)
            }
        }
    }
}
