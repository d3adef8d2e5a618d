//! CDR, the encoding of messages on the wire and in bags (OMG DDSI-RTPS 2.5, section 10).
//!
//! A header of four bytes (`00 01 00 00` little endian, `00 00 …` big endian) precedes the fields;
//! each field is aligned to its own size, counted from the end of the header.
//!
//! Reading cannot panic: every slice is checked against the remaining bytes, and no allocation
//! exceeds what they can hold, whatever lengths they claim.

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
    /// The bytes end inside a field.
    #[error("the bytes end inside {field} ({needed} more needed, {left} left)")]
    End {
        /// `package/msg/Type.field`.
        field: &'static str,
        /// Bytes needed.
        needed: usize,
        /// Bytes left.
        left: usize,
    },
    /// A sequence is longer than its bound.
    #[error("{field} has {found} elements, more than its bound of {bound}")]
    Bound {
        /// `package/msg/Type.field`.
        field: &'static str,
        /// Number of elements in the bytes.
        found: usize,
        /// Largest number of elements.
        bound: usize,
    },
    /// A value is invalid for its type.
    #[error("{field} is not {expected}")]
    Value {
        /// `package/msg/Type.field`.
        field: &'static str,
        /// Valid values.
        expected: &'static str,
    },
    /// Bytes remain after the last field: the message has another type.
    #[error("{count} bytes remain after the last field: the message has another type")]
    Trailing {
        /// Number of bytes.
        count: usize,
    },
}

impl CdrError {
    /// Adds the name of the field, unless a nested field was named already.
    pub fn inside(mut self, place: &'static str) -> Self {
        match &mut self {
            Self::End { field, .. } | Self::Bound { field, .. } | Self::Value { field, .. }
                if field.is_empty() =>
            {
                *field = place;
            }
            _ => {}
        }
        self
    }
}

/// Encoder of a message.
#[derive(Debug)]
pub struct Writer {
    bytes: Vec<u8>,
}

/// Length of the header; alignment counts from its end.
const HEADER: usize = 4;
/// Most bytes of padding that writers add at the end of a message.
const LARGEST_PADDING: usize = 7;

impl Writer {
    fn align(&mut self, size: usize) {
        let over = (self.bytes.len() - HEADER) % size;
        if over != 0 {
            self.bytes.resize(self.bytes.len() + size - over, 0);
        }
    }

    fn length(&mut self, length: usize) {
        // Longer sequences do not fit into a message; a reader rejects the bytes that follow.
        (length.min(u32::MAX as usize) as u32).write(self);
    }
}

/// Decoder of a message.
#[derive(Debug)]
pub struct Reader<'a> {
    /// Bytes after the header.
    body: &'a [u8],
    position: usize,
    big_endian: bool,
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize, align: usize) -> Result<&'a [u8], CdrError> {
        let start = self.position.next_multiple_of(align);
        let left = self.body.len().saturating_sub(start);
        if count > left {
            return Err(CdrError::End { field: "", needed: count, left });
        }
        self.position = start + count;
        Ok(&self.body[start..start + count])
    }

    fn left(&self) -> usize {
        self.body.len() - self.position
    }

    /// Reads a number of elements and checks it against the remaining bytes.
    fn length(&mut self, element: usize) -> Result<usize, CdrError> {
        let count = u32::read(self)? as usize;
        let needed = count.saturating_mul(element);
        if needed > self.left() {
            return Err(CdrError::End { field: "", needed, left: self.left() });
        }
        Ok(count)
    }
}

/// A type with a CDR encoding.
pub trait Cdr: Sized {
    /// Smallest encoded size, bytes; at least one.
    const MIN_SIZE: usize;

    /// Appends the encoded value.
    fn write(&self, to: &mut Writer);

    /// Decodes a value.
    ///
    /// # Errors
    /// [`CdrError`] if the bytes are no valid encoding.
    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError>;

    /// Appends the encoded values without a length.
    fn write_all(items: &[Self], to: &mut Writer) {
        items.iter().for_each(|item| item.write(to));
    }

    /// Decodes `count` values.
    ///
    /// # Errors
    /// As [`Cdr::read`].
    fn read_all(count: usize, from: &mut Reader<'_>) -> Result<Vec<Self>, CdrError> {
        let mut items = Vec::with_capacity(count.min(from.left() / Self::MIN_SIZE));
        for _ in 0..count {
            items.push(Self::read(from)?);
        }
        Ok(items)
    }
}

macro_rules! number {
    ($($number:ty)*) => {$(
        impl Cdr for $number {
            const MIN_SIZE: usize = size_of::<Self>();

            fn write(&self, to: &mut Writer) {
                to.align(Self::MIN_SIZE);
                to.bytes.extend_from_slice(&self.to_le_bytes());
            }

            fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
                let bytes = from.take(Self::MIN_SIZE, Self::MIN_SIZE)?;
                let mut own = [0; size_of::<$number>()];
                own.copy_from_slice(bytes);
                let little = Self::from_le_bytes;
                Ok(if from.big_endian { Self::from_be_bytes(own) } else { little(own) })
            }
        }
    )*};
}
number!(i8 i16 u16 i32 u32 i64 u64 f32 f64);

impl Cdr for u8 {
    const MIN_SIZE: usize = 1;

    fn write(&self, to: &mut Writer) {
        to.bytes.push(*self);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        Ok(from.take(1, 1)?[0])
    }

    // Images: one copy instead of one push per byte.
    fn write_all(items: &[Self], to: &mut Writer) {
        to.bytes.extend_from_slice(items);
    }

    fn read_all(count: usize, from: &mut Reader<'_>) -> Result<Vec<Self>, CdrError> {
        Ok(from.take(count, 1)?.to_vec())
    }
}

impl Cdr for bool {
    const MIN_SIZE: usize = 1;

    fn write(&self, to: &mut Writer) {
        to.bytes.push(u8::from(*self));
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        match u8::read(from)? {
            0 => Ok(false),
            1 => Ok(true),
            _ => Err(CdrError::Value { field: "", expected: "a bool (0 or 1)" }),
        }
    }
}

impl Cdr for String {
    /// The length alone: some writers omit the terminating zero of an empty string.
    const MIN_SIZE: usize = 4;

    fn write(&self, to: &mut Writer) {
        to.length(self.len() + 1);
        to.bytes.extend_from_slice(self.as_bytes());
        to.bytes.push(0);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let length = from.length(1)?;
        let bytes = from.take(length, 1)?;
        let text = match bytes.split_last() {
            None => bytes,
            Some((0, text)) => text,
            Some(_) => {
                return Err(CdrError::Value { field: "", expected: "a zero-terminated string" });
            }
        };
        String::from_utf8(text.to_vec())
            .map_err(|_| CdrError::Value { field: "", expected: "valid UTF-8" })
    }
}

impl<T: Cdr> Cdr for Vec<T> {
    const MIN_SIZE: usize = 4;

    fn write(&self, to: &mut Writer) {
        to.length(self.len());
        T::write_all(self, to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        let count = from.length(T::MIN_SIZE)?;
        T::read_all(count, from)
    }
}

impl<T: Cdr, const N: usize> Cdr for [T; N] {
    const MIN_SIZE: usize = N * T::MIN_SIZE;

    fn write(&self, to: &mut Writer) {
        T::write_all(self, to);
    }

    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError> {
        T::read_all(N, from)?
            .try_into()
            .map_err(|_| CdrError::Value { field: "", expected: "an array of its fixed length" })
    }
}

/// Decodes a sequence of at most `bound` elements.
///
/// # Errors
/// [`CdrError::Bound`] for a longer one; otherwise as [`Cdr::read`].
pub fn read_bounded<T: Cdr>(from: &mut Reader<'_>, bound: usize) -> Result<Vec<T>, CdrError> {
    let found = from.length(T::MIN_SIZE)?;
    if found > bound {
        return Err(CdrError::Bound { field: "", found, bound });
    }
    T::read_all(found, from)
}

/// Encodes a message in little endian, header included, as in a bag and on the wire.
pub fn to_bytes<T: Cdr>(message: &T) -> Vec<u8> {
    let mut writer = Writer { bytes: Vec::with_capacity(HEADER + T::MIN_SIZE) };
    writer.bytes.extend_from_slice(&[0, 1, 0, 0]);
    message.write(&mut writer);
    writer.bytes
}

/// Decodes a message in either byte order, header included.
///
/// # Errors
/// [`CdrError`] with the name of the field: missing or excess bytes, a length beyond the bytes or
/// the bound, invalid UTF-8, a bool other than 0 or 1, an encoding other than plain CDR.
pub fn from_bytes<T: Cdr>(bytes: &[u8]) -> Result<T, CdrError> {
    let big_endian = match bytes {
        [0, 0, _, _, ..] => true,
        [0, 1, _, _, ..] => false,
        _ => {
            return Err(CdrError::Encapsulation {
                header: bytes[..bytes.len().min(HEADER)].to_vec(),
            });
        }
    };
    let mut reader = Reader { body: &bytes[HEADER..], position: 0, big_endian };
    let message = T::read(&mut reader)?;
    if reader.left() > LARGEST_PADDING {
        return Err(CdrError::Trailing { count: reader.left() });
    }
    Ok(message)
}
