//! The stages where a step spends its time, as values.
//!
//! Whoever knows the processor better than the compiler of this crate may hand the chain the same
//! functions compiled again for wider vectors. They are inlined into their callers for that
//! purpose, and their bits do not depend on the vector's width: every sum has the shape written in
//! the source.

use crate::basis::{Basis, Rows};
use crate::lanes::Planes;
use crate::least_squares::{NormalEquations, add_normal_equations, cholesky};
use crate::likelihood::pixels::{self, Coverage, Known, Rasterized, Target};
use crate::mesh;
use crate::model::Triangles;
use crate::render::project;
use crate::render::rasterize::{self, Frame};
use crate::render::shade::Shader;
use crate::scene::View;
use core::fmt;

/// Four numbers of a vertex.
pub type Quad = [f32; 4];

/// Implementations of the stages. All of them compute the same.
pub struct Engine {
    /// What compiled it.
    pub name: &'static str,
    /// [`Basis::instance`].
    pub instance: fn(&Basis<'_>, &[f32], &mut [Quad]),
    /// [`Basis::transposed`].
    pub transposed: fn(&Basis<'_>, &[Quad], &mut [f32]),
    /// [`Basis::rows`].
    pub rows: Rows,
    /// [`mesh::vertex_normals`].
    pub normals: fn(Triangles<'_>, &[Quad], &mut [Quad]),
    /// [`project::project`].
    pub project: fn(&View, &[Quad], &mut [Quad]),
    /// [`rasterize::rasterize`].
    pub rasterize: fn(Triangles<'_>, &[Quad], &mut Frame<'_>),
    /// [`Coverage::of`].
    pub coverage: fn(&Frame<'_>, &Target<'_>) -> Coverage,
    /// [`pixels::interpolate`].
    pub interpolate: fn(&Rasterized<'_, '_>, Option<&mut [Planes]>, &mut [Planes]),
    /// [`pixels::residual`].
    pub residual: Residual,
    /// [`add_normal_equations`] and [`cholesky`].
    pub normal_equations: NormalEquations,
}

/// Type of [`pixels::residual`].
pub type Residual = fn(&Rasterized<'_, '_>, Known<'_>, &Shader, &Target<'_>, f64) -> Option<f64>;

impl Engine {
    /// As this crate is compiled.
    pub const PORTABLE: &'static Self = &PORTABLE;
}

/// A static, since what a constant names is compiled anew by whoever uses the constant: a shell that
/// wants to be small would make its fits slow.
static PORTABLE: Engine = Engine {
    name: "portable",
    instance: |basis, coefficients, vertices| basis.instance(coefficients, vertices),
    transposed: |basis, cost, coefficients| basis.transposed(cost, coefficients),
    rows: |basis, entries, costs, rows| basis.rows(entries, costs, rows),
    normals: mesh::vertex_normals,
    project: project::project,
    rasterize: rasterize::rasterize,
    coverage: Coverage::of,
    interpolate: pixels::interpolate,
    residual: pixels::residual,
    normal_equations: NormalEquations { add: add_normal_equations::<2>, solve: cholesky::<2> },
};

impl fmt::Debug for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}
