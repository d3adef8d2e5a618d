//! Reading what a person names: parameter, rig and calibration files. In flow a path, out flow its text, up to a size that
//! no such file has: `--params-file /dev/zero` is an error, not the end of the machine's memory.

use std::{
    fs::File,
    io::{self, ErrorKind, Read},
    path::Path,
};

/// Largest text that is read, bytes.
pub const LARGEST_TEXT: u64 = 1 << 20;

/// The text of a file.
///
/// # Errors
/// What the operating system says; [`ErrorKind::FileTooLarge`] beyond [`LARGEST_TEXT`]; [`ErrorKind::InvalidData`] for
/// what is not UTF-8.
pub fn read_text(path: &Path) -> io::Result<String> {
    let mut text = String::new();
    File::open(path)?.take(LARGEST_TEXT + 1).read_to_string(&mut text)?;
    if text.len() as u64 > LARGEST_TEXT {
        let mebibytes = LARGEST_TEXT >> 20;
        return Err(io::Error::new(
            ErrorKind::FileTooLarge,
            format!("it is larger than {mebibytes} MiB, which no file of this kind is"),
        ));
    }
    Ok(text)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_read_and_what_never_ends_is_refused() {
        let path = std::env::temp_dir().join(format!("volant-files-{}", std::process::id()));
        std::fs::write(&path, "a: 1\n").unwrap();
        assert_eq!(read_text(&path).unwrap(), "a: 1\n");
        std::fs::write(&path, [0xFF, 0xFE]).unwrap();
        assert_eq!(read_text(&path).unwrap_err().kind(), ErrorKind::InvalidData);
        std::fs::remove_file(&path).unwrap();
        assert_eq!(read_text(&path).unwrap_err().kind(), ErrorKind::NotFound);
        assert_eq!(read_text(Path::new("/dev/zero")).unwrap_err().kind(), ErrorKind::FileTooLarge);
    }
}
