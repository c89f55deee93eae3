//! The core's stages compiled for wider vectors than every processor has, and the choice between
//! them at run time. The bits are the same whatever is chosen.

use onescan_core::engine::Engine;
use onescan_core::render::LANES;
use std::hint::black_box;

/// Compiles every stage for the given target features.
#[cfg(target_arch = "x86_64")]
macro_rules! engine {
    ($module:ident, $features:literal) => {
        mod $module {
            use onescan_core::basis::{Basis, ByVertex, Costs};
            use onescan_core::engine::Engine;
            use onescan_core::least_squares::{self, NormalEquations, add_normal_equations};
            use onescan_core::likelihood::pixels::{self, Coverage, Known, Rasterized, Target};
            use onescan_core::mesh;
            use onescan_core::model::Triangles;
            use onescan_core::render::LANES;
            use onescan_core::render::project;
            use onescan_core::render::rasterize::{self, Frame};
            use onescan_core::render::shade::{Planes, Shader};
            use onescan_core::scene::View;

            /// Only for processors that have the features.
            pub(super) static ENGINE: Engine = Engine {
                name: $features,
                // SAFETY, for all: `best` hands this engine out only where it has detected the
                // features.
                instance: |basis, coefficients, vertices| unsafe {
                    instance(basis, coefficients, vertices);
                },
                transposed: |basis, cost, coefficients| unsafe {
                    transposed(basis, cost, coefficients);
                },
                rows: |basis, entries, costs, out| unsafe { rows(basis, entries, costs, out) },
                normals: |triangles, positions, normals| unsafe {
                    vertex_normals(triangles, positions, normals);
                },
                project: |view, positions, window| unsafe { project(view, positions, window) },
                rasterize: |triangles, window, frame| unsafe {
                    rasterize(triangles, window, frame);
                },
                coverage: |frame, target| unsafe { coverage(frame, target) },
                interpolate: |rasterized, normals, albedo| unsafe {
                    interpolate(rasterized, normals, albedo);
                },
                residual: |rasterized, known, shader, target, limit| unsafe {
                    residual(rasterized, known, shader, target, limit)
                },
                normal_equations: NormalEquations {
                    add: |batch, equations, matrix, vector| unsafe {
                        normal_equations(batch, equations, matrix, vector);
                    },
                    solve: |matrix, vector, scratch| unsafe { cholesky(matrix, vector, scratch) },
                },
            };

            /// [`super::arithmetic`].
            #[target_feature(enable = $features)]
            pub(super) fn arithmetic(passes: u32) -> f32 {
                super::multiply_and_add(passes)
            }

            #[target_feature(enable = $features)]
            fn instance(basis: &Basis<'_>, coefficients: &[f32], vertices: &mut [[f32; 4]]) {
                basis.instance(coefficients, vertices);
            }

            #[target_feature(enable = $features)]
            fn transposed(basis: &Basis<'_>, cost: &[[f32; 4]], coefficients: &mut [f32]) {
                basis.transposed(cost, coefficients);
            }

            #[target_feature(enable = $features)]
            fn rows(
                basis: &Basis<'_>,
                entries: Option<&ByVertex<'_>>,
                costs: &[Costs],
                rows: [&mut [f32]; 3],
            ) {
                basis.rows(entries, costs, rows);
            }

            #[target_feature(enable = $features)]
            fn vertex_normals(
                triangles: Triangles<'_>,
                positions: &[[f32; 4]],
                normals: &mut [[f32; 4]],
            ) {
                mesh::vertex_normals(triangles, positions, normals);
            }

            #[target_feature(enable = $features)]
            fn project(view: &View, positions: &[[f32; 4]], window: &mut [[f32; 4]]) {
                project::project(view, positions, window);
            }

            #[target_feature(enable = $features)]
            fn rasterize(triangles: Triangles<'_>, window: &[[f32; 4]], frame: &mut Frame<'_>) {
                rasterize::rasterize(triangles, window, frame);
            }

            #[target_feature(enable = $features)]
            fn coverage(frame: &Frame<'_>, target: &Target<'_>) -> Coverage {
                Coverage::of(frame, target)
            }

            #[target_feature(enable = $features)]
            fn interpolate(
                rasterized: &Rasterized<'_, '_>,
                normals: Option<&mut [Planes]>,
                albedo: &mut [Planes],
            ) {
                pixels::interpolate(rasterized, normals, albedo);
            }

            #[target_feature(enable = $features)]
            fn residual(
                rasterized: &Rasterized<'_, '_>,
                known: Known<'_>,
                shader: &Shader,
                target: &Target<'_>,
                limit: f64,
            ) -> Option<f64> {
                pixels::residual(rasterized, known, shader, target, limit)
            }

            #[target_feature(enable = $features)]
            fn normal_equations(
                batch: &[[f32; LANES]],
                equations: &[(f32, f32)],
                matrix: &mut [[f32; LANES]],
                vector: &mut [f32],
            ) {
                add_normal_equations::<4>(batch, equations, matrix, vector);
            }

            #[target_feature(enable = $features)]
            fn cholesky(
                matrix: &mut [[f32; LANES]],
                vector: &mut [f32],
                scratch: &mut [[f32; LANES]],
            ) -> Option<()> {
                least_squares::cholesky::<4>(matrix, vector, scratch)
            }
        }
    };
}

#[cfg(target_arch = "x86_64")]
engine!(avx2, "avx2");

/// The fastest engine for this processor.
pub fn best() -> &'static Engine {
    all().last().copied().unwrap_or(Engine::PORTABLE)
}

/// The engines this processor can run, the fastest last.
pub fn all() -> Vec<&'static Engine> {
    #[allow(unused_mut)]
    let mut engines = vec![Engine::PORTABLE];
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::is_x86_feature_detected as has;
        if has!("avx2") {
            engines.push(&avx2::ENGINE);
        }
    }
    engines
}

/// Operations in a pass of [`arithmetic`].
pub const OPERATIONS: usize = 2 * 6 * LANES;

/// Multiplies and adds in registers, in equal numbers, [`OPERATIONS`] times a pass: the most that this
/// processor's vectors can do without fused operations, which have other bits. The result means nothing.
pub fn arithmetic(passes: u32) -> f32 {
    #[cfg(target_arch = "x86_64")]
    if std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: the feature has just been detected.
        return unsafe { avx2::arithmetic(passes) };
    }
    multiply_and_add(passes)
}

#[inline(always)]
fn multiply_and_add(passes: u32) -> f32 {
    let [factor, term] = black_box([0.5_f32; 2]);
    let mut numbers = [[1.0_f32; LANES]; 6];
    for _ in 0..passes {
        for number in numbers.as_flattened_mut() {
            *number = *number * factor + term;
        }
    }
    numbers.as_flattened().iter().sum()
}
