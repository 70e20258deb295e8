//! Reads text files of settings.

use std::fs::File;
use std::io::{self, Read as _};
use std::path::Path;

/// The largest size of a file of settings, in bytes. Files of a million jobs are smaller.
const LARGEST: u64 = 1 << 28;

/// Reads a text file of settings, such as TOML. Refuses what is not a regular file (a device or a pipe
/// may never end) and files of more than 256 MiB.
///
/// # Errors
/// The errors of the system, and [`InvalidInput`](io::ErrorKind::InvalidInput) or
/// [`InvalidData`](io::ErrorKind::InvalidData) for what is refused and for text that is not UTF-8.
pub fn read_text_file(path: impl AsRef<Path>) -> io::Result<String> {
    let path = path.as_ref();
    let refused = |kind, what: &str| Err(io::Error::new(kind, what));
    // Before it is opened, because the opening of a pipe may wait for ever.
    if !path.metadata()?.is_file() {
        return refused(io::ErrorKind::InvalidInput, "it is not a regular file");
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(LARGEST + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST {
        return refused(
            io::ErrorKind::InvalidInput,
            "it has more than 256 MiB, too many for a file of settings",
        );
    }
    String::from_utf8(bytes)
        .or_else(|e| refused(io::ErrorKind::InvalidData, &format!("it is not UTF-8 text: {e}")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(unix)]
    fn devices_are_refused() {
        let error = read_text_file("/dev/zero").unwrap_err();
        assert!(error.to_string().contains("regular file"), "{error}");
        assert_eq!(
            read_text_file("/no/such/file").unwrap_err().kind(),
            io::ErrorKind::NotFound
        );
    }
}
