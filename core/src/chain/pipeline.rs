//! The stages of a rendering, kept: a move reruns only what it touches.

use super::refine::{self, Constraints, Sample, View};
use crate::basis::{field_len, padded};
use crate::light::{self, LitPoint, ModelLight};
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
    system: &'w mut [f32],
    width: usize,
    height: usize,
}

/// Words of memory the search moves need.
pub(crate) const fn search_words(shape_rank: usize, albedo_rank: usize) -> usize {
    refine::system_words(refine::unknowns(shape_rank, albedo_rank))
}

impl<'w> Pipeline<'w> {
    /// Takes the memory; `None` if there is too little.
    pub(super) fn carve(
        carver: &mut Carver<'w>,
        dimensions: &Dimensions,
        pixels: &[[u8; 3]],
    ) -> Option<Self> {
        let &Dimensions { vertices, width, height, shape_rank, albedo_rank, .. } = dimensions;
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
            system: carver.floats(search_words(shape_rank, albedo_rank))?,
            width,
            height,
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

    /// Gauss–Newton step of albedo and light of the current state, from random visible vertices;
    /// goes `fraction` of the way.
    pub(super) fn refine_albedo(
        &mut self,
        model: &Model<'_>,
        scene: &mut Scene,
        (points, fraction): (u32, f32),
        sd: f32,
        rng: &mut Rng,
    ) -> Option<()> {
        let how = (self.weight(points, sd), fraction);
        let (visible, system) = self.visible(scene);
        let samples = (0..points).filter_map(|_| visible.sample(rng));
        refine::albedo(&model.albedo, scene, samples, how, system)
    }

    /// Gauss–Newton step of shape and pose of the current state, from random visible vertices and
    /// the landmarks; goes `fraction` of the way.
    pub(super) fn refine_shape(
        &mut self,
        model: &Model<'_>,
        scene: &mut Scene,
        (points, fraction): (u32, f32),
        sd: f32,
        constraints: &Constraints<'_>,
        rng: &mut Rng,
    ) -> Option<()> {
        let how = (self.weight(points, sd), fraction);
        let (visible, system) = self.visible(scene);
        let positions = visible.positions;
        let samples = (0..points).filter_map(|_| visible.sample(rng));
        let position = |v: usize| positions.map(|plane| plane[v]);
        refine::shape(&model.shape, scene, position, samples, how, constraints, system)
    }

    /// Inverse variance of a sampled vertex's colour: the samples stand for all covered pixels.
    fn weight(&self, points: u32, sd: f32) -> f32 {
        let share = self.fragments.get().len() as f32 / points.max(1) as f32;
        share.max(1.0) / (sd * sd)
    }

    /// The current state's surface, and the memory of the search moves.
    fn visible(&mut self, scene: &Scene) -> (Visible<'_, 'w>, &mut [f32]) {
        let visible = Visible {
            fragments: self.fragments.get(),
            positions: planes(self.positions.get()),
            normals: planes(self.normals.get()),
            shaded: self.shaded.get(),
            target: &self.target,
            width: self.width,
            height: self.height,
            view: View::new(scene),
            light: ModelLight::new(&scene.light, &scene.pose.rotation()),
            rotation: scene.pose.rotation(),
            albedo: planes(self.albedo.get()),
        };
        (visible, self.system)
    }
}

/// What the search moves see of the current state.
struct Visible<'s, 'w> {
    fragments: &'s Fragments<'w>,
    positions: [&'s [f32]; 3],
    normals: [&'s [f32]; 3],
    shaded: &'s [[f32; 4]],
    target: &'s Target<'w>,
    width: usize,
    height: usize,
    view: View,
    light: ModelLight,
    rotation: [[f32; 3]; 3],
    albedo: [&'s [f32]; 3],
}

impl Visible<'_, '_> {
    /// A corner of a random visible fragment, the one nearest to it, compared with the picture.
    fn sample(&self, rng: &mut Rng) -> Option<Sample> {
        let fragment = self.fragments.get(rng.below(self.fragments.len() as u32) as usize)?;
        let [w1, w2] = fragment.weights;
        let w0 = 1.0 - w1 - w2;
        let corner = if w0 >= w1 && w0 >= w2 { 0 } else { 1 + usize::from(w2 > w1) };
        let vertex = fragment.corners[corner] as usize;
        let [u, v] = self.view.window(self.positions.map(|plane| plane[vertex]));
        let (color, gradient) = self.picture(u, v)?;
        let [r, g, b, _] = self.shaded[vertex];
        let n = self.normals.map(|plane| plane[vertex]);
        let world = self.rotation.map(|r| r[0] * n[0] + r[1] * n[1] + r[2] * n[2]);
        Some(Sample {
            vertex,
            residual: [color[0] - r, color[1] - g, color[2] - b],
            gradient,
            albedo: self.albedo.map(|plane| plane[vertex]),
            radiance: self.light.radiance(n),
            harmonics: light::basis(world),
        })
    }

    /// Colour of the picture between pixels, and its central differences over two pixels.
    fn picture(&self, u: f32, v: f32) -> Option<([f32; 3], [[f32; 3]; 2])> {
        let (x, y) = (math::floor(u), math::floor(v));
        let (fx, fy) = (u - x as f32, v - y as f32);
        let (x, y) = (usize::try_from(x).ok()?, usize::try_from(y).ok()?);
        if x < 1 || y < 1 || x + 2 >= self.width || y + 2 >= self.height {
            return None;
        }
        let colors = self.target.colors();
        let at = |x: usize, y: usize| {
            let [a, b] = [0, 1].map(|j| {
                let row = (y + j) * self.width + x;
                let (l, r) = (colors[row], colors[row + 1]);
                [0, 1, 2].map(|c| l[c] + fx * (r[c] - l[c]))
            });
            [0, 1, 2].map(|c| a[c] + fy * (b[c] - a[c]))
        };
        let half = |a: [f32; 3], b: [f32; 3]| [0, 1, 2].map(|c| 0.5 * (a[c] - b[c]));
        let gradient = [half(at(x + 1, y), at(x - 1, y)), half(at(x, y + 1), at(x, y - 1))];
        Some((at(x, y), gradient))
    }
}
