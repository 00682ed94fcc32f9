//! Plays the scene while another program runs.

use crate::player::Player;
use anyhow::Context;
use datum::sim::{Body, Deviation, Paint, Scene, Setup};
use std::process::ExitCode;
use std::sync::Arc;
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Size of the camera's image, of 2592×1944: 1, 0.5 or 0.25
    #[arg(long, default_value_t = 0.25)]
    scale: f64,
    /// What stands there, by its model's name; none: nothing
    #[arg(long)]
    vehicle: Option<String>,
    /// Its paint
    #[arg(long, default_value = "white")]
    paint: String,
    /// The program and its arguments
    #[arg(required = true, last = true)]
    program: Vec<String>,
}

pub(crate) fn run(a: &Arguments) -> anyhow::Result<ExitCode> {
    let setup = Arc::new(Setup::new(a.scale, 8));
    let player = Player::start(&setup, 1).context("the scene player")?;
    if let Some(name) = &a.vehicle {
        let body = Body::named(name).with_context(|| format!("no vehicle {name}"))?;
        let paint = Paint::named(&a.paint).with_context(|| format!("no paint {}", a.paint))?;
        player.bring(&Scene::new(body, paint, &Deviation::default()))?;
    }
    let began = Instant::now();
    let status = std::process::Command::new(&a.program[0]).args(&a.program[1..]).status();
    let status = status.with_context(|| a.program[0].clone())?;
    eprintln!("player: {} images in {:.1} s", player.images(), began.elapsed().as_secs_f64());
    player.end().context("the scene player")?;
    Ok(ExitCode::from(status.code().and_then(|c| u8::try_from(c).ok()).unwrap_or(1)))
}
