//! Camera and projector from captures of a board. In: the board as each of them shows it. Out: the solved rig.
//! Not here: files; what a solution is worth.

use super::target::Sighting;
use super::{Board, Lit, Solution, Terms, Unsolved, View, solve};
use crate::optics::Lens;

/// A board in one capture.
#[derive(Clone, Debug)]
pub struct Shown {
    /// For messages and reports.
    pub name: String,
    /// What the camera sees of it.
    pub sighting: Sighting,
    /// The fringes on it.
    pub lit: Lit,
}

/// Solves camera and projector, whose images have `sizes` (columns, rows; px). Twice: centres of discs, and what fringes are
/// fitted by, are better once the camera's lens is known. Errors as [`solve`].
pub fn solve_shown(board: &Board, shown: &[Shown], sizes: [(usize, usize); 2]) -> Result<Solution, Unsolved> {
    let [(width, height), _] = sizes;
    let solved = |lens: &Lens| {
        let view = |s: &Shown| {
            let camera = s.sighting.through(board, lens).seen();
            let projector = s.lit.projector(&camera, lens);
            View { name: s.name.clone(), seen: [camera, projector] }
        };
        let views: Vec<View> = shown.iter().map(view).collect();
        solve(&board.points(), &views, sizes.map(Some), Terms::Chosen)
    };
    let coarse = solved(&Lens::pinhole(width, height))?;
    solved(&coarse.devices[0].lens)
}
