//! CDR, the bytes of a message on the wire and in a bag: a header of four bytes (`00 01 00 00` little endian, `00 00 …`
//! big endian), then the fields, each aligned to its own size from the end of the header.
//!
//! Reading never panics and never reserves more than the bytes at hand can hold, whatever lengths they claim.

use thiserror::Error;

/// Why bytes are not a message of the type.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CdrError {
    /// The first four bytes are not those of plain CDR.
    #[error("the bytes begin with {header:02x?}, which is not plain CDR (00 00 or 00 01)")]
    Encapsulation {
        /// What was there, at most four bytes.
        header: Vec<u8>,
    },
    /// The bytes end inside a field.
    #[error("the bytes end inside {field} ({needed} more needed, {left} left)")]
    End {
        /// Which field.
        field: &'static str,
        /// Bytes needed.
        needed: usize,
        /// Bytes left.
        left: usize,
    },
    /// A list longer than its bound.
    #[error("{field} holds {found} elements, its bound is {bound}")]
    Bound {
        /// Which field.
        field: &'static str,
        /// How many the bytes claim.
        found: usize,
        /// How many may be.
        bound: usize,
    },
    /// A value that the type cannot have.
    #[error("{field} is not {expected}")]
    Value {
        /// Which field.
        field: &'static str,
        /// What it should be.
        expected: &'static str,
    },
    /// Bytes after the last field: the message is of another type.
    #[error("{count} bytes are left after the last field: the bytes are of another type")]
    Trailing {
        /// How many.
        count: usize,
    },
}

impl CdrError {
    /// Names the field, unless a field inside of it was named already.
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

/// Collects the bytes of a message.
#[derive(Debug)]
pub struct Writer {
    bytes: Vec<u8>,
}

/// Bytes before the first field; alignment counts from here.
const HEADER: usize = 4;
/// Writers may pad the end of a message to their own liking.
const LARGEST_PADDING: usize = 7;

impl Writer {
    fn align(&mut self, size: usize) {
        let over = (self.bytes.len() - HEADER) % size;
        if over != 0 {
            self.bytes.resize(self.bytes.len() + size - over, 0);
        }
    }

    fn length(&mut self, length: usize) {
        // A list of 2^32 elements does not fit any message; were it to happen, the reader refuses the rest.
        (length.min(u32::MAX as usize) as u32).write(self);
    }
}

/// Walks through the bytes of a message.
#[derive(Debug)]
pub struct Reader<'a> {
    /// After the header.
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

    /// A length that the bytes left could hold.
    fn length(&mut self, element: usize) -> Result<usize, CdrError> {
        let count = u32::read(self)? as usize;
        let needed = count.saturating_mul(element);
        if needed > self.left() {
            return Err(CdrError::End { field: "", needed, left: self.left() });
        }
        Ok(count)
    }
}

/// A type with a CDR form.
pub trait Cdr: Sized {
    /// Fewest bytes that a value takes; at least one.
    const MIN_SIZE: usize;

    /// Appends the value.
    fn write(&self, to: &mut Writer);

    /// Reads a value.
    ///
    /// # Errors
    /// [`CdrError`] where the bytes are not such a value.
    fn read(from: &mut Reader<'_>) -> Result<Self, CdrError>;

    /// Appends several values.
    fn write_all(items: &[Self], to: &mut Writer) {
        items.iter().for_each(|item| item.write(to));
    }

    /// Reads `count` values.
    ///
    /// # Errors
    /// As for [`Cdr::read`].
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
                Ok(if from.big_endian { Self::from_be_bytes(own) } else { Self::from_le_bytes(own) })
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

    // Images: one copy instead of a million pushes.
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
    /// The length alone: some writers send an empty string without its closing zero.
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
            Some(_) => return Err(CdrError::Value { field: "", expected: "a string that ends with a zero" }),
        };
        String::from_utf8(text.to_vec())
            .map_err(|_| CdrError::Value { field: "", expected: "a string in UTF-8" })
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
            .map_err(|_| CdrError::Value { field: "", expected: "a list of its fixed length" })
    }
}

/// A list with a bound.
///
/// # Errors
/// [`CdrError::Bound`] beyond it, and as for [`Cdr::read`].
pub fn read_bounded<T: Cdr>(from: &mut Reader<'_>, bound: usize) -> Result<Vec<T>, CdrError> {
    let found = from.length(T::MIN_SIZE)?;
    if found > bound {
        return Err(CdrError::Bound { field: "", found, bound });
    }
    T::read_all(found, from)
}

/// The message's bytes, little endian, header included: what a bag holds and what goes over the wire.
pub fn to_bytes<T: Cdr>(message: &T) -> Vec<u8> {
    let mut writer = Writer { bytes: Vec::with_capacity(HEADER + T::MIN_SIZE) };
    writer.bytes.extend_from_slice(&[0, 1, 0, 0]);
    message.write(&mut writer);
    writer.bytes
}

/// The message from its bytes, header included.
///
/// # Errors
/// [`CdrError`] that names the field: bytes that end too early or go on, lengths beyond the bytes at hand or a bound,
/// strings that are not UTF-8, bools that are neither 0 nor 1, other encodings than plain CDR.
pub fn from_bytes<T: Cdr>(bytes: &[u8]) -> Result<T, CdrError> {
    let big_endian = match bytes {
        [0, 0, _, _, ..] => true,
        [0, 1, _, _, ..] => false,
        _ => return Err(CdrError::Encapsulation { header: bytes[..bytes.len().min(HEADER)].to_vec() }),
    };
    let mut reader = Reader { body: &bytes[HEADER..], position: 0, big_endian };
    let message = T::read(&mut reader)?;
    if reader.left() > LARGEST_PADDING {
        return Err(CdrError::Trailing { count: reader.left() });
    }
    Ok(message)
}
