//! What a detector finds in images, to be held against another runtime: a line of JSON per image, and the times.
//! In: a network, a threshold, PNGs. Out: `{"image", "ms", "cpu_ms", "boxes": [{"class", "score", "sides"}]}`; sides are
//! left, top, right, bottom in the image's pixels, centres at integers. `cpu_ms` is the thread's time on the processor.
//!
//! `cargo run --release --example detect -- NETWORK.onnx 0.5 IMAGE.png …`

use anyhow::Context;
use datum::detect::Detector;
use datum::image::{read_png, read_png_header};
use std::io::Write;
use std::path::Path;
use std::time::Instant;

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [network, threshold, images @ ..] = &arguments[..] else {
        anyhow::bail!("usage: detect NETWORK.onnx THRESHOLD IMAGE.png …");
    };
    let began = Instant::now();
    let detector = Detector::read(Path::new(network))?.with_threshold(threshold.parse().context("THRESHOLD")?);
    let (shape, cut) = detector.shape();
    eprintln!("{network}: input {shape:?}, head cut: {cut}, ready in {:.0} ms", began.elapsed().as_secs_f64() * 1e3);
    let mut out = std::io::stdout().lock();
    let mut times = Vec::new();
    for path in images {
        let file = Path::new(path);
        let bits = read_png_header(file)?.bits;
        let image = read_png(file)?;
        let white = if bits > 8 { 65535.0 } else { 255.0 };
        let (began, began_cpu) = (Instant::now(), cpu_ms());
        let found = detector.detect(&image, white)?;
        let (ms, cpu_ms) = (began.elapsed().as_secs_f64() * 1e3, cpu_ms() - began_cpu);
        times.push(ms);
        let box_ =
            |d: &datum::detect::Detection| serde_json::json!({"class": d.class, "score": d.score, "sides": d.sides});
        let boxes: Vec<_> = found.iter().map(box_).collect();
        writeln!(out, "{}", serde_json::json!({"image": path, "ms": ms, "cpu_ms": cpu_ms, "boxes": boxes}))?;
    }
    times.sort_by(f64::total_cmp);
    let peak = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = peak.lines().find(|l| l.starts_with("VmHWM")).unwrap_or("VmHWM: unknown");
    if let Some(median) = times.get(times.len() / 2) {
        eprintln!("{} images, median {median:.1} ms, {peak}", times.len());
    }
    Ok(())
}

/// What this thread has had of the processor, ms; 0 where the kernel does not say.
fn cpu_ms() -> f64 {
    let stat = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let ns = stat.split(' ').next().and_then(|ns| ns.parse::<f64>().ok());
    1e-6 * ns.unwrap_or(0.0)
}
