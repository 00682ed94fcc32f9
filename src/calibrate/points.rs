//! Given correspondences. In: text files of numbers, x and y in turn, white space between. Out: points.
//! Zhang's own data are such files: one with the board's points (any unit), one per view with their pixels.

use crate::document::{self, Error};
use nalgebra::Vector2;
use std::path::Path;

/// Larger files hold no points of a board.
const MAX_BYTES: u64 = 16 << 20;

/// The points in `file`, in its order.
pub fn read_points(file: &Path) -> Result<Vec<Vector2<f64>>, Error> {
    let bytes = document::read_bytes(file, MAX_BYTES)?;
    let text = String::from_utf8_lossy(&bytes);
    let check = document::Check(file);
    let mut numbers = Vec::new();
    for (k, line) in text.lines().enumerate() {
        for word in line.split_ascii_whitespace() {
            let number = word.parse::<f64>().ok().filter(|v| v.is_finite());
            let short: String = word.chars().take(40).collect();
            check.that(
                number.is_some(),
                format!("line {}", k + 1),
                format!("{short:?}"),
                "numbers, x and y in turn",
            )?;
            numbers.extend(number);
        }
    }
    let even = numbers.len() % 2 == 0 && numbers.len() >= 8;
    check.that(even, "count of numbers", numbers.len(), "an even count, x and y in turn, of at least four points")?;
    Ok(numbers.chunks_exact(2).map(|c| Vector2::new(c[0], c[1])).collect())
}
