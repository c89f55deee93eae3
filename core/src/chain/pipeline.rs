//! The stages of a rendering, kept: a move reruns only what it touches.

use super::dimensions::Dimensions;
use super::problem::Problem;
use crate::basis::padded;
use crate::lanes::Planes;
use crate::light::{self, Light, LitPoint};
use crate::likelihood::pixels::{Coverage, Known, Rasterized, Target};
use crate::math;
use crate::memory::{Carver, Slots};
use crate::model::Triangles;
use crate::proposal::Touched;
use crate::render::rasterize::{Frame, Hit};
use crate::render::shade::{self, Attributes, Shader};
use crate::rng::Rng;
use crate::scene::Scene;

type Quads<'w> = Slots<&'w mut [[f32; 4]]>;

/// Attributes per pixel.
struct Pixels<'w> {
    normals: &'w mut [Planes],
    albedo: &'w mut [Planes],
}

/// What of the current state's attributes per pixel is out of date.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stale {
    Nothing,
    Albedo,
    Everything,
}

/// A hypothesis on its way to be the next state.
pub(super) struct Proposed<'s, 'a> {
    pub(super) problem: Problem<'a>,
    pub(super) scene: &'s Scene,
    /// What of it differs from the current state.
    pub(super) touched: Touched,
}

/// Buffers of every stage, the current state's and the proposal's.
pub(super) struct Pipeline<'w> {
    target: Target<'w>,
    /// Per vertex.
    positions: Quads<'w>,
    attributes: Slots<&'w mut [Attributes]>,
    /// Also where normals and albedo are made.
    window: &'w mut [[f32; 4]],
    /// Per pixel.
    frame: Slots<Frame<'w>>,
    coverage: Slots<Coverage>,
    /// Of the current state only, and brought up to date when a move of light or colour wants
    /// them: most other moves are rejected.
    pixels: Option<Pixels<'w>>,
    stale: Stale,
    /// What of the buffers, having one slot only, no longer is the current state's.
    overwritten: Touched,
}

impl<'w> Pipeline<'w> {
    /// Takes the memory; `None` if there is too little.
    pub(super) fn carve(
        carver: &mut Carver<'w>,
        dimensions: &Dimensions,
        pixels: &[[u8; 3]],
    ) -> Option<Self> {
        let &Dimensions { vertices, width, height, lean, .. } = dimensions;
        // First: while it is made, the target borrows memory the rest will have.
        let target = Target::carve(carver, pixels, width)?;
        let n = padded(vertices);
        let positions = slots(lean, || carver.quads(n))?;
        let attributes = slots(lean, || carver.groups(n))?;
        let frame = slots(lean, || Frame::carve(carver, width, height))?;
        let pixels = if lean {
            None
        } else {
            let mut planes = || carver.planes(width, height);
            Some(Pixels { normals: planes()?, albedo: planes()? })
        };
        Some(Self {
            target,
            positions,
            attributes,
            frame,
            coverage: slots(lean, || Some(Coverage::default()))?,
            pixels,
            stale: Stale::Everything,
            overwritten: Touched::COLOR,
            window: carver.quads(n)?,
        })
    }

    /// Makes those stages of the current state again that a proposal has overwritten, except what
    /// another proposal is about to overwrite anyway.
    pub(super) fn restore(&mut self, problem: Problem<'_>, current: &Scene, except: Touched) {
        let missing = self.overwritten.without(except);
        if missing != Touched::COLOR {
            self.update(&Proposed { problem, scene: current, touched: missing });
            self.overwritten = self.overwritten.without(missing);
        }
    }

    /// Computes what a proposal invalidates of the stages before shading, in the spare buffers.
    pub(super) fn update(&mut self, new: &Proposed<'_, '_>) {
        let &Proposed { problem: Problem { model, engine, lean, .. }, scene, touched } = new;
        if lean {
            self.overwritten = self.overwritten.with(touched);
        }
        if touched.shape {
            (engine.instance)(&model.shape, &scene.subject.shape, self.positions.spare());
            let positions = self.positions.pick(true);
            (engine.normals)(model.triangles, positions, self.window);
            match self.attributes.both() {
                (Some(current), spare) => {
                    let albedo = current.iter().copied().map(shade::albedo_of);
                    shade::join(self.window.iter().copied(), albedo, spare);
                }
                (None, only) => shade::set_normals(self.window, only),
            }
        }
        if touched.albedo {
            (engine.instance)(&model.albedo, &scene.subject.albedo, self.window);
            match self.attributes.both() {
                (Some(current), spare) if !touched.shape => {
                    let normals = current.iter().copied().map(shade::normal_of);
                    shade::join(normals, self.window.iter().copied(), spare);
                }
                (_, spare) => shade::set_albedo(self.window, spare),
            }
        }
        if touched.geometry {
            (engine.project)(&scene.view, self.positions.pick(touched.shape), self.window);
            (engine.rasterize)(model.triangles, self.window, self.frame.spare());
            *self.coverage.spare() = (engine.coverage)(self.frame.pick(true), &self.target);
        }
    }

    /// Image likelihood of what [`Pipeline::update`] computed; `None` if below `floor`.
    pub(super) fn ln_likelihood(&mut self, new: &Proposed<'_, '_>, floor: f64) -> Option<f64> {
        let sd = new.problem.config.pixel_sd;
        let coverage = *self.coverage.pick(new.touched.geometry);
        let residual = self.residual(new, coverage.limit(floor, sd))?;
        Some(coverage.ln_likelihood(residual, sd))
    }

    /// Squared colour differences of what [`Pipeline::update`] computed; `None` if above `limit`.
    fn residual(&mut self, new: &Proposed<'_, '_>, limit: f64) -> Option<f64> {
        let &Proposed { problem: Problem { model, engine, .. }, scene, touched } = new;
        let rasterized = Rasterized {
            frame: self.frame.pick(touched.geometry),
            triangles: model.triangles,
            vertices: self.attributes.pick(touched.shape || touched.albedo),
        };
        let mut known = Known::default();
        if let Some(pixels) = &mut self.pixels {
            if touched == Touched::COLOR {
                if self.stale > Stale::Nothing {
                    let normals = (self.stale == Stale::Everything).then_some(&mut *pixels.normals);
                    (engine.interpolate)(&rasterized, normals, pixels.albedo);
                    self.stale = Stale::Nothing;
                }
                known.albedo = Some(pixels.albedo);
            }
            if !touched.geometry && self.stale < Stale::Everything {
                known.normals = Some(pixels.normals);
            }
        }
        (engine.residual)(&rasterized, known, &Shader::new(&scene.view), &self.target, limit)
    }

    /// Number of covered pixels and pixel error of what [`Pipeline::update`] computed.
    pub(super) fn rmse(&mut self, new: &Proposed<'_, '_>) -> (usize, f64) {
        let residual = self.residual(new, f64::INFINITY).unwrap_or(0.0);
        let coverage = self.coverage.pick(new.touched.geometry);
        (coverage.pixels, coverage.rmse(residual))
    }

    /// Makes what was computed for a proposal the current state's.
    pub(super) fn accept(&mut self, touched: Touched) {
        self.overwritten = self.overwritten.without(touched);
        if touched.shape {
            self.positions.flip();
        }
        if touched.shape || touched.albedo {
            self.attributes.flip();
        }
        if touched.geometry {
            self.frame.flip();
            self.coverage.flip();
            self.stale = Stale::Everything;
        }
        if touched.albedo {
            self.stale = self.stale.max(Stale::Albedo);
        }
    }

    /// Closed-form light from randomly chosen visible pixels of the current state.
    pub(super) fn solve_light(
        &self,
        triangles: Triangles<'_>,
        scene: &Scene,
        points: u32,
        rng: &mut Rng,
    ) -> Option<Light> {
        let rotation = scene.view.pose.rotation();
        let vertices = self.attributes.get();
        let chosen = (0..points).filter_map(|_| {
            let ([x, y], hit) = self.visible_pixel(rng)?;
            let [v, w] = hit.weights;
            let [p, q, r] = triangles.get(hit.triangle)?.map(|i| vertices.get(i as usize));
            let (p, q, r) = (p?, q?, r?);
            let mut at = Attributes::default();
            for i in 0..at.len() {
                at[i] = (1.0 - v - w) * p[i] + v * q[i] + w * r[i];
            }
            let n = xyz(shade::normal_of(at));
            let k = math::rsqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            let normal = rotation.map(|r| k * (r[0] * n[0] + r[1] * n[1] + r[2] * n[2]));
            let albedo = xyz(shade::albedo_of(at));
            Some(LitPoint { albedo, normal, target: self.target.color(x, y) })
        });
        light::solve(chosen, &scene.view.color)
    }

    /// A random pixel of the box around what the current state shows; `None` where it shows
    /// nothing.
    fn visible_pixel(&self, rng: &mut Rng) -> Option<([usize; 2], Hit)> {
        let frame = self.frame.get();
        let [x, y] = [frame.columns(), frame.rows()]
            .map(|range| range.start + rng.below(range.len() as u32) as usize);
        Some(([x, y], frame.hit(x, y)?))
    }
}

/// One buffer or two.
fn slots<T>(lean: bool, mut buffer: impl FnMut() -> Option<T>) -> Option<Slots<T>> {
    Some(Slots::new(buffer()?, if lean { None } else { Some(buffer()?) }))
}

fn xyz([x, y, z, _]: [f32; 4]) -> [f32; 3] {
    [x, y, z]
}
