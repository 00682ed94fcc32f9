//! GPIO lines. In: a chip's label and a line's name. Out: the line, held until it is dropped.
//! A released line keeps its level: whoever holds one turns it off first.

use crate::hal::Error;
use gpiod::{Active, Chip, EdgeDetect, Lines, Options};
use std::fmt;
use std::io;
use std::str::FromStr;
use std::time::Duration;

/// Who holds our lines, as other programs see it.
const CONSUMER: &str = "datum";

/// A line as the configuration names it: `label/name`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LineName {
    chip: String,
    line: String,
}

impl FromStr for LineName {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        match text.split_once('/') {
            Some((chip, line)) if !chip.is_empty() && !line.is_empty() => {
                Ok(Self { chip: chip.into(), line: line.into() })
            }
            _ => Err("a GPIO chip's label and a line's name, as in \"pinctrl-bcm2711/GPIO17\""),
        }
    }
}

impl fmt::Display for LineName {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}/{}", self.chip, self.line)
    }
}

/// Something that is on or off.
pub(super) trait Switch: Send {
    fn set(&mut self, on: bool) -> Result<(), Error>;
}

/// A line that we drive.
pub(super) struct Output {
    device: &'static str,
    line: Lines<gpiod::Output>,
}

impl Output {
    /// Takes the line; it is off from then on.
    pub(super) fn open(device: &'static str, name: &LineName, active_low: bool) -> Result<Self, Error> {
        let (chip, number) = find(device, name)?;
        let options = Options::output([number]).active(active(active_low)).values([false]).consumer(CONSUMER);
        let line = chip.request_lines(options).map_err(|e| refused(device, "GPIO line request", e))?;
        Ok(Self { device, line })
    }
}

impl Switch for Output {
    fn set(&mut self, on: bool) -> Result<(), Error> {
        self.line.set_values([on]).map_err(|e| refused(self.device, "GPIO line set", e))
    }
}

/// A line that we watch.
pub(super) struct Input {
    device: &'static str,
    line: Lines<gpiod::Input>,
}

impl Input {
    /// Takes the line and watches `edges` of it.
    pub(super) fn open(
        device: &'static str,
        name: &LineName,
        active_low: bool,
        edges: EdgeDetect,
    ) -> Result<Self, Error> {
        let (chip, number) = find(device, name)?;
        let options = Options::input([number]).active(active(active_low)).edge(edges).consumer(CONSUMER);
        let line = chip.request_lines(options).map_err(|e| refused(device, "GPIO line request", e))?;
        Ok(Self { device, line })
    }

    /// Whether it is on just now.
    pub(super) fn level(&self) -> Result<bool, Error> {
        let values = self.line.get_values([false]);
        values.map(|[on]| on).map_err(|e| refused(self.device, "GPIO line read", e))
    }

    /// Waits for the next edge; when it was, by the monotonic clock.
    pub(super) fn edge(&mut self) -> Result<Duration, Error> {
        self.line.read_event().map(|event| event.time).map_err(|e| refused(self.device, "GPIO event", e))
    }
}

fn active(low: bool) -> Active {
    if low { Active::Low } else { Active::High }
}

fn find(device: &'static str, name: &LineName) -> Result<(Chip, u32), Error> {
    let absent =
        |what, wanted: &str, there| Error::Absent { device: device.into(), what, wanted: wanted.into(), there };
    let mut labels = Vec::new();
    let mut denied = None;
    for path in Chip::list_devices().map_err(|e| refused(device, "GPIO chips", e))? {
        let chip = match Chip::new(&path) {
            Ok(chip) => chip,
            Err(e) => {
                denied = Some(e);
                continue;
            }
        };
        if chip.label() != name.chip {
            labels.push(chip.label().to_owned());
            continue;
        }
        let mut lines = Vec::new();
        for number in 0..chip.num_lines() {
            let info = chip.line_info(number).map_err(|e| refused(device, "GPIO line info", e))?;
            if info.name == name.line {
                if info.used {
                    return Err(Error::Held { device: format!("{device} ({name})"), by: info.consumer });
                }
                return Ok((chip, number));
            }
            lines.push(info.name);
        }
        lines.retain(|l| !l.is_empty());
        return Err(absent("GPIO line", &name.line, lines));
    }
    match denied {
        Some(e) => Err(refused(device, "GPIO chip", e)),
        None => Err(absent("GPIO chip", &name.chip, labels)),
    }
}

fn refused(device: &str, call: &'static str, source: io::Error) -> Error {
    Error::Call { device: device.into(), call, source }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_is_named_by_its_chips_label_and_its_name() {
        let name: LineName = "pinctrl-bcm2711/GPIO17".parse().expect("both");
        assert_eq!((name.chip.as_str(), name.line.as_str()), ("pinctrl-bcm2711", "GPIO17"));
        assert_eq!(name.to_string(), "pinctrl-bcm2711/GPIO17");
        for wrong in ["17", "/17", "gpio/", ""] {
            assert!(wrong.parse::<LineName>().is_err(), "{wrong}");
        }
    }
}
