//! A folder in YOLO's format: images and label files by split, what is what, which body is in which image.
//! In: labelled images. Out: files. Not here: where the images come from.

use super::{Labelled, Split};
use crate::document::Error;
use crate::image::{Image, PngError, write_png};
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// A dataset's folder.
#[derive(Clone, Debug)]
pub struct Folder(PathBuf);

/// A line of bodies.csv.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// The image's name, without `.png`.
    pub image: String,
    /// Its split.
    pub split: Split,
    /// What tells its body from others; empty without a vehicle.
    pub body: String,
    /// Paint; empty where unknown.
    pub paint: String,
    /// Classes that the body has, and what share of each can be seen.
    pub features: Vec<(usize, f64)>,
    /// What it shows.
    pub kind: String,
}

/// Why an image was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// A text file.
    #[error(transparent)]
    Text(#[from] Error),
    /// The image.
    #[error(transparent)]
    Image(#[from] PngError),
}

impl Folder {
    /// Makes the folders.
    pub fn create(path: &Path) -> Result<Self, Error> {
        for split in Split::ALL {
            for kind in ["images", "labels"] {
                let folder = path.join(split.name()).join(kind);
                fs::create_dir_all(&folder).map_err(|source| Error::Write { file: folder, source })?;
            }
        }
        Ok(Self(path.into()))
    }

    /// Writes an image with those boxes that count.
    pub fn add(&self, split: Split, name: &str, image: &Image<u8>, boxes: &[Labelled]) -> Result<(), WriteError> {
        let folder = self.0.join(split.name());
        write_png(&folder.join("images").join(format!("{name}.png")), image)?;
        let lines: String = boxes.iter().filter(|b| b.counts()).map(|b| b.line((image.width, image.height))).collect();
        Ok(write(folder.join("labels").join(format!("{name}.txt")), &lines)?)
    }

    /// Writes dataset.yaml and bodies.csv.
    pub fn finish(&self, rows: &[Row]) -> Result<(), Error> {
        let mut yaml = String::from("path: .\n");
        for split in Split::ALL {
            let _ = writeln!(yaml, "{0}: {0}/images", split.name()); // a string takes everything
        }
        yaml.push_str("names:\n  0: point1\n  1: point2\n  2: point3\n  3: point4\n");
        write(self.0.join("dataset.yaml"), &yaml)?;
        let mut csv = String::from("image,split,body,paint,needed,visible,kind\n");
        for r in rows {
            let joined = |of: &dyn Fn(&(usize, f64)) -> String| r.features.iter().map(of).collect::<Vec<_>>().join(" ");
            let (needed, visible) = (joined(&|f| f.0.to_string()), joined(&|f| format!("{:.3}", f.1)));
            let _ =
                writeln!(csv, "{},{},{},{},{needed},{visible},{}", r.image, r.split.name(), r.body, r.paint, r.kind);
        }
        write(self.0.join("bodies.csv"), &csv)
    }
}

/// Without waiting for the disk: thousands of small files, which the same command makes again.
fn write(file: PathBuf, text: &str) -> Result<(), Error> {
    fs::write(&file, text).map_err(|source| Error::Write { file, source })
}
