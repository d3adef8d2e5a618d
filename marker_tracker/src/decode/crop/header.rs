//! Headers of a JPEG (ITU-T T.81, annex B) of one baseline scan.

use super::{entropy::BitWriter, huffman::Codes};

/// A Huffman table with its definition.
#[derive(Clone, Debug, Default)]
struct Table {
    /// Number of codes of each length, and their values.
    definition: Vec<u8>,
    codes: Option<Codes>,
    /// Whether this image defines it.
    is_defined: bool,
}

/// What the headers of an image say. Tables are kept from image to image: a camera's seldom change.
#[derive(Debug, Default)]
pub(super) struct Header {
    /// px.
    pub width: usize,
    pub height: usize,
    /// Blocks of luma per block of chroma, across and down.
    pub sampling: [usize; 2],
    /// Number of groups of blocks between restarts; 0 without restarts.
    pub restart_interval: usize,
    /// Tables 0 and 1 of the DC coefficients, and of the AC coefficients.
    tables: [[Table; 2]; 2],
    /// Segments with the quantization tables.
    quantization: Vec<u8>,
    /// Identifier and quantization table of each component.
    components: [[u8; 2]; 3],
    /// Of each component, DC and AC.
    selected: [[usize; 2]; 3],
}

impl Header {
    /// Reads the headers; returns where the scan's data start. `None` where they are not those of a
    /// color image of 8 bits in one baseline scan whose first component alone has several blocks.
    pub fn read(&mut self, jpeg: &[u8]) -> Option<usize> {
        self.quantization.clear();
        (self.width, self.height, self.restart_interval) = (0, 0, 0);
        self.tables.iter_mut().flatten().for_each(|t| t.is_defined = false);
        let mut at = 2;
        loop {
            let &[0xff, marker, high, low] = jpeg.get(at..at + 4)? else { return None };
            let end = at + 2 + usize::from(u16::from_be_bytes([high, low]));
            let segment = jpeg.get(at + 4..end)?;
            match marker {
                0xc0 => self.read_frame(segment)?,
                0xc4 => self.read_tables(segment)?,
                0xda => return self.read_scan(segment).map(|()| end),
                0xdb => self.quantization.extend_from_slice(&jpeg[at..end]),
                0xdd => {
                    let &[high, low] = segment else { return None };
                    self.restart_interval = usize::from(u16::from_be_bytes([high, low]));
                }
                // Applications' data and comments, but for the one that changes the color space.
                0xe0..=0xed | 0xef | 0xfe => {}
                _ => return None,
            }
            at = end;
        }
    }

    fn read_frame(&mut self, segment: &[u8]) -> Option<()> {
        let &[8, h1, h0, w1, w0, 3, a, s, qa, b, 0x11, qb, c, 0x11, qc] = segment else {
            return None;
        };
        if self.width > 0 {
            return None;
        }
        self.width = usize::from(u16::from_be_bytes([w1, w0]));
        self.height = usize::from(u16::from_be_bytes([h1, h0]));
        self.sampling = [usize::from(s >> 4), usize::from(s & 15)];
        self.components = [[a, qa], [b, qb], [c, qc]];
        let is_usual = self.sampling.iter().all(|s| (1..=2).contains(s));
        (is_usual && self.width > 0 && self.height > 0).then_some(())
    }

    fn read_tables(&mut self, mut segment: &[u8]) -> Option<()> {
        while let Some((selector, rest)) = segment.split_first() {
            let counts = rest.get(..16)?;
            let length = 16 + counts.iter().map(|c| usize::from(*c)).sum::<usize>();
            let definition = rest.get(..length)?;
            let table = self
                .tables
                .get_mut(usize::from(selector >> 4))?
                .get_mut(usize::from(selector & 15))?;
            if table.definition != definition {
                table.definition.clear();
                table.definition.extend_from_slice(definition);
                table.codes = Codes::new(counts, &definition[16..]);
            }
            table.is_defined = true;
            segment = &rest[length..];
        }
        Some(())
    }

    fn read_scan(&mut self, segment: &[u8]) -> Option<()> {
        let &[3, a, ta, b, tb, c, tc, 0, 63, 0] = segment else { return None };
        if self.width == 0 || [a, b, c] != self.components.map(|c| c[0]) {
            return None;
        }
        self.selected = [ta, tb, tc].map(|t| [usize::from(t >> 4), usize::from(t & 15)]);
        Some(())
    }

    /// DC and AC codes of each component; `None` where one is missing or invalid.
    pub fn tables(&self) -> Option<[(&Codes, &Codes); 3]> {
        let table = |class: usize, id: usize| {
            self.tables[class].get(id).filter(|t| t.is_defined)?.codes.as_ref()
        };
        let of = |component: usize| {
            let [dc, ac] = self.selected[component];
            Some((table(0, dc)?, table(1, ac)?))
        };
        Some([of(0)?, of(1)?, of(2)?])
    }

    /// Appends the headers of an image of another size (px) with the same AC codes, and with
    /// [`BitWriter`]'s for the DC coefficients.
    pub fn write(&self, jpeg: &mut Vec<u8>, width: usize, height: usize) {
        jpeg.extend_from_slice(&[0xff, 0xd8]);
        jpeg.extend_from_slice(&self.quantization);
        let [[a, qa], [b, qb], [c, qc]] = self.components;
        let side = |n: usize| (n as u16).to_be_bytes();
        let ([h1, h0], [w1, w0]) = (side(height), side(width));
        let sampling = ((self.sampling[0] << 4) | self.sampling[1]) as u8;
        let frame = [8, h1, h0, w1, w0, 3, a, sampling, qa, b, 0x11, qb, c, 0x11, qc];
        append(jpeg, 0xc0, &[&frame]);
        append(jpeg, 0xc4, &[&[0], &BitWriter::COUNTS, &[0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11]]);
        for (id, table) in (0..).zip(&self.tables[1]).filter(|(_, t)| t.is_defined) {
            append(jpeg, 0xc4, &[&[0x10 + id], &table.definition]);
        }
        let [ta, tb, tc] = self.selected.map(|[_, ac]| ac as u8);
        append(jpeg, 0xda, &[&[3, a, ta, b, tb, c, tc, 0, 63, 0]]);
    }
}

/// Appends a segment of these parts.
fn append(jpeg: &mut Vec<u8>, marker: u8, parts: &[&[u8]]) {
    let length = 2 + parts.iter().map(|p| p.len()).sum::<usize>();
    jpeg.extend_from_slice(&[0xff, marker]);
    jpeg.extend_from_slice(&(length as u16).to_be_bytes());
    parts.iter().for_each(|part| jpeg.extend_from_slice(part));
}
