//! The simulated station's vehicle models. In: a folder without any. Out: the ten named ones, taught and released into it.
//! Not here: a real station's, which a person teaches.

use crate::Calibration;
use crate::measure::Shared;
use crate::station::{Entry, Simulated, StationFile, load, missing, outdated, teach_one};
use anyhow::Context;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, mpsc};
use std::time::Instant;

/// On a simulated station without models, or with those that an earlier version of datum taught into its folder by itself,
/// the ten named ones are taught: the first at once, the others beside its work.
pub(super) fn models(
    simulated: &Simulated,
    config: &StationFile,
    calibration: &Calibration,
    shared: Shared,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<mpsc::Receiver<Entry>> {
    let (add, more) = mpsc::channel();
    let folder = config.beside(&config.jobs.folder);
    let mut wanted = missing(&folder);
    // a folder with other models is somebody's own
    if wanted.len() < 10 && !folder.join(".simulated").exists() {
        return Ok(more);
    }
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    std::fs::write(folder.join(".simulated"), "The models in this folder are taught by `datum run` itself.\n")?;
    wanted.extend(outdated(&folder));
    wanted.sort_unstable();
    let setup = Arc::clone(&simulated.setup);
    let teach = move |job: u16| -> anyhow::Result<PathBuf> {
        let began = Instant::now();
        let file = teach_one(&setup, job, &folder)?;
        eprintln!("{}: taught and released in {:.1} s", file.display(), began.elapsed().as_secs_f64());
        Ok(file)
    };
    if wanted.first() == Some(&1) {
        teach(1)?;
    }
    let rest: Vec<u16> = wanted.into_iter().filter(|job| *job > 1).collect();
    let (calibration, stop) = (calibration.clone(), Arc::clone(stop));
    let thread = std::thread::Builder::new().name("teaching".into());
    thread.spawn(move || {
        for job in rest {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            match teach(job) {
                Ok(file) => {
                    let _ = add.send(load(job, &file, &calibration, &shared)); // the station has ended
                }
                Err(e) => eprintln!("job {job}: {e:#}"),
            }
        }
    })?;
    Ok(more)
}
