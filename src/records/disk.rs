//! How much room the storage has. In: a folder. Out: bytes.

use std::io;
use std::path::Path;

/// The room on one storage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Space {
    /// Free to this program, bytes.
    pub free: u64,
    /// Of the whole storage, bytes.
    pub of: u64,
}

impl Space {
    /// What is free, 0 to 1.
    pub fn share(self) -> f64 {
        if self.of == 0 { 0.0 } else { self.free as f64 / self.of as f64 }
    }
}

/// The room on the storage that holds `folder`, or will hold it once it is made.
pub fn space(folder: &Path) -> io::Result<Space> {
    let there = folder.ancestors().find(|f| f.exists()).unwrap_or(Path::new("."));
    let s = rustix::fs::statvfs(there)?;
    Ok(Space { free: s.f_bavail.saturating_mul(s.f_frsize), of: s.f_blocks.saturating_mul(s.f_frsize) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_storage_has_no_more_room_than_it_is_large() {
        for folder in ["/", "/no/such/folder", "no-such-folder"] {
            let s = space(Path::new(folder)).expect("what holds it is there");
            assert!(s.of > 0 && s.free <= s.of && (0.0..=1.0).contains(&s.share()), "{folder}: {s:?}");
        }
    }
}
