//! `datum simulate`: captures of the simulated station with their truth, a calibration, a features file; or a picture.

use super::{Status, print};
use crate::capture::{Devices, Plan, record};
use crate::document::{self, Check};
use crate::image::write_png_rgb;
use crate::sim::{self, Body, Build, Deviation, PAINTS, Paint, Random, Scene, Script, Setup, Station};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The folder to write into: one capture per pose, calibration.toml, features.toml
    #[arg(long, value_name = "DIR", required_unless_present = "picture")]
    out: Option<PathBuf>,
    /// suv-a to suv-f, sedan-a to sedan-d, or "random": a body drawn from the seed
    #[arg(long, value_name = "NAME", default_value = "suv-a")]
    vehicle: String,
    /// white, silver, grey, red, blue, black, or "random": another one for each pose
    #[arg(long, value_name = "NAME", default_value = "white")]
    paint: String,
    /// How many poses, drawn from the seed (the first is where the vehicle should stand), or a file of
    /// [[pose]] with along_mm, across_mm, up_mm, roll_deg, pitch_deg, yaw_deg, as the vehicle is off, each 0 if not given
    #[arg(long, value_name = "N|FILE", default_value = "1")]
    poses: String,
    /// What everything random is drawn from
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// Size of the camera's image: 1, 0.5 or 0.25 of 2592×1944
    #[arg(long, value_name = "SCALE", default_value_t = 0.5)]
    scale: f64,
    /// Bits of the camera's samples: 8 or 10
    #[arg(long, value_name = "BITS", default_value_t = 8)]
    bits: u8,
    /// Drive of both bars, 0 to 1
    #[arg(long, value_name = "DRIVE", default_value_t = 0.6)]
    bars: f64,
    /// How far the bars stand to either side, mm; where the default has them, some poses mirror one on a corner
    #[arg(long, value_name = "MM", default_value_t = sim::BARS_MM)]
    bars_at: f64,
    /// Every body exactly as drawn: no door, bumper or flap is off
    #[arg(long)]
    as_drawn: bool,
    /// Leaves out the repeated image at the end that shows whether the vehicle moved
    #[arg(long)]
    no_repeat: bool,
    /// Writes a picture of the first pose for people, and no captures unless --out is given
    #[arg(long, value_name = "FILE")]
    picture: Option<PathBuf>,
}

/// A file of poses.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct Poses {
    #[serde(rename = "format")]
    _format: u32,
    #[serde(default)]
    pose: Vec<Deviation>,
}

/// More would be a slip of the finger.
const MAX_POSES: usize = 10_000;

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let at = Path::new("datum simulate");
    let check = Check(at);
    check.that([1.0, 0.5, 0.25].contains(&a.scale), "--scale", a.scale, "1, 0.5 or 0.25")?;
    check.that([8, 10].contains(&a.bits), "--bits", a.bits, "8 or 10")?;
    check.within("--bars", a.bars, 0.0..=1.0)?;
    let names = || sim::names().collect::<Vec<_>>().join(", ");
    let body = match a.vehicle.as_str() {
        "random" => Body::random(a.seed),
        name => Body::named(name).with_context(|| format!("--vehicle = {name}, allowed: {}, random", names()))?,
    };
    let paints: Vec<&str> = PAINTS.iter().map(|p| p.name).collect();
    let known = a.paint == "random" || paints.contains(&a.paint.as_str());
    check.that(known, "--paint", &a.paint, format!("{}, random", paints.join(", ")))?;
    let deviations = deviations(a, check)?;
    check.within("--bars-at", a.bars_at, 300.0..=2000.0)?;
    let mut setup = Setup::new(a.scale, a.bits);
    setup.place_bars(a.bars_at);
    let setup = Arc::new(setup);

    let mut written = 0;
    let mut features_written = false;
    for (k, deviation) in deviations.iter().enumerate() {
        let mut random = Random::new(a.seed, &[k as u64]);
        let paint = Paint::named(&a.paint).unwrap_or_else(|| PAINTS[random.below(PAINTS.len())]);
        let build = if a.as_drawn { Build::default() } else { Build::random(&mut random) };
        let body = body.clone().built(build);
        let scene = Scene::new(body, paint, deviation);
        if let (0, Some(file)) = (k, &a.picture) {
            write_png_rgb(file, &sim::picture(&scene, &setup))?;
        }
        let Some(out) = &a.out else { break };
        let name = format!("{}-{k:03}", paint.name);
        let folder = out.join(&name);
        let vehicle = (scene.body.clone(), paint, *deviation);
        let station = Station::with_vehicle(Arc::clone(&setup), random.bits(), vehicle, Script::default());
        let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
        let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
        let plan = Plan { bars: [a.bars; 2], repeat: !a.no_repeat, ..Plan::default() };
        record(&mut devices, &plan, &folder)?;
        let truth = sim::truth(&scene, &setup, &format!("{k:03}"), deviation);
        let mut text = serde_json::to_string_pretty(&truth)?;
        text.push('\n');
        document::write_bytes(&folder.join("truth.json"), text.as_bytes())?;
        if let Some(features) = sim::features(&scene, &setup) {
            features.write(&folder.join("features.toml"))?;
            if !features_written {
                features.write(&out.join("features.toml"))?;
                features_written = true;
            }
        }
        written += 1;
        eprintln!("{}: {} of {}", folder.display(), written, deviations.len());
    }
    if let Some(out) = &a.out {
        sim::calibration(&setup).write(&out.join("calibration.toml"))?;
        print(&format!("{}: {written} captures of {}, calibration.toml, features.toml\n", out.display(), body.name))?;
    }
    Ok(Status::Done)
}

fn deviations(a: &Arguments, check: Check) -> anyhow::Result<Vec<Deviation>> {
    if let Ok(n) = a.poses.parse::<usize>() {
        check.within("--poses", n, 1..=MAX_POSES)?;
        let mut random = Random::new(a.seed, &[u64::MAX]);
        let drawn = (1..n).map(|_| Deviation::random(&mut random));
        return Ok(std::iter::once(Deviation::default()).chain(drawn).collect());
    }
    let file = Path::new(&a.poses);
    let poses: Poses = document::read(file)?;
    let check = Check(file);
    check.within("number of [[pose]]", poses.pose.len(), 1..=MAX_POSES)?;
    for (k, d) in poses.pose.iter().enumerate() {
        for (key, value, most) in [
            ("along_mm", d.along_mm, 1000.0),
            ("across_mm", d.across_mm, 300.0),
            ("up_mm", d.up_mm, 300.0),
            ("roll_deg", d.roll_deg, 20.0),
            ("pitch_deg", d.pitch_deg, 20.0),
            ("yaw_deg", d.yaw_deg, 30.0),
        ] {
            check.within(format!("pose[{k}].{key}"), value, -most..=most)?;
        }
    }
    Ok(poses.pose)
}
