//! Registration: a model deformed onto a scan of any topology, so that vertices correspond.
//!
//! A vertex of the model is at `p = R x + t` in the scan's place, `x = e^σ (mean + Σ aₖ φₖ)`. What is
//! sought are shape `a`, size `σ` and pose `R`, `t`, and on the way the scan's albedo. Every vertex looks
//! for its foot, the nearest point of the scan (`nearest.rs`), and says by it (`evidence.rs`) that it
//! ought to lie on the scan's surface, and to have the scan's colour there. The first leaves it free to
//! slide along the surface, which is where nearly all error of registrations lies; the second holds it
//! where colours change: eyes, brows, lips. Pixels of renderings of scan and model from all sides would say
//! the same, but for light and shadow. Colours are blurred, from coarse to fine ([`LEVELS`]).
//!
//! A foot near a border of the scan, or where the surface looks elsewhere, says nothing; a far one says
//! little. Neighbours err together, so that many equations count as one ([`Options::patch`]).
//!
//! The pose is found by three or more landmarks, if they are given; otherwise the mean is moved rigidly onto
//! the scan from several directions, and the one that comes nearest wins. Nothing is random.

mod evidence;
mod nearest;
mod options;
mod paint;
mod place;
mod scan;
mod start;
mod state;
mod uncertainty;

use evidence::Look;
pub use options::{LEVELS, Level, Options};
pub use place::Place;
pub use scan::{RegisterError, Scan};
use start::STARTS;
pub use state::{Problem, Registration, words};

/// What an iteration came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Iteration {
    /// Index in [`LEVELS`]; `None` while the pose is sought.
    pub level: Option<usize>,
    /// Share of the vertices that were looked at whose foot is evidence.
    pub matched: f32,
    /// Distance of those to the scan before the step, root mean square along normals, mm.
    pub distance: f32,
}

impl Registration<'_, '_> {
    /// Iterations of a whole registration: those of every start, of what follows the nearest start, and of
    /// the levels.
    pub const ITERATIONS: u32 = {
        let mut sum = STARTS as u32 + 1;
        let mut level = 0;
        while level < LEVELS.len() {
            sum += LEVELS[level].iterations;
            level += 1;
        }
        sum
    };

    /// One iteration; `None` when all are done.
    pub fn step(&mut self) -> Option<Iteration> {
        let number = self.done;
        self.done += 1;
        let starts = STARTS as u32;
        if number <= starts {
            let start = number < starts;
            let [matched, distance] =
                if start { self.try_start(number as usize) } else { self.settle() };
            return Some(Iteration { level: None, matched, distance });
        }
        let mut left = number - starts - 1;
        for (i, level) in LEVELS.iter().enumerate() {
            if left < level.iterations {
                let [matched, distance] = self.refine(level, left == 0);
                return Some(Iteration { level: Some(i), matched, distance });
            }
            left -= level.iterations;
        }
        self.done = number;
        None
    }

    /// An iteration at a level, its first or another.
    fn refine(&mut self, level: &Level, first: bool) -> [f32; 2] {
        let colors = self.problem.options.albedo;
        if colors && first {
            self.enter(level);
        }
        let result = self.iterate(&Look {
            components: level.components,
            size: true,
            trust: level.trust,
            stride: 1,
            colors,
        });
        if colors {
            self.find_albedo();
            self.paint(level.blur);
        }
        result
    }
}
