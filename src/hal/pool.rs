//! Image buffers, made once: a capture neither allocates nor copies images about.
//! In: how many, and how large. Out: buffers that go back to their pool by themselves.

use super::Sensor;
use crate::image::Image;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, PoisonError};

type Store = Arc<Mutex<Vec<Image<u16>>>>;

/// A fixed number of images of a sensor's size.
#[derive(Clone, Debug)]
pub struct Pool {
    free: Store,
}

/// An image on loan from a [`Pool`], to which it returns when dropped. What it shows is left from its last use.
#[derive(Debug)]
pub struct Buffer {
    /// Empty (no pixels) only while being dropped.
    image: Image<u16>,
    home: Store,
}

impl Pool {
    /// A pool of `count` images for `sensor`.
    pub fn new(sensor: &Sensor, count: usize) -> Self {
        let image = Image::filled(sensor.width, sensor.height, 0);
        Self { free: Arc::new(Mutex::new(vec![image; count])) }
    }

    /// A free image; `None` if all are on loan: there is no waiting, as whoever asks may be the one who holds them.
    pub fn take(&self) -> Option<Buffer> {
        let image = self.free.lock().unwrap_or_else(PoisonError::into_inner).pop()?;
        Some(Buffer { image, home: Arc::clone(&self.free) })
    }
}

impl Drop for Buffer {
    fn drop(&mut self) {
        let image = std::mem::replace(&mut self.image, Image { width: 0, height: 0, pixels: Vec::new() });
        self.home.lock().unwrap_or_else(PoisonError::into_inner).push(image);
    }
}

impl Deref for Buffer {
    type Target = Image<u16>;
    fn deref(&self) -> &Image<u16> {
        &self.image
    }
}

impl DerefMut for Buffer {
    fn deref_mut(&mut self) -> &mut Image<u16> {
        &mut self.image
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pool_lends_each_image_once_and_takes_it_back() {
        let sensor = Sensor {
            width: 4,
            height: 3,
            bits: 8,
            black_level: 2.0,
            white_level: 255,
            dn_per_electron: 0.03,
            read_noise_e: 6.0,
            serial: "1".into(),
        };
        let pool = Pool::new(&sensor, 2);
        let (mut a, b) = (pool.take().expect("two"), pool.take().expect("one"));
        assert!(pool.take().is_none());
        a.pixels[5] = 7;
        drop(a);
        let again = pool.take().expect("given back");
        assert_eq!((again.width, again.height, again.pixels[5]), (4, 3, 7));
        drop((again, b));
        assert!(pool.take().is_some());
    }
}
