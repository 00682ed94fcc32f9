//! Labelled images to train a detector with: vehicles drawn at random in the simulated station, and empty halls; or a
//! plant's own vehicles from its captures.
//! In:  a seed, a number, a setup; or a capture. Out: a grey image and the boxes of what can be seen in it; a folder in
//! YOLO's format.
//! Not here: training; augmentations, which belong after the split; what a detector makes of it.
//!
//! Images are split by body: all of one body's are for training, for choosing between trainings, or for the test. The
//! models with names are never drawn, so that they stay unseen as well.

mod boxes;
mod captured;
mod folder;
mod things;
mod view;

pub use boxes::{Labelled, VISIBLE, boxed};
pub use captured::{Captured, captured};
pub use folder::{Folder, Row, WriteError};
pub use view::{Kind, View, view};

/// Which images a network sees when.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Split {
    /// It learns from these.
    Train,
    /// Trainings are compared by these.
    Val,
    /// Nothing is chosen by these.
    Test,
}

/// Images per body: enough that a split by image would leak, few enough that most images show another body.
const PER_BODY: u64 = 2;

impl Split {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::Train, Self::Val, Self::Test];

    /// Of image `number`: 70, 15 and 15 % of the bodies.
    pub fn of(number: u64) -> Self {
        Self::of_body(number / PER_BODY)
    }

    /// Of all images of what is called so.
    pub fn of_name(name: &str) -> Self {
        Self::of_body(crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(name.as_bytes()).into())
    }

    fn of_body(body: u64) -> Self {
        match body % 20 {
            0..14 => Self::Train,
            14..17 => Self::Val,
            _ => Self::Test,
        }
    }

    /// The name of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::Val => "val",
            Self::Test => "test",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bodies_are_split_not_images() {
        let of = |split| (0..400).filter(|n| Split::of(*n) == split).count();
        assert_eq!(Split::ALL.map(of), [280, 60, 60]);
        assert!((0..400).step_by(2).all(|n| Split::of(n) == Split::of(n + 1)));
    }
}
