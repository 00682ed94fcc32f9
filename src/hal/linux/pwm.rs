//! PWM channels by sysfs. In: the name of the chip's device, the channel. Out: a duty that stays until it is changed.
//! A channel keeps running when its program ends. linux/Documentation/driver-api/pwm.rst.

use super::Sys;
use crate::hal::Error;
use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::{Duration, Instant};

/// An exported channel's files are there, and ours to write, within.
const EXPORTED: Duration = Duration::from_secs(1);
const LOOK: Duration = Duration::from_millis(5);

/// A channel as the configuration names it: `device/channel`. A chip's number changes from one boot to the next, its
/// device does not; channels have no names.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ChannelName {
    device: String,
    channel: u32,
}

impl FromStr for ChannelName {
    type Err = &'static str;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let allowed = "a PWM chip's device and a channel, as in \"fe20c000.pwm/0\"";
        let (device, channel) = text.rsplit_once('/').filter(|(d, _)| !d.is_empty()).ok_or(allowed)?;
        Ok(Self { device: device.into(), channel: channel.parse().map_err(|_| allowed)? })
    }
}

impl fmt::Display for ChannelName {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}/{}", self.device, self.channel)
    }
}

/// Something that is dimmed.
pub(super) trait Dimmer: Send {
    /// Sets the share of time that it is on, 0 to 1; the share that was taken.
    fn set(&mut self, duty: f64) -> Result<f64, Error>;
}

/// A channel.
pub(super) struct Channel {
    device: &'static str,
    folder: PathBuf,
    period_ns: u64,
}

impl Channel {
    /// Takes the channel; it is dark from then on.
    pub(super) fn open(device: &'static str, sys: &Sys, name: &ChannelName, hz: f64) -> Result<Self, Error> {
        let chip = find(device, sys, name)?;
        let channels: u32 = read(&chip.join("npwm")).and_then(|n| n.parse().ok()).unwrap_or(0);
        if name.channel >= channels {
            let there = (0..channels).map(|c| format!("{}/{c}", name.device)).collect();
            return Err(Error::Absent { device: device.into(), what: "PWM channel", wanted: name.to_string(), there });
        }
        let folder = chip.join(format!("pwm{}", name.channel));
        let channel = Self { device, folder, period_ns: (1e9 / hz) as u64 };
        if !channel.folder.exists() {
            channel.write_to(&chip.join("export"), u64::from(name.channel), "PWM export")?;
        }
        channel.wait_until_ours()?;
        channel.dark()?;
        channel.write("period", channel.period_ns)?;
        Ok(channel)
    }

    /// udev hands a new channel's files over after they have appeared.
    fn wait_until_ours(&self) -> Result<(), Error> {
        let began = Instant::now();
        loop {
            let tried = fs::OpenOptions::new().write(true).open(self.folder.join("duty_cycle"));
            match tried {
                Ok(_) => return Ok(()),
                Err(source) if began.elapsed() >= EXPORTED => {
                    return Err(Error::Call { device: self.device.into(), call: "PWM channel", source });
                }
                Err(_) => std::thread::sleep(LOOK),
            }
        }
    }

    /// Duty first: a channel that is only disabled may stay at the level it had. One that never had a period is off, and
    /// takes neither.
    fn dark(&self) -> Result<(), Error> {
        if read(&self.folder.join("period")).is_some_and(|p| p == "0") {
            return Ok(());
        }
        self.write("duty_cycle", 0)?;
        self.write("enable", 0)
    }

    fn write(&self, file: &str, value: u64) -> Result<(), Error> {
        self.write_to(&self.folder.join(file), value, "PWM write")
    }

    fn write_to(&self, file: &Path, value: u64, call: &'static str) -> Result<(), Error> {
        let failed = |source: io::Error| {
            let device = format!("{} ({} = {value})", self.device, file.display());
            Error::Call { device, call, source }
        };
        fs::write(file, value.to_string()).map_err(failed)
    }
}

impl Dimmer for Channel {
    fn set(&mut self, duty: f64) -> Result<f64, Error> {
        let ns = (duty * self.period_ns as f64).round() as u64;
        if ns == 0 {
            self.dark()?;
        } else {
            self.write("duty_cycle", ns)?;
            self.write("enable", 1)?;
        }
        Ok(ns as f64 / self.period_ns as f64)
    }
}

fn read(file: &Path) -> Option<String> {
    fs::read_to_string(file).ok().map(|s| s.trim().to_owned())
}

fn find(device: &'static str, sys: &Sys, name: &ChannelName) -> Result<PathBuf, Error> {
    let mut there = Vec::new();
    for chip in fs::read_dir(sys.0.join("class/pwm")).into_iter().flatten().flatten() {
        let parent = fs::canonicalize(chip.path().join("device"));
        let Some(parent) = parent.ok().and_then(|p| Some(p.file_name()?.to_string_lossy().into_owned())) else {
            continue;
        };
        if parent == name.device {
            return Ok(chip.path());
        }
        there.push(parent);
    }
    Err(Error::Absent { device: device.into(), what: "PWM chip of device", wanted: name.device.clone(), there })
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A folder as /sys has it, with one chip of two channels, which are exported.
    pub(in super::super) fn sys(name: &str) -> Sys {
        let root = std::env::temp_dir().join(format!("datum-pwm-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&root);
        let chip = root.join("class/pwm/pwmchip4");
        let parent = root.join("devices/platform/lamp.pwm");
        fs::create_dir_all(&parent).expect("writable");
        for k in 0..2 {
            let folder = chip.join(format!("pwm{k}"));
            fs::create_dir_all(&folder).expect("writable");
            for (file, value) in [("period", "0"), ("duty_cycle", "0"), ("enable", "0")] {
                fs::write(folder.join(file), value).expect("writable");
            }
        }
        fs::write(chip.join("npwm"), "2\n").expect("writable");
        std::os::unix::fs::symlink(&parent, chip.join("device")).expect("writable");
        Sys(root)
    }

    fn value(sys: &Sys, file: &str) -> String {
        read(&sys.0.join("class/pwm/pwmchip4/pwm1").join(file)).expect("there")
    }

    #[test]
    fn a_channel_is_found_by_its_device_dimmed_and_turned_off() {
        let sys = sys("dim");
        let name = "lamp.pwm/1".parse().expect("both");
        let mut channel = Channel::open("lights", &sys, &name, 20_000.0).expect("there");
        assert_eq!(channel.set(0.3).expect("writable"), 0.3);
        let all = |sys: &Sys| ["period", "duty_cycle", "enable"].map(|f| value(sys, f));
        assert_eq!(all(&sys), ["50000", "15000", "1"]);
        channel.set(0.0).expect("writable");
        assert_eq!(all(&sys), ["50000", "0", "0"]);
        // one that its last program left on is dark as soon as it is taken
        channel.set(1.0).expect("writable");
        let _again = Channel::open("lights", &sys, &name, 10_000.0).expect("there");
        assert_eq!(all(&sys), ["100000", "0", "0"]);
        fs::remove_dir_all(sys.0).expect("just made");
    }

    #[test]
    fn what_is_not_there_is_named_beside_what_is() {
        let sys = sys("absent");
        for (name, says) in [
            ("lamp.pwm/2", "lights: no PWM channel \"lamp.pwm/2\", there: lamp.pwm/0, lamp.pwm/1"),
            ("fan.pwm/0", "lights: no PWM chip of device \"fan.pwm\", there: lamp.pwm"),
        ] {
            let opened = Channel::open("lights", &sys, &name.parse().expect("both"), 1000.0);
            assert_eq!(opened.err().expect("absent").to_string(), says);
        }
        assert!("lamp".parse::<ChannelName>().is_err() && "lamp/x".parse::<ChannelName>().is_err());
        fs::remove_dir_all(sys.0).expect("just made");
    }
}
