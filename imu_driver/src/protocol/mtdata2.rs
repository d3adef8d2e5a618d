//! MTData2, the data message of the MTi-1, 10, 100, 600 series.
//!
//! A list of `identifier u16 | size u8 | data`; items that the driver does not use are skipped.

use super::{
    DecodeError, OutputEntry,
    configuration::message_rate,
    measurement::{Attitude, GlobalFrame, Measurement, Orientation, Status},
    number::{NumberFormat, Reader},
};

/// Data identifiers without their low nibble (number format and global frame).
pub mod xdi {
    macro_rules! identifiers {
        ($($name:ident = $id:literal, $text:literal;)*) => {
            $(#[doc = concat!("Identifier of ", $text, ".")] pub const $name: u16 = $id;)*

            /// Name of the data; the low nibble of the identifier is ignored.
            pub fn name(id: u16) -> &'static str {
                match id & 0xFFF0 {
                    $($id => $text,)*
                    _ => "other",
                }
            }
        };
    }

    identifiers! {
        TEMPERATURE = 0x0810, "temperature";
        UTC = 0x1010, "date and time";
        COUNTER = 0x1020, "counter";
        SAMPLE_TIME_FINE = 0x1060, "sample time, ticks of 0.1 ms";
        SAMPLE_TIME_COARSE = 0x1070, "sample time, s";
        QUATERNION = 0x2010, "quaternion";
        MATRIX = 0x2020, "rotation matrix";
        EULER = 0x2030, "Euler angles";
        PRESSURE = 0x3010, "pressure";
        DELTA_VELOCITY = 0x4010, "velocity increment";
        ACCELERATION = 0x4020, "specific force";
        FREE_ACCELERATION = 0x4030, "acceleration without gravity";
        ACCELERATION_HR = 0x4040, "specific force, high-rate channel";
        ALTITUDE = 0x5020, "height above the ellipsoid";
        POSITION_ECEF = 0x5030, "Earth-centered position";
        LATITUDE_LONGITUDE = 0x5040, "latitude and longitude";
        GNSS_PVT = 0x7010, "GNSS solution";
        GNSS_SATELLITES = 0x7020, "GNSS satellites";
        ANGULAR_VELOCITY = 0x8020, "angular velocity";
        DELTA_ORIENTATION = 0x8030, "orientation increment";
        ANGULAR_VELOCITY_HR = 0x8040, "angular velocity, high-rate channel";
        MAGNETIC_FIELD = 0xC020, "magnetic field";
        VELOCITY = 0xD010, "velocity";
        STATUS_BYTE = 0xE010, "status byte";
        STATUS_WORD = 0xE020, "status word";
    }
}

/// Length of the data of a message with these outputs, bytes; the rarer ones are not in all.
///
/// Knows the sizes of the outputs that the driver sets.
pub fn data_length(outputs: &[OutputEntry]) -> usize {
    let rate = message_rate(outputs).unwrap_or(u16::MAX);
    let frequent = outputs.iter().filter(|output| output.rate >= rate);
    let length = |id: u16| {
        let number = NumberFormat::from_bits(u32::from(id)).size();
        match id & 0xFFF0 {
            xdi::COUNTER => 2,
            xdi::SAMPLE_TIME_FINE | xdi::STATUS_WORD => 4,
            xdi::TEMPERATURE => number,
            xdi::QUATERNION => 4 * number,
            _ => 3 * number,
        }
    };
    frequent.map(|output| 3 + length(output.id)).sum()
}

/// Decodes the data of one MTData2 message.
///
/// # Errors
/// [`DecodeError::Overrun`] if an item exceeds the data, [`DecodeError::ItemSize`] if a known item
/// does not have the size of its identifier.
#[inline]
pub fn decode(data: &[u8]) -> Result<Measurement, DecodeError> {
    let mut m = Measurement::default();
    let r = &mut Reader::new(data);
    while !r.rest().is_empty() {
        let offset = data.len() - r.rest().len();
        let overrun = DecodeError::Overrun { offset, length: data.len() };
        let (Some(id), Some(size)) = (r.u16(), r.u8()) else {
            return Err(overrun);
        };
        let Some(item) = r.take(usize::from(size)) else {
            return Err(overrun);
        };
        let mut item_reader = Reader::new(item);
        if read_item(&mut m, id, &mut item_reader).is_none() || !item_reader.rest().is_empty() {
            return Err(DecodeError::ItemSize { id, size });
        }
    }
    Ok(m)
}

fn read_item(m: &mut Measurement, id: u16, r: &mut Reader<'_>) -> Option<()> {
    let format = NumberFormat::from_bits(u32::from(id));
    let frame = match (id >> 2) & 3 {
        0 => Some(GlobalFrame::EastNorthUp),
        1 => Some(GlobalFrame::NorthEastDown),
        2 => Some(GlobalFrame::NorthWestUp),
        _ => None,
    };
    let attitude = |m: &mut Measurement, attitude| {
        let free = m.orientations.iter_mut().find(|slot| slot.is_none());
        if let (Some(frame), Some(slot)) = (frame, free) {
            *slot = Some(Orientation { attitude, frame });
        }
    };
    match id & 0xFFF0 {
        xdi::TEMPERATURE => m.temperature = Some(r.numbers::<1>(format)?[0]),
        xdi::COUNTER => m.counter = Some(r.u16()?),
        xdi::SAMPLE_TIME_FINE => m.sample_time_fine = Some(r.u32()?),
        xdi::QUATERNION => attitude(m, Attitude::Quaternion(r.numbers(format)?)),
        xdi::MATRIX => attitude(m, Attitude::Matrix(r.numbers(format)?)),
        xdi::EULER => attitude(m, Attitude::Euler(r.numbers(format)?)),
        xdi::DELTA_VELOCITY => m.delta_velocity = Some(r.numbers(format)?),
        xdi::ACCELERATION => m.acceleration = Some(r.numbers(format)?),
        xdi::ACCELERATION_HR => m.acceleration_hr = Some(r.numbers(format)?),
        xdi::ANGULAR_VELOCITY => m.angular_velocity = Some(r.numbers(format)?),
        xdi::DELTA_ORIENTATION => m.delta_orientation = Some(r.numbers(format)?),
        xdi::ANGULAR_VELOCITY_HR => m.angular_velocity_hr = Some(r.numbers(format)?),
        xdi::MAGNETIC_FIELD => m.magnetic_field = Some(r.numbers(format)?),
        // A status word takes precedence over a status byte, in any order.
        xdi::STATUS_BYTE => {
            let byte = u32::from(r.u8()?);
            m.status = m.status.or(Some(Status::from_bits_retain(byte)));
        }
        xdi::STATUS_WORD => m.status = Some(Status::from_bits_retain(r.u32()?)),
        other => {
            m.other_inertial |= other == xdi::FREE_ACCELERATION;
            r.take(r.rest().len())?;
        }
    }
    Some(())
}

/// Appends the items in `m`, with numbers in `format`: the inverse of [`decode`], without the
/// increments and the high-rate channels, which the simulated IMU does not send.
pub fn encode(m: &Measurement, format: NumberFormat, out: &mut Vec<u8>) {
    let bits = format.bits() as u16;
    fn head(out: &mut Vec<u8>, id: u16, size: usize) {
        out.extend_from_slice(&id.to_be_bytes());
        out.push(size as u8);
    }
    let numbers = |out: &mut Vec<u8>, id: u16, values: Option<&[f64]>| {
        if let Some(values) = values {
            head(out, id | bits, values.len() * format.size());
            values.iter().for_each(|v| format.write(*v, out));
        }
    };
    let words = |out: &mut Vec<u8>, id: u16, value: Option<u32>| {
        if let Some(value) = value {
            head(out, id, 4);
            out.extend_from_slice(&value.to_be_bytes());
        }
    };
    if let Some(counter) = m.counter {
        head(out, xdi::COUNTER, 2);
        out.extend_from_slice(&counter.to_be_bytes());
    }
    words(out, xdi::SAMPLE_TIME_FINE, m.sample_time_fine);
    numbers(out, xdi::TEMPERATURE, m.temperature.as_ref().map(std::slice::from_ref));
    for orientation in m.orientations.iter().flatten() {
        let frame = match orientation.frame {
            GlobalFrame::EastNorthUp => 0,
            GlobalFrame::NorthEastDown => 4,
            GlobalFrame::NorthWestUp => 8,
        };
        let id = match orientation.attitude {
            Attitude::Quaternion(_) => xdi::QUATERNION,
            Attitude::Matrix(_) => xdi::MATRIX,
            Attitude::Euler(_) => xdi::EULER,
        };
        numbers(out, id | frame, Some(orientation.attitude.numbers()));
    }
    for (id, vector) in [
        (xdi::ACCELERATION, &m.acceleration),
        (xdi::ANGULAR_VELOCITY, &m.angular_velocity),
        (xdi::MAGNETIC_FIELD, &m.magnetic_field),
    ] {
        numbers(out, id, vector.as_ref().map(|v| v.as_slice()));
    }
    words(out, xdi::STATUS_WORD, m.status.map(|s| s.bits()));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_length_follows_from_the_outputs() {
        let orientation = Orientation {
            attitude: Attitude::Quaternion([1.0, 0.0, 0.0, 0.0]),
            frame: GlobalFrame::EastNorthUp,
        };
        let m = Measurement {
            counter: Some(1),
            sample_time_fine: Some(2),
            acceleration: Some([0.0; 3]),
            temperature: Some(25.0),
            orientations: [Some(orientation), None, None],
            status: Some(Status::empty()),
            ..Measurement::default()
        };
        for format in NumberFormat::ALL {
            let mut data = Vec::new();
            encode(&m, format, &mut data);
            let output =
                |(id, rate): (u16, u16)| OutputEntry { id: id | format.bits() as u16, rate };
            let mut outputs = [
                (xdi::COUNTER, u16::MAX),
                (xdi::SAMPLE_TIME_FINE, u16::MAX),
                (xdi::ACCELERATION, 100),
                (xdi::TEMPERATURE, 100),
                (xdi::QUATERNION, 100),
                (xdi::STATUS_WORD, u16::MAX),
            ]
            .map(output);
            assert_eq!(data_length(&outputs), data.len());
            outputs[3].rate = 1;
            assert_eq!(data_length(&outputs), data.len() - 3 - format.size());
        }
    }

    #[test]
    fn unknown_items_are_skipped() {
        let data = [0x12, 0x34, 2, 9, 9, 0x10, 0x20, 2, 0x01, 0x02, 0x70, 0x10, 1, 7];
        let m = decode(&data).unwrap();
        assert_eq!((m.counter, m.is_inertial()), (Some(0x0102), false));
    }

    #[test]
    fn invalid_sizes_are_rejected() {
        assert_eq!(
            decode(&[0x10, 0x20, 3, 1, 2, 3]),
            Err(DecodeError::ItemSize { id: 0x1020, size: 3 })
        );
        assert_eq!(decode(&[0x10, 0x20, 1, 1]), Err(DecodeError::ItemSize { id: 0x1020, size: 1 }));
        assert_eq!(decode(&[0x10, 0x20, 9, 1]), Err(DecodeError::Overrun { offset: 0, length: 4 }));
        assert_eq!(decode(&[0x10]), Err(DecodeError::Overrun { offset: 0, length: 1 }));
        assert_eq!(decode(&[]), Ok(Measurement::default()));
    }
}
