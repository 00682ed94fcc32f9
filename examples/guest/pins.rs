//! Lines and PWM channels of the guest, from outside: what datum drives is read, what it reads is driven.
//! In: nothing. Out: the bars' light; the presence sensor. board/guest/init makes the devices.

use std::fs;
use std::io;
use std::path::Path;

const PWM: &str = "/sys/devices/platform/datum-pwm/state";

/// Lines by their place in the chip.
pub(crate) const BARS: [usize; 2] = [0, 1];
pub(crate) const PRESENCE: usize = 2;
/// What a program drives.
pub(crate) const OUTPUTS: [usize; 5] = [0, 1, 3, 4, 5];

fn attribute(line: usize, name: &str) -> String {
    format!("/run/gpio/sim_gpio{line}/{name}")
}

/// Whether a line is high.
pub(crate) fn level(line: usize) -> io::Result<bool> {
    Ok(fs::read_to_string(attribute(line, "value"))?.trim() == "1")
}

/// Drives a line that datum reads.
pub(crate) fn pull(line: usize, high: bool) -> io::Result<()> {
    fs::write(attribute(line, "pull"), if high { "pull-up" } else { "pull-down" })
}

/// Duty of each channel, 0 to 1; 0 where it does not run.
pub(crate) fn duties() -> io::Result<[f64; 2]> {
    let text = fs::read_to_string(Path::new(PWM))?;
    let channel = |line: &str| -> Option<f64> {
        let mut words = line.split_whitespace().map(|w| w.parse::<f64>().ok());
        let (duty, period, on) = (words.next()??, words.next()??, words.next()??);
        Some(if on != 0.0 && period > 0.0 { duty / period } else { 0.0 })
    };
    let duties: Option<Vec<f64>> = text.lines().map(channel).collect();
    let duties = duties.and_then(|d| <[f64; 2]>::try_from(d).ok());
    duties.ok_or_else(|| io::Error::other(format!("{PWM}: {text:?}, allowed: two lines of three numbers")))
}

/// Light of each bar, 0 to 1.
pub(crate) fn bars() -> io::Result<[f64; 2]> {
    let duties = duties()?;
    let mut light = [0.0; 2];
    for (k, light) in light.iter_mut().enumerate() {
        *light = if level(BARS[k])? { duties[k] } else { 0.0 };
    }
    Ok(light)
}
