//! `datum calibrate` as tests call it: the built program, boards by name, captures of them rendered once.

#[path = "board.rs"]
pub(crate) mod board;

use board::{places, rig, write_capture};
use datum::calibrate::Board;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

pub(crate) const CHESS: &str = "chessboard:9x6:45";
pub(crate) const MARKED: &str = "marked:8x4:60:30";

pub(crate) fn parsed(board: &str) -> Board {
    board.parse().expect("a board")
}

/// An empty folder that only the calling test file uses.
pub(crate) fn empty_folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).expect("the target folder is writable");
    folder
}

/// Captures of the chessboard in `folder`, at all but the first `skipped` places; `seed`: of the noise.
pub(crate) fn write_captures(folder: &Path, skipped: usize, count: usize, seed: u64) -> Vec<PathBuf> {
    let board = parsed(CHESS);
    let write = |(k, pose)| {
        let capture = folder.join(format!("board-{k}"));
        write_capture(&capture, &rig(), &board, &pose, true, k as u64 + seed);
        capture
    };
    places(&board).into_iter().skip(skipped).take(count).enumerate().map(write).collect()
}

pub(crate) struct Run {
    pub(crate) status: i32,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Run {
    pub(crate) fn json(&self) -> Value {
        serde_json::from_str(&self.out).unwrap_or_else(|e| panic!("{e}: {}{}", self.out, self.err))
    }
}

pub(crate) fn text(path: &Path) -> &str {
    path.to_str().expect("a path in ASCII")
}

pub(crate) fn calibrate(arguments: &[&str], files: &[PathBuf]) -> Run {
    let run = Command::new(env!("CARGO_BIN_EXE_datum")).arg("calibrate").args(arguments).args(files).output();
    let run = run.expect("the program runs");
    let string = |bytes: Vec<u8>| String::from_utf8(bytes).expect("UTF-8");
    Run { status: run.status.code().expect("no signal"), out: string(run.stdout), err: string(run.stderr) }
}

/// What a bad input is told, with exit status 2.
pub(crate) fn refused(arguments: &[&str], files: &[PathBuf]) -> String {
    let run = calibrate(arguments, files);
    assert_eq!(run.status, 2, "{}{}", run.out, run.err);
    run.err
}
