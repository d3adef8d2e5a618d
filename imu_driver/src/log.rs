//! Recorded bytes → CSV with one row per data message, and counts.

use crate::protocol::{
    Configuration, DecodeError, Decoder, FrameParser, LegacyFormat, Measurement, MessageId,
    ParserCounts, configuration::output_configuration_from_data,
};
use std::io::{self, Write};
use thiserror::Error;

/// Header of the CSV.
pub const CSV_HEADER: &str =
    "counter,sample_time_fine,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,q_w,q_x,q_y,q_z";

/// Error of decoding a log.
#[derive(Debug, Error)]
pub enum LogError {
    /// No message can be decoded, with the reason and the remedy.
    #[error("{0}")]
    Invalid(String),
    /// The CSV was not written.
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
/// The bytes are neither.
pub fn saved_configuration(bytes: &[u8]) -> Result<Option<LegacyFormat>, String> {
    if let Some(format) = configuration_in(bytes) {
        return Ok(Some(format));
    }
    if let Ok(configuration) = Configuration::from_data(bytes) {
        return Ok(Some(configuration.format));
    }
    let mut framed = false;
    FrameParser::new()
        .parse(bytes, |f| framed |= f.message == MessageId::OUTPUT_CONFIGURATION.ack());
    if framed || (!bytes.is_empty() && output_configuration_from_data(bytes).is_ok()) {
        return Ok(None);
    }
    Err(format!(
        "{} bytes are not a Configuration; give the answer to ReqConfiguration (118 bytes, or the \
         frame of 123 bytes) or an output configuration",
        bytes.len()
    ))
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
    let invalid = |reason: String| Err(LogError::Invalid(reason));
    if log.is_empty() {
        return invalid("the log is empty; record one with `volant imu log`".into());
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
    let unreadable = counts.unreadable;
    match first_error {
        _ if counts.parser.frames == 0 => {
            invalid(format!("no valid frame in {} bytes; give the raw bytes of an IMU", log.len()))
        }
        Some(DecodeError::NoConfiguration) => invalid(format!(
            "{unreadable} legacy MTData messages, but no Configuration with their format; give \
             the Configuration of the IMU with --config CONFIGURATION.bin"
        )),
        Some(reason) if counts.rows == 0 && unreadable > 0 => {
            invalid(format!("none of {unreadable} data messages could be decoded: {reason}"))
        }
        _ => Ok(counts),
    }
}

fn csv_row(m: &Measurement, row: &mut String) {
    use std::fmt::Write as _;
    fn numbers<const N: usize>(row: &mut String, values: Option<[f64; N]>) {
        for i in 0..N {
            row.push(',');
            if let Some(values) = values {
                let _ = write!(row, "{}", values[i]);
            }
        }
    }
    row.clear();
    // Writing to a string cannot fail.
    if let Some(counter) = m.counter {
        let _ = write!(row, "{counter}");
    }
    row.push(',');
    if let Some(fine) = m.sample_time_fine {
        let _ = write!(row, "{fine}");
    }
    numbers(row, m.acceleration.or(m.acceleration_hr));
    numbers(row, m.angular_velocity.or(m.angular_velocity_hr));
    numbers(row, m.quaternion());
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
        let error = |log: &[u8], format| table(log, format).unwrap_err().to_string();
        assert!(error(&log, None).starts_with("1 legacy MTData messages, but no Configuration"));
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
        let wrong = Some(LegacyFormat::default());
        assert!(error(&log, wrong).starts_with("none of 1 data messages could be decoded"));
        // MTData2 with counter and SampleTimeFine only.
        let log = frame(MessageId::MT_DATA2, &[0x10, 0x20, 2, 1, 2, 0x10, 0x60, 4, 0, 0, 0, 9]);
        let (text, _) = table(&log, None).unwrap();
        assert_eq!(text, format!("{CSV_HEADER}\n258,9,,,,,,,,,,\n"));
    }

    #[test]
    fn a_frame_that_is_cut_off_is_skipped() {
        let cut = frame(MessageId::MT_DATA2, &[0x10, 0x20, 2, 1, 2]);
        let log = [&cut[..], &cut[..6]].concat();
        let (_, counts) = table(&log, None).unwrap();
        assert_eq!((counts.rows, counts.parser.skipped_bytes), (1, 6));
    }
}
