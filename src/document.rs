//! Our TOML files. In: a path. Out: its typed content, or an error that names file, key, value and what
//! is allowed. Numbers from a file are never trusted: [`Check`] is how every reader tests them.
//! Not here: what the keys mean.

use serde::{Serialize, de::DeserializeOwned};
use std::fmt::Display;
use std::fs;
use std::io::{self, Read, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// The only `format` so far.
pub const FORMAT: u32 = 1;
/// Larger files are refused unread; the largest we write, a calibration with its covariance, has 20 kB.
const MAX_BYTES: u64 = 4 << 20;

/// Why a file was not read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be opened or read.
    #[error("{}: cannot be read", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file cannot be written.
    #[error("{}: cannot be written", file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The file is too large to be one of ours.
    #[error("{}: too large, allowed: up to {allowed} bytes", file.display())]
    TooLarge {
        /// The file.
        file: PathBuf,
        /// Bytes.
        allowed: u64,
    },
    /// The text is no TOML, or a key is unknown, missing or of another type.
    #[error("{}: line {line}, `{text}`: {message}", file.display())]
    Toml {
        /// The file.
        file: PathBuf,
        /// Counted from 1.
        line: usize,
        /// The line.
        text: String,
        /// What is wrong with it and what is allowed.
        message: String,
    },
    /// A binary file whose content cannot be used.
    #[error("{}: {wrong}", file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// What is wrong with it: all that is said, so no source beside it.
        wrong: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A value that is not allowed.
    #[error("{}: {key} = {value}, allowed: {allowed}", file.display())]
    Value {
        /// The file.
        file: PathBuf,
        /// The key, with its tables.
        key: String,
        /// The value found.
        value: String,
        /// What would do.
        allowed: String,
    },
}

/// The content of `file`, of at most `max` bytes.
pub fn read_bytes(file: &Path, max: u64) -> Result<Vec<u8>, Error> {
    let mut bytes = Vec::new();
    fs::File::open(file)
        .and_then(|f| f.take(max + 1).read_to_end(&mut bytes))
        .map_err(|source| Error::Read { file: file.into(), source })?;
    if bytes.len() as u64 > max {
        return Err(Error::TooLarge { file: file.into(), allowed: max });
    }
    Ok(bytes)
}

/// The typed content of a TOML file. `format` is checked before any other key, so that a file of a later
/// format is told apart from a mistyped one.
pub fn read<T: DeserializeOwned>(file: &Path) -> Result<T, Error> {
    let bytes = read_bytes(file, MAX_BYTES)?;
    let text = String::from_utf8(bytes)
        .map_err(|e| Error::Read { file: file.into(), source: io::Error::new(io::ErrorKind::InvalidData, e) })?;
    let table: toml::Table = toml::from_str(&text).map_err(|e| toml_error(file, &text, &e))?;
    let format = table.get("format");
    Check(file).that(
        format.and_then(toml::Value::as_integer) == Some(FORMAT.into()),
        "format",
        format.map_or("(missing)".into(), ToString::to_string),
        format!("{FORMAT}, the only format this version reads"),
    )?;
    toml::from_str(&text).map_err(|e| toml_error(file, &text, &e))
}

/// Writes `content` beside `file` and renames it into place: a crash leaves the old file or the new one, whole.
pub fn write<T: Serialize>(file: &Path, content: &T) -> Result<(), Error> {
    let text = toml::to_string(content).expect("our file structs are plain tables, which TOML can hold");
    write_bytes(file, text.as_bytes())
}

/// As [`write()`], of finished bytes.
pub fn write_bytes(file: &Path, bytes: &[u8]) -> Result<(), Error> {
    let mut name = file.file_name().unwrap_or_default().to_owned();
    name.push(format!(".{}.tmp", std::process::id()));
    let temporary = file.with_file_name(name);
    let written = fs::File::create(&temporary)
        .and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_all()))
        .and_then(|()| fs::rename(&temporary, file));
    written.map_err(|source| {
        let _ = fs::remove_file(&temporary); // the cause is reported; a leftover is only litter
        Error::Write { file: file.into(), source }
    })
}

fn toml_error(file: &Path, text: &str, e: &toml::de::Error) -> Error {
    let start = e.span().map_or(0, |s| s.start.min(text.len()));
    let line = text.as_bytes()[..start].iter().filter(|&&b| b == b'\n').count();
    Error::Toml {
        file: file.into(),
        line: line + 1,
        text: text.lines().nth(line).unwrap_or_default().trim().chars().take(100).collect(),
        message: e.message().trim().replace('\n', ", "),
    }
}

/// Checks the values of one file.
#[derive(Clone, Copy, Debug)]
pub struct Check<'a>(pub &'a Path);

impl Check<'_> {
    /// An error naming `key`, `value` and what is `allowed`, unless `ok`.
    pub fn that(
        self,
        ok: bool,
        key: impl Into<String>,
        value: impl Display,
        allowed: impl Into<String>,
    ) -> Result<(), Error> {
        if ok {
            return Ok(());
        }
        let value = value.to_string();
        Err(Error::Value { file: self.0.into(), key: key.into(), value, allowed: allowed.into() })
    }

    /// `value` lies in `range`; NaN lies in none.
    pub fn within<T: PartialOrd + Display>(
        self,
        key: impl Into<String>,
        value: T,
        range: RangeInclusive<T>,
    ) -> Result<(), Error> {
        let allowed = format!("{} to {}", range.start(), range.end());
        self.that(range.contains(&value), key, value, allowed)
    }

    /// `value` is finite and greater than 0.
    pub fn positive(self, key: impl Into<String>, value: f64) -> Result<(), Error> {
        self.that(value > 0.0 && value.is_finite(), key, value, "a finite number greater than 0")
    }

    /// `value` is finite and not negative.
    pub fn not_negative(self, key: impl Into<String>, value: f64) -> Result<(), Error> {
        self.that(value >= 0.0 && value.is_finite(), key, value, "a finite number, 0 or greater")
    }

    /// All of `values` are finite.
    pub fn finite(self, key: impl Into<String>, values: &[f64]) -> Result<(), Error> {
        self.that(values.iter().all(|v| v.is_finite()), key, format!("{values:?}"), "finite numbers")
    }

    /// `text` is a name: 1 to 64 printable characters, without slashes.
    pub fn name(self, key: impl Into<String>, text: &str) -> Result<(), Error> {
        let ok = (1..=64).contains(&text.chars().count())
            && !text.trim().is_empty()
            && !text.contains(|c: char| c.is_control() || c == '/' || c == '\\');
        self.that(ok, key, format!("{text:?}"), "a name of 1 to 64 printable characters, without slashes")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize, Serialize)]
    #[serde(deny_unknown_fields)]
    struct Small {
        format: u32,
        table: Inner,
    }
    #[derive(Debug, serde::Deserialize, Serialize)]
    #[serde(deny_unknown_fields)]
    struct Inner {
        width: u32,
        gain: f64,
    }

    fn reading(text: &str) -> Result<Small, String> {
        let dir = std::env::temp_dir().join(format!("datum-document-{}", std::process::id()));
        fs::create_dir_all(&dir).expect("temporary folder");
        let name = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(text.as_bytes());
        let file = dir.join(format!("{name:08x}.toml"));
        fs::write(&file, text).expect("temporary file");
        let shown = read(&file).map_err(|e| e.to_string().replace(&file.display().to_string(), "f.toml"));
        fs::remove_file(&file).expect("just written");
        shown
    }

    #[test]
    fn an_error_names_file_line_key_value_and_what_is_allowed() {
        let says = |text: &str| reading(text).expect_err(text);
        assert_eq!(
            says("format = 1\n[table]\nwdith = 3\ngain = 1.0\n"),
            "f.toml: line 3, `wdith = 3`: unknown field `wdith`, expected `width` or `gain`"
        );
        assert_eq!(
            says("format = 1\n[table]\nwidth = -3\ngain = 1.0\n"),
            "f.toml: line 3, `width = -3`: invalid value: integer `-3`, expected u32"
        );
        assert_eq!(says("format = 1\n[table]\nwidth = 3\n"), "f.toml: line 2, `[table]`: missing field `gain`");
        assert_eq!(says("format = 2\nnew = 0\n"), "f.toml: format = 2, allowed: 1, the only format this version reads");
        assert_eq!(says(""), "f.toml: format = (missing), allowed: 1, the only format this version reads");
        assert!(says("format = 1\n[table\n").starts_with("f.toml: line 2, `[table`: "));
        assert!(says(&format!("format = 1\na = {}", "[".repeat(100_000))).contains("line 2"));
        assert!(says(&"#".repeat(5 << 20)).contains("too large"));
    }

    #[test]
    fn an_integer_is_a_number_and_nan_is_in_no_range() {
        assert_eq!(reading("format = 1\ntable = { width = 3, gain = 2 }").expect("valid").table.gain, 2.0);
        let file = Path::new("f.toml");
        let e = Check(file).within("camera.gain", f64::NAN, 0.0..=1.0).expect_err("NaN");
        assert_eq!(e.to_string(), "f.toml: camera.gain = NaN, allowed: 0 to 1");
    }

    #[test]
    fn a_written_file_reads_back_and_leaves_no_temporary_one() {
        let dir = std::env::temp_dir().join(format!("datum-write-{}", std::process::id()));
        fs::create_dir_all(&dir).expect("temporary folder");
        let file = dir.join("small.toml");
        write(&file, &Small { format: 1, table: Inner { width: 7, gain: 0.5 } }).expect("writable");
        assert_eq!(read::<Small>(&file).expect("just written").table.width, 7);
        assert_eq!(fs::read_dir(&dir).expect("folder").count(), 1);
        assert!(write(&dir.join("no/such.toml"), &Small { format: 1, table: Inner { width: 7, gain: 0.5 } }).is_err());
        fs::remove_dir_all(&dir).expect("just made");
    }
}
