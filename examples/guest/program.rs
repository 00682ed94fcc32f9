//! The program under test, as a process. In: its configuration. Out: a process that can be asked, killed and looked after.

use crate::pins;
use anyhow::{Context, ensure};
use std::fs::{self, File};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

pub(crate) const PATH: &str = "./datum";

/// The station's configuration in the guest. What the drivers need is here; all else is as datum has it, but for time: the
/// player gives some ten images a second.
pub(crate) const CONFIG: &str = r#"format = 1
serial = "GUEST"
calibration = "calibration.toml"
detector = "none"
[camera]
kind = "v4l2"
device = "/dev/datum/camera"
width = 648
height = 486
format = "GREY"
rate = 8
lag_images = 0
[projector]
kind = "v4l2-output"
device = "/dev/datum/projector"
width = 1280
height = 800
settle_ms = 40
[lights]
kind = "gpio"
left = "datum-gpio/bar-left"
right = "datum-gpio/bar-right"
left_pwm = "datum-pwm/0"
right_pwm = "datum-pwm/1"
alive = "datum-gpio/enable"
[presence]
kind = "gpio"
line = "datum-gpio/presence"
debounce_ms = 300
[cycle]
trigger = "TRIGGER"
acquire_ms = 10000
second_by_ms = 20000
[plc]
heartbeat_s = 30
[records]
keep_every = 1
"#;

/// A running `datum run`. Killed when dropped.
pub(crate) struct Program {
    child: Child,
}

impl Program {
    /// Starts it in `folder`; a cycle begins by `trigger`, "plc" or "presence". What it says goes to datum.log.
    pub(crate) fn run(folder: &Path, trigger: &str) -> anyhow::Result<Self> {
        configure(folder, trigger)?;
        let log = File::options().create(true).append(true).open(folder.join("datum.log"))?;
        let child = Command::new(PATH)
            .args(["run", "-v", "--config"])
            .arg(folder.join("station.toml"))
            .stdin(Stdio::null())
            .stdout(log.try_clone()?)
            .stderr(log)
            .spawn()
            .context(PATH)?;
        Ok(Self { child })
    }

    /// Whether it still runs.
    pub(crate) fn lives(&mut self) -> anyhow::Result<bool> {
        Ok(self.child.try_wait()?.is_none())
    }

    /// SIGKILL.
    pub(crate) fn kill(mut self) -> anyhow::Result<()> {
        self.child.kill()?;
        self.child.wait()?;
        Ok(())
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill(); // it may have ended by itself
        let _ = self.child.wait();
    }
}

fn configure(folder: &Path, trigger: &str) -> anyhow::Result<()> {
    Ok(fs::write(folder.join("station.toml"), CONFIG.replace("TRIGGER", trigger))?)
}

/// `datum doctor`; what it finds goes to the console.
pub(crate) fn doctor(folder: &Path) -> anyhow::Result<()> {
    configure(folder, "plc")?;
    let status = Command::new(PATH).arg("doctor").arg("--config").arg(folder.join("station.toml")).status()?;
    ensure!(status.success(), "datum doctor: {status}");
    Ok(())
}

/// What `datum doctor` says of a camera at another node and in another format. It must find something wrong.
pub(crate) fn doctor_of(folder: &Path, device: &str, format: &str) -> anyhow::Result<String> {
    let (node, grey) = ("device = \"/dev/datum/camera\"", "format = \"GREY\"");
    ensure!(CONFIG.contains(node) && CONFIG.contains(grey), "the configuration has other keys");
    let text = CONFIG.replace("TRIGGER", "plc").replacen(node, &format!("device = \"{device}\""), 1);
    let file = folder.join("wrong.toml");
    fs::write(&file, text.replacen(grey, &format!("format = \"{format}\""), 1))?;
    let out = Command::new(PATH).arg("doctor").arg("--config").arg(&file).output()?;
    fs::remove_file(&file)?;
    ensure!(out.status.code() == Some(3), "datum doctor: {}", out.status);
    Ok(String::from_utf8_lossy(&out.stdout).into_owned())
}

/// `datum safe`, as systemd's ExecStopPost runs it.
pub(crate) fn safe(folder: &Path) -> anyhow::Result<()> {
    let began = Instant::now();
    let status = Command::new(PATH).arg("safe").arg("--config").arg(folder.join("station.toml")).status()?;
    ensure!(status.success(), "datum safe: {status}");
    ensure!(began.elapsed() < Duration::from_secs(5), "datum safe took {:?}", began.elapsed());
    Ok(())
}

/// What is not dark: lines that are high, channels that run.
pub(crate) fn lit() -> anyhow::Result<Vec<String>> {
    let mut lit = Vec::new();
    for line in pins::OUTPUTS {
        if pins::level(line)? {
            lit.push(format!("line {line}"));
        }
    }
    let duties = pins::duties()?;
    lit.extend(duties.iter().enumerate().filter(|(_, d)| **d > 0.0).map(|(k, d)| format!("PWM {k} at {d:.2}")));
    Ok(lit)
}
