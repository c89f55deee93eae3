//! The stages of a rendering, kept: a move reruns only what it touches.

use crate::basis::{field_len, padded};
use crate::light::{self, LitPoint};
use crate::likelihood::pixels::{Fragments, Target};
use crate::math;
use crate::mesh::{self, planes};
use crate::model::Model;
use crate::proposal::Touched;
use crate::render::rasterize::{self, Frame};
use crate::render::{project, shade};
use crate::rng::Rng;
use crate::scene::{Light, Scene};
use crate::workspace::{Carver, Dimensions, Slots};

type Field<'w> = Slots<&'w mut [f32]>;
type Quads<'w> = Slots<&'w mut [[f32; 4]]>;

/// Buffers of every stage, the current state's and the proposal's.
pub(super) struct Pipeline<'w> {
    target: Target<'w>,
    positions: Field<'w>,
    normals: Field<'w>,
    albedo: Field<'w>,
    window: Quads<'w>,
    shaded: Quads<'w>,
    fragments: Slots<Fragments<'w>>,
    frame: Frame<'w>,
    normal_sums: &'w mut [[f32; 4]],
}

impl<'w> Pipeline<'w> {
    /// Takes the memory; `None` if there is too little.
    pub(super) fn carve(
        carver: &mut Carver<'w>,
        dimensions: &Dimensions,
        pixels: &[[u8; 3]],
    ) -> Option<Self> {
        let &Dimensions { vertices, width, height, .. } = dimensions;
        // First: while it is made, the target borrows memory the rest will have.
        let target = Target::carve(carver, pixels)?;
        let mut field = || {
            let n = field_len(vertices);
            Some(Slots::new(carver.floats(n)?, carver.floats(n)?))
        };
        let (positions, normals, albedo) = (field()?, field()?, field()?);
        let mut quads = || {
            let n = padded(vertices);
            Some(Slots::new(carver.quads(n)?, carver.quads(n)?))
        };
        let (window, shaded) = (quads()?, quads()?);
        let mut fragments = || Fragments::carve(carver, width, height);
        let fragments = Slots::new(fragments()?, fragments()?);
        Some(Self {
            target,
            positions,
            normals,
            albedo,
            window,
            shaded,
            fragments,
            frame: Frame::carve(carver, width, height)?,
            normal_sums: carver.quads(mesh::sums_len(vertices))?,
        })
    }

    /// Computes the stages that `touched` invalidates for `scene`, in the spare buffers.
    pub(super) fn update(&mut self, model: &Model<'_>, scene: &Scene, touched: Touched, sd: f32) {
        if touched.shape {
            model.shape.instance(&scene.shape, self.positions.spare());
            let positions = self.positions.pick(true);
            mesh::vertex_normals(model, positions, self.normal_sums, self.normals.spare());
        }
        if touched.albedo {
            model.albedo.instance(&scene.albedo, self.albedo.spare());
        }
        if touched.geometry {
            project::project(scene, self.positions.pick(touched.shape), self.window.spare());
            rasterize::rasterize(model.triangles, self.window.pick(true), &mut self.frame);
            self.fragments.spare().collect(&self.frame, model.triangles, &self.target, sd);
        }
        let normals = self.normals.pick(touched.shape);
        let albedo = self.albedo.pick(touched.albedo);
        shade::shade(scene, normals, albedo, self.shaded.spare());
    }

    /// Image likelihood of what [`Pipeline::update`] computed; `None` if below `floor`.
    pub(super) fn ln_likelihood(&self, touched: Touched, sd: f32, floor: f64) -> Option<f64> {
        let fragments = self.fragments.pick(touched.geometry);
        fragments.ln_likelihood(self.shaded.pick(true), &self.target, sd, floor)
    }

    /// Number of covered pixels and pixel error of what was computed for a whole scene.
    pub(super) fn rmse_of_proposal(&self) -> (usize, f64) {
        let fragments = self.fragments.pick(true);
        (fragments.len(), fragments.rmse(self.shaded.pick(true), &self.target))
    }

    /// Makes what [`Pipeline::update`] computed the current state's.
    pub(super) fn accept(&mut self, touched: Touched) {
        if touched.shape {
            self.positions.flip();
            self.normals.flip();
        }
        if touched.albedo {
            self.albedo.flip();
        }
        if touched.geometry {
            self.window.flip();
            self.fragments.flip();
        }
        self.shaded.flip();
    }

    /// Closed-form light from randomly chosen visible pixels of the current state.
    pub(super) fn solve_light(&self, scene: &Scene, points: u32, rng: &mut Rng) -> Option<Light> {
        let fragments = self.fragments.get();
        let rotation = scene.pose.rotation();
        let normals = planes(self.normals.get());
        let albedo = planes(self.albedo.get());
        let chosen = (0..points).filter_map(|_| {
            let fragment = fragments.get(rng.below(fragments.len() as u32) as usize)?;
            let [w1, w2] = fragment.weights;
            let weights = [1.0 - w1 - w2, w1, w2];
            let blend = |planes: &[&[f32]; 3]| {
                planes.map(|plane| {
                    let mut sum = 0.0;
                    for (weight, corner) in weights.iter().zip(fragment.corners) {
                        sum += weight * plane[corner as usize];
                    }
                    sum
                })
            };
            let n = blend(&normals);
            let k = math::rsqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            let normal = rotation.map(|r| (r[0] * n[0] + r[1] * n[1] + r[2] * n[2]) * k);
            let [r, g, b, _] = self.target.colors()[fragment.pixel as usize];
            Some(LitPoint { albedo: blend(&albedo), normal, target: [r, g, b] })
        });
        light::solve(chosen, &scene.color)
    }
}
