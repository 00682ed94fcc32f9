//! A backup's file. In: files by name. Out: one file, and back; one that is foreign, torn, damaged or of another major
//! version is refused with a sentence.
//!
//! ```text
//! "datum backup"  format, u32  length of the content, u64  content, postcard  CRC-64/XZ of all before it
//! ```
//! Numbers are little-endian. The checksum finds accidents, not intent: who can write the file can write its checksum.

use crate::document::{self, Check, Error};
use crate::time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

const MAGIC: &[u8] = b"datum backup";
/// Magic, format, length.
const HEAD: usize = MAGIC.len() + 4 + 8;
/// A checksum.
const TAIL: usize = 8;
/// Larger files are refused unread. The largest things in one are detectors, some 10 MB.
const MAX_BYTES: u64 = 512 << 20;

/// What a backup holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Backup {
    /// The version of datum that made it.
    pub software: String,
    /// When, UTC.
    pub taken_at: String,
    /// The station's serial number.
    pub serial: String,
    /// Contents by their paths from the configuration's folder, with forward slashes; the configuration is "station.toml".
    pub files: BTreeMap<String, Vec<u8>>,
}

impl Backup {
    /// Of these files, made now.
    pub fn new(serial: &str, files: BTreeMap<String, Vec<u8>>) -> Self {
        let (software, taken_at) = (env!("CARGO_PKG_VERSION").into(), time::moment(time::unix_ms()));
        Self { software, taken_at, serial: serial.into(), files }
    }

    /// Writes it to `file`, which must not exist.
    pub fn write(&self, file: &Path) -> Result<(), Error> {
        Check(file).that(!file.exists(), "file", "there already", "a new one: no backup is overwritten")?;
        let content = postcard::to_stdvec(self).expect("strings and bytes only");
        let mut bytes = MAGIC.to_vec();
        bytes.extend(document::FORMAT.to_le_bytes());
        bytes.extend((content.len() as u64).to_le_bytes());
        bytes.extend(content);
        bytes.extend(checksum(&bytes).to_le_bytes());
        document::write_bytes(file, &bytes)
    }

    /// Reads and checks `file`: its checksum, its version, its files' names.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let bytes = document::read_bytes(file, MAX_BYTES)?;
        let wrong = |said: String| Error::Content { file: file.into(), wrong: said.into() };
        if !bytes.starts_with(MAGIC) {
            return Err(wrong("no backup of datum: it does not begin as one".into()));
        }
        let number = |at: usize| bytes.get(at..at + 8).map(|b| u64::from_le_bytes(b.try_into().expect("eight")));
        let format = bytes.get(MAGIC.len()..MAGIC.len() + 4).map(|b| u32::from_le_bytes(b.try_into().expect("four")));
        let (Some(format), Some(length)) = (format, number(MAGIC.len() + 4)) else {
            return Err(wrong(format!("torn: {} bytes, its head alone has {HEAD}", bytes.len())));
        };
        Check(file).that(
            format == document::FORMAT,
            "format",
            format,
            format!("{}, the only format this version reads", document::FORMAT),
        )?;
        let whole = length.saturating_add((HEAD + TAIL) as u64);
        if whole != bytes.len() as u64 {
            return Err(wrong(format!("torn: {} bytes, it was written with {whole}", bytes.len())));
        }
        let end = bytes.len() - TAIL;
        if number(end) != Some(checksum(&bytes[..end])) {
            return Err(wrong("damaged: its checksum is not that of its content".into()));
        }
        let read: Self =
            postcard::from_bytes(&bytes[HEAD..end]).map_err(|e| wrong(format!("its content is no backup's: {e}")))?;
        let ours = env!("CARGO_PKG_VERSION");
        Check(file).that(
            major(&read.software) == major(ours),
            "version",
            &read.software,
            format!("{}.x.y: this is datum {ours}", major(ours)),
        )?;
        for name in read.files.keys() {
            let parts_ok = name.split('/').all(|part| !matches!(part, "" | "." | "..") && !part.contains(['\\', '\0']));
            Check(file).that(parts_ok, "name", format!("{name:?}"), "a path below the configuration's folder")?;
        }
        Ok(read)
    }
}

fn major(version: &str) -> &str {
    version.split('.').next().unwrap_or_default()
}

fn checksum(bytes: &[u8]) -> u64 {
    crc::Crc::<u64>::new(&crc::CRC_64_XZ).checksum(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_of_a_backup_are_frozen() {
        let files = BTreeMap::from([("station.toml".to_owned(), b"format = 1\n".to_vec())]);
        let backup = Backup { software: "0.1.0".into(), taken_at: "now".into(), serial: "S1".into(), files };
        let content = b"\x050.1.0\x03now\x02S1\x01\x0cstation.toml\x0bformat = 1\n";
        assert_eq!(postcard::to_stdvec(&backup).expect("plain"), content);
        let file = std::env::temp_dir().join(format!("datum-backup-bytes-{}", std::process::id()));
        backup.write(&file).expect("writable");
        let bytes = std::fs::read(&file).expect("just written");
        std::fs::remove_file(&file).expect("just written");
        let head =
            [b"datum backup\x01\0\0\0".as_slice(), &[content.len() as u8, 0, 0, 0, 0, 0, 0, 0], content].concat();
        assert_eq!(bytes[..bytes.len() - TAIL], head);
    }
}
