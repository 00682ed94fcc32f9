//! What can be wrong with a device, as far as the station can act on it.

use std::io;
use std::time::Duration;

/// Why a device did not do what was asked. `device` is its name in the configuration.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The device does not answer, or is no longer there. Calls keep failing until it is back; then they work again,
    /// with the settings it had.
    #[error("{device}: gone")]
    Gone {
        /// The device.
        device: String,
    },
    /// No image came in time.
    #[error("{device}: no image within {waited:?}")]
    NoImage {
        /// The device.
        device: String,
        /// The timeout.
        waited: Duration,
    },
    /// An image broke off.
    #[error("{device}: an image of {rows} rows, allowed: {of}")]
    HalfImage {
        /// The device.
        device: String,
        /// Rows that came.
        rows: usize,
        /// Rows of the sensor.
        of: usize,
    },
    /// An image came damaged.
    #[error("{device}: an image came damaged")]
    Damaged {
        /// The device.
        device: String,
    },
    /// A buffer or a picture of another size than the device's.
    #[error("{device}: {what} of {}×{} px, allowed: {}×{} px", found.0, found.1, allowed.0, allowed.1)]
    Size {
        /// The device.
        device: String,
        /// What has that size.
        what: &'static str,
        /// Columns and rows found.
        found: (usize, usize),
        /// Columns and rows of the device.
        allowed: (usize, usize),
    },
    /// A picture that was not loaded.
    #[error("{device}: picture {picture}, allowed: one of the {loaded} loaded")]
    NotLoaded {
        /// The device.
        device: String,
        /// The picture asked for, counted from 0.
        picture: usize,
        /// How many there are.
        loaded: usize,
    },
    /// A setting that means nothing.
    #[error("{device}: {setting} = {value}, allowed: {allowed}")]
    Setting {
        /// The device.
        device: String,
        /// The setting.
        setting: &'static str,
        /// The value asked for.
        value: f64,
        /// What would do.
        allowed: &'static str,
    },
    /// Nothing of that name.
    #[error("{device}: no {what} \"{wanted}\", there: {}", listed(there))]
    Absent {
        /// The device.
        device: String,
        /// What was looked for.
        what: &'static str,
        /// Its name in the configuration.
        wanted: String,
        /// The names that there are.
        there: Vec<String>,
    },
    /// Another program has it.
    #[error("{device}: held by {by}")]
    Held {
        /// The device.
        device: String,
        /// Who has it, as far as the system tells.
        by: String,
    },
    /// A property of the device that is another than the configuration says.
    #[error("{device}: {what} {wanted} is not offered, offered: {}", listed(offered))]
    NotOffered {
        /// The device.
        device: String,
        /// The property.
        what: &'static str,
        /// What the configuration says.
        wanted: String,
        /// What the device would do instead.
        offered: Vec<String>,
    },
    /// The projector did not say that it shows what was asked for, or said so too often.
    #[error("{device}: {found} pulses of its trigger-out, allowed: {allowed}")]
    Pulses {
        /// The device.
        device: String,
        /// Pulses seen.
        found: u64,
        /// Pulses asked for.
        allowed: u64,
    },
    /// The operating system refused.
    #[error("{device}: {call} failed")]
    Call {
        /// The device.
        device: String,
        /// What was called.
        call: &'static str,
        /// What the system said.
        source: io::Error,
    },
}

fn listed(names: &[String]) -> String {
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

impl Error {
    /// What the system said, if it was the system.
    pub fn os(&self) -> Option<&io::Error> {
        match self {
            Self::Call { source, .. } => Some(source),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_names_the_device_what_was_found_and_what_is_allowed() {
        let device = || "projector".to_owned();
        let size = Error::Size { device: device(), what: "picture", found: (1920, 1080), allowed: (1280, 800) };
        assert_eq!(size.to_string(), "projector: picture of 1920×1080 px, allowed: 1280×800 px");
        let e = Error::NotLoaded { device: device(), picture: 16, loaded: 16 };
        assert_eq!(e.to_string(), "projector: picture 16, allowed: one of the 16 loaded");
        let absent = |there| Error::Absent { device: device(), what: "GPIO line", wanted: "lamp".into(), there };
        assert_eq!(absent(vec![]).to_string(), "projector: no GPIO line \"lamp\", there: none");
        let some = absent(vec!["a".into(), "b".into()]);
        assert_eq!(some.to_string(), "projector: no GPIO line \"lamp\", there: a, b");
    }
}
