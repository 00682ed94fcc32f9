//! OpenCV's times on this machine, in this run: of the given script, and of `peer.py` beside this file.

use crate::parts::Images;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

/// By what of ours it stands beside, and threads: median ms.
pub(crate) type Times = BTreeMap<(&'static str, usize), f64>;

/// None without DATUM_DATA, or where Python has no OpenCV.
pub(crate) fn opencv(images: &Images) -> Option<Times> {
    let data = std::env::var_os("DATUM_DATA")?;
    let python = std::env::var_os("DATUM_PYTHON").unwrap_or_else(|| "python3".into());
    let run = |script: &Path, argument: &Path| {
        let out = Command::new(&python).arg(script).arg(argument).output().ok()?;
        if !out.status.success() {
            eprintln!("{}: {}", script.display(), String::from_utf8_lossy(&out.stderr));
            return None;
        }
        Some(out.stdout)
    };
    let scratch = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let (results, regions) = (scratch.join("opencv.json"), scratch.join("regions.raw"));
    run(&Path::new(&data).join("tools/opencv_bench.py"), &results)?;
    let given: Value = serde_json::from_slice(&std::fs::read(&results).ok()?).ok()?;
    let grey: Vec<u8> = images.regions.iter().flat_map(|r| r.pixels.iter().map(|v| *v as u8)).collect();
    std::fs::write(&regions, grey).ok()?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/measure/peer.py");
    let edges: Value = serde_json::from_slice(&run(&script, &regions)?).ok()?;
    let mut times = Times::new();
    for threads in [1, 2] {
        let key = threads.to_string();
        for (ours, theirs) in
            [("wrap_4", "4-step wrap+mod cv2.cartToPolar"), ("decode_unwrap_3x4", "3x4-step decode+unwrap cv2")]
        {
            times.insert((ours, threads), given["results"][theirs][&key]["median_ms"].as_f64()?);
        }
        for ours in ["find_4_regions", "edges_4_regions"] {
            times.insert((ours, threads), edges[ours][&key].as_f64()?);
        }
    }
    Some(times)
}
