//! The camera behind libcamera: sensors on a system-on-chip's own interface, whose drivers are parts that libcamera puts
//! together. In: settings. Out: images that were exposed after they were asked for. Unplugged, it is [`Error::Gone`] until
//! it is back; then it is opened anew, with the exposure and the gain that it had.
//! What needs no libcamera is built for tests without libcamera, too: `samples`, `settings`, `when`, `follow`, `parts`. `owner` is the thread that
//! holds libcamera.

mod follow;
mod parts;
mod samples;
mod settings;
mod when;

#[cfg(feature = "libcamera")]
mod camera;
#[cfg(feature = "libcamera")]
mod owner;

#[cfg(feature = "libcamera")]
use camera::DEVICE;
#[cfg(feature = "libcamera")]
pub use camera::{LibcameraCamera, LibcameraSettings};
