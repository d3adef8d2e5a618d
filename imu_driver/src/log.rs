//! Recorded bytes → CSV with one row per data message, and counts.

use crate::protocol::{
    Configuration, DecodeError, Decoder, FrameParser, LegacyFormat, Measurement, MessageId,
    ParserCounts,
    configuration::{CONFIGURATION_LENGTH, output_configuration_from_data},
};
use std::io::{self, Write};
use thiserror::Error;

/// Header of the CSV.
pub const CSV_HEADER: &str =
    "counter,sample_time_fine,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,q_w,q_x,q_y,q_z";

/// Error of decoding a log.
#[derive(Debug, Error)]
pub enum LogError {
    /// The log is empty.
    #[error("the log is empty; record one with `volant imu log`")]
    Empty,
    /// The log, of this number of bytes, contains no frame.
    #[error("no valid frame in {0} bytes; give the raw bytes of an IMU")]
    Foreign(usize),
    /// The format of this number of MTData messages is unknown.
    #[error(
        "{0} legacy MTData messages, but no Configuration with their format; \
         give the Configuration of the IMU with --config CONFIGURATION.bin"
    )]
    NoConfiguration(u64),
    /// No message fits the Configuration.
    #[error("none of {frames} data messages could be decoded: {reason}")]
    Unreadable {
        /// Number of messages.
        frames: u64,
        /// Error of the first message.
        reason: DecodeError,
    },
    /// This number of bytes is not a Configuration.
    #[error(
        "{0} bytes are not a Configuration; give the answer to ReqConfiguration \
         (118 bytes, or the frame of 123 bytes) or an output configuration"
    )]
    NotConfiguration(usize),
    /// The CSV cannot be written.
    #[error("the CSV cannot be written: {0}")]
    Write(#[from] io::Error),
}

/// Counts of a decoded log.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LogCounts {
    /// Counts of the frame parser.
    pub parser: ParserCounts,
    /// Data messages written as rows.
    pub rows: u64,
    /// Data messages that could not be decoded.
    pub unreadable: u64,
}

/// Reads the legacy format from a saved Configuration, a frame or its data.
///
/// `None` for an output configuration: MTData2 identifies its format.
///
/// # Errors
/// [`LogError::NotConfiguration`].
pub fn saved_configuration(bytes: &[u8]) -> Result<Option<LegacyFormat>, LogError> {
    if let Some(format) = configuration_in(bytes) {
        return Ok(Some(format));
    }
    if bytes.len() == CONFIGURATION_LENGTH {
        return Ok(Configuration::from_data(bytes).ok().map(|c| c.format));
    }
    let mut framed = false;
    FrameParser::new()
        .parse(bytes, |f| framed |= f.message == MessageId::OUTPUT_CONFIGURATION.ack());
    if framed || (!bytes.is_empty() && output_configuration_from_data(bytes).is_ok()) {
        return Ok(None);
    }
    Err(LogError::NotConfiguration(bytes.len()))
}

/// Legacy format of the first Configuration message in `bytes`.
pub fn configuration_in(bytes: &[u8]) -> Option<LegacyFormat> {
    let mut format = None;
    FrameParser::new().parse(bytes, |f| {
        if f.message == MessageId::REQ_CONFIGURATION.ack() && format.is_none() {
            format = Configuration::from_data(f.data).ok().map(|c| c.format);
        }
    });
    format
}

/// Calls `handle` with every frame of a log, also those inside an incomplete frame at its end.
pub fn frames_of(log: &[u8], mut handle: impl FnMut(crate::protocol::Frame<'_>)) -> ParserCounts {
    let mut parser = FrameParser::new();
    parser.parse(log, &mut handle);
    while let Some(frame) = parser.next_frame_at_end() {
        handle(frame);
    }
    parser.counts()
}

/// Decodes a log to CSV; `format` applies until the log contains a Configuration.
///
/// # Errors
/// [`LogError`] if the log has no frames or no format, or if writing fails.
pub fn decode_to_csv(
    log: &[u8],
    format: Option<LegacyFormat>,
    out: &mut impl Write,
) -> Result<LogCounts, LogError> {
    if log.is_empty() {
        return Err(LogError::Empty);
    }
    let mut decoder = Decoder { format: format.or_else(|| configuration_in(log)) };
    let mut counts = LogCounts::default();
    let mut written = writeln!(out, "{CSV_HEADER}");
    let mut first_error = None;
    let mut row = String::with_capacity(256);
    counts.parser = frames_of(log, |frame| match decoder.decode(&frame) {
        Ok(Some(measurement)) => {
            counts.rows += 1;
            if written.is_ok() {
                csv_row(&measurement, &mut row);
                written = out.write_all(row.as_bytes());
            }
        }
        Ok(None) => {}
        Err(error) => {
            // Other messages are no rows anyway.
            counts.unreadable += u64::from(frame.message.is_data());
            first_error.get_or_insert(error);
        }
    });
    written?;
    match first_error {
        _ if counts.parser.frames == 0 => Err(LogError::Foreign(log.len())),
        Some(DecodeError::NoConfiguration) => Err(LogError::NoConfiguration(counts.unreadable)),
        Some(reason) if counts.rows == 0 && counts.unreadable > 0 => {
            Err(LogError::Unreadable { frames: counts.unreadable, reason })
        }
        _ => Ok(counts),
    }
}

fn csv_row(m: &Measurement, row: &mut String) {
    use std::fmt::Write as _;
    row.clear();
    // Writing to a string cannot fail.
    if let Some(counter) = m.counter {
        let _ = write!(row, "{counter}");
    }
    row.push(',');
    if let Some(fine) = m.sample_time_fine {
        let _ = write!(row, "{fine}");
    }
    let mut numbers = |values: Option<&[f64]>, n: usize| {
        for i in 0..n {
            row.push(',');
            if let Some(value) = values.and_then(|v| v.get(i)) {
                let _ = write!(row, "{value}");
            }
        }
    };
    numbers(m.acceleration.as_ref().or(m.acceleration_hr.as_ref()).map(|v| v.as_slice()), 3);
    numbers(
        m.angular_velocity.as_ref().or(m.angular_velocity_hr.as_ref()).map(|v| v.as_slice()),
        3,
    );
    numbers(m.quaternion().as_ref().map(|v| v.as_slice()), 4);
    row.push('\n');
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::frame;

    fn table(log: &[u8], format: Option<LegacyFormat>) -> Result<(String, LogCounts), LogError> {
        let mut out = Vec::new();
        let counts = decode_to_csv(log, format, &mut out)?;
        Ok((String::from_utf8(out).unwrap(), counts))
    }

    #[test]
    fn the_format_is_read_from_the_argument_or_the_log() {
        let mut data = Vec::new();
        let m = Measurement {
            counter: Some(7),
            acceleration: Some([1.0, 2.0, 9.5]),
            ..Measurement::default()
        };
        LegacyFormat::STANDARD.encode(&m, &mut data);
        let log = frame(MessageId::MT_DATA, &data);
        assert!(matches!(table(&log, None), Err(LogError::NoConfiguration(1))));
        let (text, counts) = table(&log, Some(LegacyFormat::STANDARD)).unwrap();
        assert_eq!(text, format!("{CSV_HEADER}\n7,,1,2,9.5,0,0,0,1,0,0,0\n"));
        assert_eq!((counts.rows, counts.parser.frames), (1, 1));
        let configuration =
            Configuration { format: LegacyFormat::STANDARD, ..Configuration::default() };
        let framed = frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data());
        assert_eq!(saved_configuration(&framed).unwrap(), Some(LegacyFormat::STANDARD));
        assert_eq!(
            saved_configuration(&configuration.to_data()).unwrap(),
            Some(LegacyFormat::STANDARD)
        );
        assert_eq!(saved_configuration(&[0x10, 0x20, 0xFF, 0xFF]).unwrap(), None);
        assert!(saved_configuration(&[1, 2, 3]).is_err());
        let with_configuration = [log.clone(), framed].concat();
        assert_eq!(table(&with_configuration, None).unwrap().1.rows, 1);
        let wrong = LegacyFormat::default();
        assert!(matches!(table(&log, Some(wrong)), Err(LogError::Unreadable { frames: 1, .. })));
    }

    #[test]
    fn invalid_logs_are_rejected() {
        assert!(matches!(table(&[], None), Err(LogError::Empty)));
        assert!(matches!(table(b"not a log", None), Err(LogError::Foreign(9))));
        let cut = frame(MessageId::MT_DATA2, &[0x10, 0x20, 2, 1, 2]);
        let log = [&cut[..], &cut[..6]].concat();
        let (_, counts) = table(&log, None).unwrap();
        assert_eq!((counts.rows, counts.parser.skipped_bytes), (1, 6));
    }
}
