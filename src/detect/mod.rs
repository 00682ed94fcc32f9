//! The detector: where a body's features are in an image, whatever the body, by a network of the YOLOv8 family.
//! In:  a file of the network, then images as the camera took them. Out: boxes with class and score, px of the image.
//! Not here: training (models/); which boxes make a vehicle (`measure`).
//!
//! Any network with the usual head, of 1 or 3 channels, of any size and of four classes can be used.

mod decode;
mod graph;
mod letterbox;
mod suppress;

use crate::document::{self, Error};
use crate::image::Image;
use graph::Graph;
use letterbox::Letterbox;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The name of the network that comes with the program (models/CARD.md): what is used where nothing else is said.
pub const DEFAULT: &str = "built-in";
/// The name of no detector.
pub const NONE: &str = "none";

static BUILT_IN: &[u8] = include_bytes!("../../models/detector.onnx");

/// Boxes that are less sure are none.
pub const THRESHOLD: f64 = 0.5;

/// Larger files are refused unread: one of three million parameters has 12 MB.
const MAX_BYTES: u64 = 64 << 20;

/// A detector, ready for images.
pub struct Detector {
    file: PathBuf,
    graph: Graph,
    threshold: f32,
}

/// A box in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detection {
    /// From 0: point1 to point4.
    pub class: usize,
    /// How sure it is, 0..=1.
    pub score: f64,
    /// Left, top, right, bottom; pixel centres at integers. May reach beyond the image.
    pub sides: [f64; 4],
}

/// Why an image gave nothing.
#[derive(Debug, thiserror::Error)]
pub enum DetectError {
    /// The network gave numbers that are none.
    #[error("{}: the network's output is not finite", file.display())]
    NotFinite {
        /// The network's file.
        file: PathBuf,
    },
    /// It could not be run.
    #[error("{}: the network cannot be run", file.display())]
    Run {
        /// The network's file.
        file: PathBuf,
        /// What tract said.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// `image` made `width` wide by area averaging, in its own shape, at 255 levels.
pub fn reduced(image: &Image<u16>, white: f64, width: usize) -> Image<u8> {
    let width = width.clamp(1, image.width.max(1));
    let height = (image.height as f64 * width as f64 / image.width.max(1) as f64).round().max(1.0) as usize;
    let mut plane = vec![0.0; width * height];
    Letterbox::new((image.width, image.height), (width, height)).fill(image, white, &mut plane);
    Image { width, height, pixels: plane.into_iter().map(|v| (255.0 * v).round() as u8).collect() }
}

impl Detector {
    /// The detector that `which` names: [`DEFAULT`], [`NONE`] or a file. Takes some 0.2 s: all jobs can share it.
    pub fn named(which: &Path) -> Result<Option<Arc<Self>>, Error> {
        let detector = match which.to_str() {
            Some(NONE) => return Ok(None),
            Some(DEFAULT) => Self::from_bytes(BUILT_IN, which)?,
            _ => Self::read(which)?,
        };
        Ok(Some(Arc::new(detector)))
    }

    /// Reads a network; errors name the file, what is wrong with it and what is allowed.
    pub fn read(file: &Path) -> Result<Self, Error> {
        Self::from_bytes(&document::read_bytes(file, MAX_BYTES)?, file)
    }

    fn from_bytes(bytes: &[u8], file: &Path) -> Result<Self, Error> {
        let graph = Graph::from_bytes(bytes, file)?;
        Ok(Self { file: file.into(), graph, threshold: THRESHOLD as f32 })
    }

    /// The same with another threshold, 0 to 1.
    pub fn with_threshold(self, threshold: f64) -> Self {
        Self { threshold: (threshold as f32).clamp(1e-6, 1.0 - 1e-6), ..self }
    }

    /// Channels, height and width of its input, and whether its head was cut off and is done for few cells only.
    pub fn shape(&self) -> ([usize; 3], bool) {
        (self.graph.input, self.graph.is_cut())
    }

    /// The boxes in `image`, the surest first. `white` is the level of white.
    pub fn detect(&self, image: &Image<u16>, white: f64) -> Result<Vec<Detection>, DetectError> {
        if image.width == 0 || image.height == 0 {
            return Ok(Vec::new());
        }
        let [_, height, width] = self.graph.input;
        let letterbox = Letterbox::new((image.width, image.height), (width, height));
        let mut plane = vec![0.0; width * height];
        letterbox.fill(image, white, &mut plane);
        let failed = |e: String| DetectError::Run { file: self.file.clone(), source: e.into() };
        let raw = self.graph.run(&plane).map_err(|e| failed(format!("{e:#}")))?;
        let (len, needed) = (raw.len(), self.graph.head.len());
        if len != needed {
            return Err(failed(format!("{len} numbers instead of {needed}")));
        }
        if !raw.iter().all(|v| v.is_finite()) {
            return Err(DetectError::NotFinite { file: self.file.clone() });
        }
        let found = suppress::suppress(self.graph.head.decode(&raw, self.threshold));
        let in_image = |f: decode::Found| {
            let [left, top, right, bottom] = f.sides.map(f64::from);
            let (first, last) = (letterbox.to_image(left, top), letterbox.to_image(right, bottom));
            Detection { class: f.class, score: f.score.into(), sides: [first.x, first.y, last.x, last.y] }
        };
        Ok(found.into_iter().map(in_image).collect())
    }
}
