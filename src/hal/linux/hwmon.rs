//! Temperatures by hwmon. In: a sensor's name. Out: °C. linux/Documentation/hwmon/sysfs-interface.rst.

use super::Sys;
use crate::hal::Error;
use std::fs;
use std::path::{Path, PathBuf};

/// One temperature sensor, looked up anew each time: a camera that was unplugged brings another hwmon number back.
#[derive(Clone, Debug)]
pub struct Thermometer {
    sys: Sys,
    name: String,
}

impl Thermometer {
    /// The sensor `chip` (its first temperature) or `chip/label`.
    pub fn new(sys: Sys, name: &str) -> Self {
        Self { sys, name: name.into() }
    }

    /// °C.
    pub fn read(&self) -> Result<f64, Error> {
        let (chip, label) = self.name.split_once('/').map_or((self.name.as_str(), None), |(c, l)| (c, Some(l)));
        let text = |file: &Path| fs::read_to_string(file).map(|s| s.trim().to_owned());
        let mut there = Vec::new();
        for folder in fs::read_dir(self.sys.0.join("class/hwmon")).into_iter().flatten().flatten() {
            let folder = folder.path();
            let Ok(name) = text(&folder.join("name")) else { continue };
            for (input, labelled) in inputs(&folder) {
                if name == chip && label.is_none_or(|l| labelled.as_deref() == Some(l)) {
                    let value = text(&input).map_err(|source| Error::Call {
                        device: format!("temperature {}", self.name),
                        call: "hwmon read",
                        source,
                    })?;
                    let milli: f64 = value.parse().map_err(|_| Error::Gone { device: self.name.clone() })?;
                    return Ok(milli / 1000.0);
                }
                there.push(labelled.map_or_else(|| name.clone(), |l| format!("{name}/{l}")));
            }
        }
        let (device, what) = ("temperatures".to_owned(), "hwmon sensor");
        Err(Error::Absent { device, what, wanted: self.name.clone(), there })
    }
}

/// The temperatures of one chip in the order of their numbers, with their labels.
fn inputs(folder: &Path) -> Vec<(PathBuf, Option<String>)> {
    let files = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut inputs: Vec<PathBuf> = files.map(|f| f.path()).filter(|p| is_temperature(p)).collect();
    inputs.sort();
    let label = |input: &PathBuf| {
        let file = input.display().to_string().replace("_input", "_label");
        fs::read_to_string(file).ok().map(|s| s.trim().to_owned())
    };
    inputs
        .into_iter()
        .map(|i| {
            let l = label(&i);
            (i, l)
        })
        .collect()
}

fn is_temperature(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy();
    name.starts_with("temp") && name.ends_with("_input")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sensor_is_found_by_its_chips_name_and_its_label() {
        let root = std::env::temp_dir().join(format!("datum-hwmon-{}", std::process::id()));
        let chip = root.join("class/hwmon/hwmon3");
        fs::create_dir_all(&chip).expect("writable");
        for (file, value) in
            [("name", "head\n"), ("temp1_input", "41500\n"), ("temp2_input", "-2250\n"), ("temp2_label", "Projector\n")]
        {
            fs::write(chip.join(file), value).expect("writable");
        }
        let read = |name: &str| Thermometer::new(Sys(root.clone()), name).read();
        assert_eq!(read("head").expect("there"), 41.5);
        assert_eq!(read("head/Projector").expect("there"), -2.25);
        let absent = read("cpu").expect_err("absent").to_string();
        assert_eq!(absent, "temperatures: no hwmon sensor \"cpu\", there: head, head/Projector");
        fs::remove_dir_all(root).expect("just made");
    }
}
