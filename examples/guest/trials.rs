//! What must hold of `datum` on real V4L2, GPIO and PWM. In: a folder that `guest prepare` wrote. Out: a line for each
//! thing seen; an error for the first that does not hold.

use crate::pins::{self, PRESENCE};
use crate::player::{Player, digest};
use crate::plc::{Outcome, Plc};
use crate::program::{Program, doctor, doctor_of, lit, safe};
use crate::vehicles::{self, Expected, SCALE, Six, scene};
use anyhow::{Context, bail, ensure};
use datum::Capture;
use datum::fringe::PatternSet;
use datum::sim::Setup;
use std::collections::HashMap;
use std::path::PathBuf;
use std::process::{Command, ExitCode};
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// What `guest prepare` wrote
    #[arg(long, default_value = "station")]
    folder: PathBuf,
    /// Which
    #[arg(required = true)]
    trials: Vec<Trial>,
}

#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub(crate) enum Trial {
    /// `datum doctor` finds nothing wrong, and names a format that the camera does not have
    Doctor,
    /// Poses are those of the in-process simulation
    Vehicles,
    /// With 5 % of the images lost and 5 % broken no image is taken for another pattern's
    Faults,
    /// The camera is unplugged and returns, 20 times
    Unplug,
    /// A bouncing presence sensor begins one cycle
    Bounce,
    /// Killed at any time, all is dark after `datum safe`
    Kill,
}

/// Until datum is ready, from its start.
const STARTS: Duration = Duration::from_secs(60);
/// Longer than the presence sensor's debouncing.
const GONE: Duration = Duration::from_millis(700);
/// Ready again after the camera's return.
const READY_AGAIN: Duration = Duration::from_secs(5);
/// Percent of images that are lost, and that are broken.
const FAULTY: i32 = 5;
/// Codes of images that are missing or out of step.
const REFUSED: [u16; 2] = [202, 204];
/// A pose's difference from the in-process simulation's may be so many times as large as two of those differ, rms; from
/// so many vehicles on: of fewer the rms says little.
const NOISE_RATIO: f64 = 2.0;
const ENOUGH: usize = 10;

pub(crate) fn run(a: &Arguments) -> anyhow::Result<ExitCode> {
    let setup = Arc::new(Setup::new(SCALE, 8));
    let (expected, jobs) = vehicles::expected(&a.folder)?;
    let player = Player::start(&setup, 1).context("the scene player")?;
    let bench = Bench { player, folder: a.folder.clone(), expected, jobs, setup };
    for trial in &a.trials {
        let began = Instant::now();
        println!("== {trial:?}");
        let shown = match trial {
            Trial::Doctor => bench.doctor(),
            Trial::Vehicles => bench.vehicles(),
            Trial::Faults => bench.faults(),
            Trial::Unplug => bench.unplug(),
            Trial::Bounce => bench.bounce(),
            Trial::Kill => bench.kill(),
        };
        shown.with_context(|| format!("{trial:?}"))?;
        println!("== {trial:?}: holds ({:.0} s of the guest's time)", began.elapsed().as_secs_f64());
    }
    bench.player.end().context("the scene player")?;
    Ok(ExitCode::SUCCESS)
}

struct Bench {
    player: Player,
    folder: PathBuf,
    expected: Vec<Expected>,
    jobs: u16,
    setup: Arc<Setup>,
}

impl Bench {
    /// A running datum that is ready for triggers.
    fn begin(&self, trigger: &str) -> anyhow::Result<(Program, Plc)> {
        let mut datum = Program::run(&self.folder, trigger)?;
        let plc = owned(&mut datum)?;
        Ok((datum, plc))
    }

    /// One vehicle comes, is measured and goes.
    fn one(&self, plc: &mut Plc, number: usize) -> anyhow::Result<Outcome> {
        self.player.bring(&scene(number, self.jobs))?;
        sleep(GONE);
        let outcome = plc.measure(1 + number as u16, self.expected[number].job)?;
        self.player.leave()?;
        sleep(GONE);
        Ok(outcome)
    }

    fn doctor(&self) -> anyhow::Result<()> {
        self.player.bring(&scene(0, self.jobs))?;
        doctor(&self.folder)?;
        // a node of vimc: 8 and 10 bits, and colour
        let modprobe = Command::new("modprobe").arg("vimc").status()?;
        ensure!(modprobe.success(), "modprobe vimc: {modprobe}");
        let said = doctor_of(&self.folder, "Raw Capture 0", "Y12")?;
        let named: Vec<&str> = said.lines().skip_while(|l| !l.starts_with("WRONG  camera ")).take(2).collect();
        println!("{}", named.join("\n"));
        let [what, hint] = named[..] else { bail!("the wrong format is not named: {said}") };
        ensure!(what.contains("the format Y12 is not offered, offered: ") && what.contains("GREY, Y10"), "{what}");
        ensure!(hint.trim_start().starts_with("-> Set camera.format to one that"), "{hint}");
        self.player.leave().context("the presence line")
    }

    fn vehicles(&self) -> anyhow::Result<()> {
        let (_datum, mut plc) = self.begin("plc")?;
        let (mut off, mut between) = ([0.0; 6], [0.0; 6]);
        for (number, expected) in self.expected.iter().enumerate() {
            let images = self.player.images();
            let outcome = self.one(&mut plc, number)?;
            let pose = outcome.pose.with_context(|| format!("vehicle {number}: {outcome:?}"))?;
            let d = difference(&pose, &expected.poses[0]);
            println!(
                "vehicle {number:2} job {} {} less in-process {} ({} images played)",
                expected.job,
                text(&pose),
                text(&d),
                self.player.images() - images
            );
            ensure!(outcome.result <= 2, "vehicle {number}: {outcome:?}");
            within(&d, &expected.uncertainty).with_context(|| format!("vehicle {number}"))?;
            let other = difference(&expected.poses[1], &expected.poses[0]);
            for k in 0..6 {
                off[k] += d[k] * d[k];
                between[k] += other[k] * other[k];
            }
        }
        let rms = |sum: &Six| sum.map(|s| (s / self.expected.len() as f64).sqrt());
        let (off, between) = (rms(&off), rms(&between));
        println!("rms less in-process {}; of two in-process ones {}", text(&off), text(&between));
        for k in 0..6 {
            let few = self.expected.len() < ENOUGH;
            ensure!(few || off[k] <= NOISE_RATIO * between[k], "value {k} of the pose differs by more than noise");
        }
        Ok(())
    }

    fn faults(&self) -> anyhow::Result<()> {
        let (_datum, mut plc) = self.begin("plc")?;
        let (mut ok, mut refused, mut checked) = (0, 0, 0);
        self.player.drop_images(FAULTY)?;
        self.player.break_images(f64::from(FAULTY) / 100.0);
        for (number, expected) in self.expected.iter().enumerate() {
            let outcome = self.one(&mut plc, number)?;
            match outcome.pose {
                Some(pose) => {
                    let d = difference(&pose, &expected.poses[0]);
                    println!("vehicle {number:2} {} less in-process {}", text(&pose), text(&d));
                    within(&d, &expected.uncertainty).with_context(|| format!("vehicle {number}"))?;
                    ok += 1;
                }
                None => {
                    println!("vehicle {number:2} refused: {}", outcome.code);
                    ensure!(REFUSED.contains(&outcome.code), "vehicle {number}: {outcome:?}");
                    refused += 1;
                }
            }
            checked += self.check_captures()?;
        }
        self.player.drop_images(0)?;
        self.player.break_images(0.0);
        println!("{ok} measured, {refused} refused, {checked} images of theirs under their own pattern");
        ensure!(ok > 0 && checked > 0, "nothing was measured");
        Ok(())
    }

    /// Every fringe image that was kept is one that was played, under the pattern that it is said to show. How many;
    /// they are removed.
    fn check_captures(&self) -> anyhow::Result<usize> {
        let lens = &self.setup.rig.projector;
        let played: HashMap<u64, Option<u64>> = self.player.showed().iter().map(|s| (s.image, s.picture)).collect();
        let mut checked = 0;
        let kept = self.folder.join("records/captures");
        let Ok(folders) = std::fs::read_dir(&kept) else { return Ok(0) };
        for folder in folders {
            let folder = folder?.path();
            if !folder.join("capture.toml").exists() {
                continue; // still being written: its turn comes with the next vehicle's
            }
            let capture = Capture::open(&folder)?;
            for set in &capture.fringes {
                let pattern = PatternSet::new(set.axis, set.count, set.steps)?;
                for (step, image) in set.images.iter().enumerate() {
                    let pixels: Vec<u8> = capture.load(image)?.pixels.iter().map(|v| *v as u8).collect();
                    let wanted = digest(&pattern.render(step as u32, lens.width, lens.height).pixels);
                    match played.get(&digest(&pixels)) {
                        Some(Some(shown)) if *shown == wanted => checked += 1,
                        Some(_) => bail!("{}: {} shows another pattern", folder.display(), image.display()),
                        None => bail!("{}: {} was never played", folder.display(), image.display()),
                    }
                }
            }
            std::fs::remove_dir_all(&folder)?;
        }
        Ok(checked)
    }

    fn unplug(&self) -> anyhow::Result<()> {
        const READY: u16 = crate::plc::READY;
        let (mut datum, mut plc) = self.begin("plc")?;
        for time in 1..=20 {
            let before = self.player.returned();
            self.player.unplug(Duration::from_millis(1500));
            plc.until(0, READY, Duration::from_secs(10)).context("it does not notice that the camera is gone")?;
            let began = Instant::now();
            while self.player.returned() == before {
                ensure!(began.elapsed() < Duration::from_secs(10), "datum keeps the camera that is gone open");
                sleep(Duration::from_millis(10));
            }
            let back = Instant::now();
            if plc.error()? != 0 {
                plc.clear()?;
            }
            plc.until(READY, 0, READY_AGAIN)?;
            let took = back.elapsed();
            ensure!(took <= READY_AGAIN, "return {time}: ready after {took:?}");
            println!("return {time:2}: ready after {} ms", took.as_millis());
            ensure!(datum.lives()?, "datum ended");
        }
        let outcome = self.one(&mut plc, 0)?;
        let pose = outcome.pose.with_context(|| format!("{outcome:?}"))?;
        within(&difference(&pose, &self.expected[0].poses[0]), &self.expected[0].uncertainty)
    }

    fn bounce(&self) -> anyhow::Result<()> {
        const BOUNCE: Duration = Duration::from_millis(5);
        let (_datum, mut plc) = self.begin("presence")?;
        let results = |plc: &mut Plc| -> anyhow::Result<u16> { Ok(plc.input(12, 1)?[0]) };
        for round in 1..=10 {
            let before = results(&mut plc)?;
            // a spike without a vehicle
            pins::pull(PRESENCE, true)?;
            sleep(BOUNCE);
            pins::pull(PRESENCE, false)?;
            sleep(2 * GONE);
            ensure!(results(&mut plc)? == before, "round {round}: a spike of 5 ms began a cycle");
            self.player.bring(&scene(0, self.jobs))?;
            for _ in 0..round {
                sleep(BOUNCE);
                pins::pull(PRESENCE, false)?;
                sleep(BOUNCE);
                pins::pull(PRESENCE, true)?;
            }
            let outcome = plc.result(Duration::from_secs(60)).with_context(|| format!("round {round}"))?;
            ensure!(outcome.result == 1, "round {round}: {outcome:?}");
            // the vehicle stands on, its sensor drops out for an instant
            pins::pull(PRESENCE, false)?;
            sleep(BOUNCE);
            pins::pull(PRESENCE, true)?;
            sleep(3 * GONE);
            let after = results(&mut plc)?;
            ensure!(after == before.wrapping_add(1), "round {round}: {} results", after.wrapping_sub(before));
            self.player.leave()?;
            sleep(2 * GONE);
        }
        println!("10 vehicles, up to 10 bounces each: one result each");
        Ok(())
    }

    fn kill(&self) -> anyhow::Result<()> {
        let mut left = 0;
        for phase in Phase::ALL {
            let mut datum = Program::run(&self.folder, "plc")?;
            self.player.bring(&scene(0, self.jobs))?;
            self.reach(&mut datum, phase).with_context(|| format!("{phase:?}"))?;
            datum.kill()?;
            let before = lit()?;
            left += usize::from(!before.is_empty());
            safe(&self.folder)?;
            let after = lit()?;
            println!("killed at {phase:?}: lit {before:?}, after datum safe {after:?}");
            ensure!(after.is_empty(), "{phase:?}: {after:?}");
            self.dark_projector()?;
            self.player.leave()?;
        }
        ensure!(left > 0, "no kill left anything lit: this shows nothing");
        Ok(())
    }

    /// Waits until datum is in that phase.
    fn reach(&self, datum: &mut Program, phase: Phase) -> anyhow::Result<()> {
        let until = |reached: &dyn Fn() -> bool| -> anyhow::Result<()> {
            let began = Instant::now();
            while !reached() {
                ensure!(began.elapsed() < STARTS, "not reached");
                sleep(Duration::from_millis(5));
            }
            Ok(())
        };
        let bars = || pins::bars().is_ok_and(|b| b[0] + b[1] > 0.0);
        let fringes = || self.player.showed().last().is_some_and(|s| s.picture.is_some());
        match phase {
            Phase::Starting => {
                sleep(Duration::from_millis(200));
                return Ok(());
            }
            Phase::SelfTest => return until(&bars),
            _ => {}
        }
        let mut plc = owned(datum)?;
        if phase == Phase::Ready {
            return Ok(());
        }
        plc.trigger(1, self.expected[0].job)?;
        match phase {
            Phase::Red => until(&bars),
            Phase::Fringes => {
                until(&bars)?;
                until(&|| !bars())?;
                until(&fringes)
            }
            _ => {
                const ACQ_DONE: u16 = 8;
                plc.until(ACQ_DONE, 0, Duration::from_secs(30)).map(drop)?;
                if phase == Phase::Result { plc.until(0x10, 0, Duration::from_secs(60)).map(drop) } else { Ok(()) }
            }
        }
    }

    fn dark_projector(&self) -> anyhow::Result<()> {
        let began = Instant::now();
        let from = self.player.images();
        // images that were begun before may still show it
        while self.player.images() < from + 3 {
            ensure!(began.elapsed() < Duration::from_secs(10), "the player stands still");
            sleep(Duration::from_millis(10));
        }
        let last = self.player.showed().last().cloned();
        ensure!(last.as_ref().is_some_and(|s| s.picture.is_none() && s.bars == [0.0; 2]), "still lit: {last:?}");
        Ok(())
    }
}

/// A PLC that owns the station, when it is ready.
fn owned(datum: &mut Program) -> anyhow::Result<Plc> {
    let began = Instant::now();
    let mut plc = loop {
        match Plc::connect() {
            Ok(plc) => break plc,
            Err(e) if began.elapsed() > STARTS => return Err(e),
            Err(_) => sleep(Duration::from_millis(50)),
        }
        ensure!(datum.lives()?, "datum ended while it started");
    };
    plc.own(STARTS).context("datum's start")?;
    Ok(plc)
}

/// When datum is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Starting,
    SelfTest,
    Ready,
    Red,
    Fringes,
    Processing,
    Result,
}

impl Phase {
    const ALL: [Self; 7] =
        [Self::Starting, Self::SelfTest, Self::Ready, Self::Red, Self::Fringes, Self::Processing, Self::Result];
}

fn difference(a: &Six, b: &Six) -> Six {
    std::array::from_fn(|k| a[k] - b[k])
}

/// Each value within its uncertainty.
fn within(difference: &Six, uncertainty: &Six) -> anyhow::Result<()> {
    for (k, (d, u)) in difference.iter().zip(uncertainty).enumerate() {
        ensure!(d.abs() <= *u, "value {k} of the pose differs by {d:.4} from the in-process one's, U is {u:.4}");
    }
    Ok(())
}

fn text(six: &Six) -> String {
    let [x, y, z, roll, pitch, yaw] = six;
    format!("{x:+.3} {y:+.3} {z:+.3} mm {roll:+.4} {pitch:+.4} {yaw:+.4}°")
}
