//! A board in an image. In: a grey image, the board. Out: where each of its points lies, to sub-pixel, or why not.
//! Not here: what a lens or a pose makes of it.

use crate::optics::Pixel;

/// A board as one image shows it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sighting {
    /// Per point of [`crate::calibrate::Board::points`]: `None` where it is hidden, unlit or spoilt.
    pub marks: Vec<Option<Mark>>,
}

/// One point of a board in the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Mark {
    /// Where, raw px. Of a disc: the image of its centre, not the centre of its image.
    pub at: Pixel,
    /// Standard deviation per axis from the image's noise, px.
    pub sigma: f64,
    /// Of a disc: points of its edge, raw px, from which a known lens can do better; else empty.
    pub edge: Vec<Pixel>,
}
