//! Calibration boards: how they are named, and where their points lie.
//! In: the text of `--board`. Out: the points of a flat board, mm. Not here: finding them in an image.

use nalgebra::Vector2;
use std::fmt;
use std::str::FromStr;

/// A flat board. Its frame: origin at the first point, x along a row of points, y from row to row, z = x × y, so that
/// z points away from whoever looks at its face.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Board {
    /// What its points are.
    pub kind: BoardKind,
    /// Points in a row.
    pub columns: usize,
    /// Rows of points.
    pub rows: usize,
    /// Distance of neighbouring points, mm.
    pub pitch: f64,
}

/// What the points of a board are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BoardKind {
    /// Inner corners of a chessboard.
    Chessboard,
    /// Centres of dark discs on a bright ground.
    Circles {
        /// Of the discs, mm.
        diameter: f64,
    },
    /// As `Circles`; three small discs tell which is the first: half a pitch from it along x, half a pitch along y, and
    /// half a pitch along x from its neighbour in the second row.
    Marked {
        /// Of the discs, mm. The marks are much smaller.
        diameter: f64,
    },
}

impl Board {
    /// The points in the board's plane, mm, row by row; the first is (0, 0).
    pub fn points(&self) -> Vec<Vector2<f64>> {
        let at = |i: usize| Vector2::new((i % self.columns) as f64, (i / self.columns) as f64) * self.pitch;
        (0..self.columns * self.rows).map(at).collect()
    }

    /// The discs' diameter, mm; `None` of a chessboard.
    pub fn diameter(&self) -> Option<f64> {
        match self.kind {
            BoardKind::Chessboard => None,
            BoardKind::Circles { diameter } | BoardKind::Marked { diameter } => Some(diameter),
        }
    }
}

/// As `--board` takes it.
impl fmt::Display for Board {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Self { columns, rows, pitch, .. } = self;
        match self.kind {
            BoardKind::Chessboard => write!(f, "chessboard:{columns}x{rows}:{pitch}"),
            BoardKind::Circles { diameter } => write!(f, "circles:{columns}x{rows}:{pitch}:{diameter}"),
            BoardKind::Marked { diameter } => write!(f, "marked:{columns}x{rows}:{pitch}:{diameter}"),
        }
    }
}

/// Text that names no board.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "board {text:?}: {problem}; allowed: chessboard:COLUMNSxROWS:PITCH (inner corners, mm), \
     circles:COLUMNSxROWS:PITCH:DIAMETER, marked:COLUMNSxROWS:PITCH:DIAMETER"
)]
pub struct NotABoard {
    text: String,
    problem: &'static str,
}

impl FromStr for Board {
    type Err = NotABoard;

    fn from_str(text: &str) -> Result<Self, NotABoard> {
        let not = |problem| NotABoard { text: text.into(), problem };
        let parts: Vec<&str> = text.split(':').collect();
        let (&name, size, lengths) = match parts.as_slice() {
            [name, size, lengths @ ..] => (name, *size, lengths),
            _ => return Err(not("a name, a size and lengths are needed")),
        };
        let (columns, rows) = size.split_once('x').ok_or_else(|| not("the size is no COLUMNSxROWS"))?;
        let count = |t: &str| t.parse().ok().filter(|n| (3..=100).contains(n));
        let (columns, rows) =
            count(columns).zip(count(rows)).ok_or_else(|| not("columns and rows are whole numbers from 3 to 100"))?;
        let lengths: Option<Vec<f64>> =
            lengths.iter().map(|t| t.parse().ok().filter(|v| (1e-3..=1e5).contains(v))).collect();
        let lengths = lengths.ok_or_else(|| not("lengths are 0.001 to 100000 mm"))?;
        let (kind, pitch) = match (name, lengths.as_slice()) {
            ("chessboard", &[pitch]) => (BoardKind::Chessboard, pitch),
            ("circles", &[pitch, diameter]) => (BoardKind::Circles { diameter }, pitch),
            ("marked", &[pitch, diameter]) => (BoardKind::Marked { diameter }, pitch),
            ("chessboard", _) => return Err(not("a chessboard has one length, the pitch")),
            ("circles" | "marked", _) => return Err(not("circles have two lengths, pitch and diameter")),
            _ => return Err(not("no such kind")),
        };
        let board = Self { kind, columns, rows, pitch };
        if board.diameter().is_some_and(|d| d > 0.9 * pitch) {
            return Err(not("the discs touch: the diameter is more than 0.9 of the pitch"));
        }
        Ok(board)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_board_reads_as_it_is_written() {
        for text in ["chessboard:11x8:35", "circles:8x4:60:30", "marked:8x4:60:30.5"] {
            assert_eq!(text.parse::<Board>().expect(text).to_string(), text);
        }
        let board: Board = "chessboard:11x8:35".parse().expect("legal");
        let points = board.points();
        assert_eq!((points.len(), points[0], points[12]), (88, Vector2::zeros(), Vector2::new(35.0, 35.0)));
    }

    #[test]
    fn what_names_no_board_is_refused_with_the_syntax() {
        for (text, problem) in [
            ("chessboard", "a name, a size and lengths are needed"),
            ("chessboard:11:35", "no COLUMNSxROWS"),
            ("chessboard:2x8:35", "from 3 to 100"),
            ("chessboard:11x8", "one length"),
            ("chessboard:11x8:0", "0.001 to 100000 mm"),
            ("chessboard:11x8:NaN", "0.001 to 100000 mm"),
            ("circles:8x4:60", "two lengths"),
            ("circles:8x4:60:60", "touch"),
            ("charuco:8x4:60", "no such kind"),
        ] {
            let e = text.parse::<Board>().expect_err(text).to_string();
            assert!(e.contains(problem) && e.contains(text) && e.contains("allowed: chessboard:"), "{e}");
        }
    }
}
