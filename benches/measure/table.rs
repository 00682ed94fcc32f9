//! The table: ours, what stands beside it, the ratio, and what was asked for.

use crate::peers::Times;
use std::fmt;
use std::path::Path;

pub(crate) struct Table<'a> {
    /// Where criterion keeps what it measured.
    pub(crate) folder: &'a Path,
    pub(crate) opencv: Option<Times>,
}

/// What a row is held against.
enum Beside {
    /// Another row's time: at most so many times it.
    Ours(&'static str, f64),
    /// OpenCV's: at least so many times faster.
    OpenCv(f64),
    /// ms.
    Limit(f64),
    Nothing,
}

const ROWS: [(&str, &str, Beside); 10] = [
    ("parts", "read_image", Beside::Nothing),
    ("parts", "add_image", Beside::Ours("read_image", 3.0)),
    ("parts", "wrap_4", Beside::OpenCv(1.0)),
    ("parts", "decode_unwrap_3x4", Beside::OpenCv(2.0)),
    ("parts", "find_4_regions", Beside::OpenCv(1.0)),
    ("parts", "edges_4_regions", Beside::OpenCv(1.0)),
    ("measure", "begin", Beside::Nothing),
    ("measure", "all_16_add_fringe", Beside::Nothing),
    ("measure", "finish", Beside::Limit(60.0)),
    ("measure", "whole", Beside::Limit(250.0)),
];

impl Table<'_> {
    /// Median, ms; none where it was not measured, as a filter on the command line may have it.
    fn ms(&self, group: &str, row: &str, threads: usize) -> Option<f64> {
        let file = self.folder.join(format!("{group}_{threads}")).join(row).join("new/estimates.json");
        let estimates: serde_json::Value = serde_json::from_slice(&std::fs::read(file).ok()?).ok()?;
        Some(estimates["median"]["point_estimate"].as_f64()? * 1e-6)
    }

    fn line(&self, (group, row, beside): &(&str, &str, Beside), threads: usize) -> Option<String> {
        let ours = self.ms(group, row, threads)?;
        let beside = match beside {
            Beside::Ours(other, most) => {
                let ratio = ours / self.ms(group, other, threads)?;
                format!("{ratio:5.2} x {other}, must {most} at most")
            }
            Beside::OpenCv(faster) => match self.opencv.as_ref().and_then(|times| times.get(&(*row, threads))) {
                Some(theirs) => format!("OpenCV {theirs:6.2} ms: {:5.2} x faster, must {faster}", theirs / ours),
                None => format!("OpenCV not there, must {faster} x faster"),
            },
            Beside::Limit(most) => format!("must {most} ms at most on two cores"),
            Beside::Nothing => String::new(),
        };
        Some(format!("{row:20} {threads:7} {ours:9.2}  {beside}"))
    }
}

impl fmt::Display for Table<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "2592x1944            threads        ms")?;
        let lines = ROWS.iter().flat_map(|row| [1, 2].into_iter().filter_map(|threads| self.line(row, threads)));
        lines.into_iter().try_for_each(|line| writeln!(f, "{line}"))
    }
}
