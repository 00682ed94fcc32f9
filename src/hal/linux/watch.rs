//! What a camera's stream is like, for `datum doctor`. In: how many images to look at. Out: rate, losses, what can be set.

use crate::hal::{Camera, Error};
use std::time::Duration;

/// What a stream of images was like.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stream {
    /// Images per second, as their stamps have it.
    pub rate: f64,
    /// Images that came, that were exposed and never came, that came twice, that came damaged.
    pub came: usize,
    /// See there.
    pub lost: u64,
    /// See there.
    pub doubled: u64,
    /// See there.
    pub damaged: u64,
    /// Whether the stamps say when an exposure began.
    pub stamped_at_begin: bool,
    /// Whether exposure and gain can be set.
    pub exposure: bool,
    /// See there.
    pub gain: bool,
}

/// A camera whose stream can be looked at.
pub trait Watch: Camera {
    /// What the stream is like over `images` images.
    fn watch(&mut self, images: usize, timeout: Duration) -> Result<Stream, Error>;
}
