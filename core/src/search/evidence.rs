//! What one photo says of the subject, by its landmarks and its pixels, and the view it has of it.
//!
//! Photos share nothing but the subject, so what they say adds up. Each gives its part of
//! the energy ([`Evidence::judge`], which also renews its mask), of the derivative
//! (`add_gradient`), and of the Gauss–Newton matrix (`add_equations`).

use super::common::{Common, Energy, Options, Scratch};
use super::instance::at;
use super::landmarks;
use super::occlusion;
use super::picture;
use super::unknowns::{LIGHT, Layout, POSE, VIEW};
use crate::basis::padded;
use crate::chain::{ChainError, Dimensions, Photo, Problem};
use crate::engine::Quad;
use crate::least_squares::{Equations, System, system_words};
use crate::likelihood::landmarks::{Landmarks, rows_words};
use crate::math;
use crate::memory::Carver;
use crate::render::rasterize::{Frame, frame_words};
use crate::scene::View;
use crate::vector::Vec3;
use core::f32::consts::{FRAC_PI_2, PI};

/// Iterations on the landmarks alone, for the pose, at most. Chosen, not measured.
const POSE_ITERATIONS: u32 = 40;
/// Rolls to begin with, radians.
const WAYS_UP: [f32; 4] = [0.0, FRAC_PI_2, PI, -FRAC_PI_2];

/// Words of memory an [`Evidence`] needs.
///
/// Per pixel what is visible (4), photo and rendering (3 each), the background's density, mask and
/// weight; per vertex window coordinates (4), and whether it is likely to be hidden; the landmarks'
/// rows of the basis.
pub(super) const fn evidence_words(d: &Dimensions) -> usize {
    9 * d.width * d.height
        + frame_words(d.width, d.height)
        + 4 * padded(d.vertices)
        + d.vertices.div_ceil(4)
        + rows_words(d.landmarks, d.shape_rank)
}

/// Planes of a picture, a number per pixel.
pub(super) struct Planes<'w> {
    /// The photo at this level.
    pub(super) photo: [&'w mut [f32]; 3],
    /// The rendering; NaN where nothing is covered.
    pub(super) rendering: [&'w mut [f32]; 3],
    pub(super) ln_background: &'w mut [f32],
    /// Probability that a covered pixel shows the face; 0 where nothing is covered.
    pub(super) mask: &'w mut [f32],
    /// What a pixel's squared difference counts, in units of [`Common::pixel_weight`].
    pub(super) weights: &'w mut [f32],
}

/// What one photo says of the subject, and the view that it is found to have.
pub struct Evidence<'a, 'w> {
    pub(super) photo: Photo<'a>,
    /// Number of the view among the unknowns.
    pub(super) number: usize,
    pub(super) view: View,
    /// To go back to.
    before: View,
    /// What the search for the pose by landmarks came to.
    initial: View,
    /// By vertex, how likely it is to be hidden before the photo is seen, see [`occlusion::fill`].
    pub(super) hidden: &'w mut [u8],
    pub(super) landmarks: Landmarks<'w>,
    pub(super) planes: Planes<'w>,
    pub(super) frame: Frame<'w>,
    /// The subject's window coordinates and inverse distance.
    pub(super) window: &'w mut [Quad],
    /// Covered pixels, and the sum of the mask.
    pub(super) seen: (usize, f32),
    /// What the pixels that the face covers by the landmarks alone have to say.
    pub(super) expected: f32,
}

impl<'a, 'w> Evidence<'a, 'w> {
    /// Takes the memory; `Ok(None)` if there is too little.
    pub(super) fn carve(
        carver: &mut Carver<'w>,
        problem: &Problem<'a>,
        options: &Options<'a>,
        photo: &Photo<'a>,
        number: usize,
    ) -> Result<Option<Self>, ChainError> {
        let observed = photo.check(problem.model)?;
        Ok(Self::carve_checked(carver, problem, options, photo, number, &observed))
    }

    #[inline(never)]
    fn carve_checked(
        carver: &mut Carver<'w>,
        problem: &Problem<'a>,
        options: &Options<'a>,
        photo: &Photo<'a>,
        number: usize,
        observed: &[(u32, [f32; 2])],
    ) -> Option<Self> {
        let Problem { model, config, .. } = *problem;
        let d = photo.dimensions(&problem.dimensions());
        let pixels = d.width * d.height;
        let mut plane = || carver.floats(pixels);
        let planes = Planes {
            photo: [plane()?, plane()?, plane()?],
            rendering: [plane()?, plane()?, plane()?],
            ln_background: plane()?,
            mask: plane()?,
            weights: plane()?,
        };
        let frame = Frame::carve(carver, d.width, d.height)?;
        let window = carver.quads(padded(d.vertices))?;
        let sd = config.landmark_sd;
        let landmarks = Landmarks::gather(carver, model, observed, d.shape_rank, sd)?;
        let hidden = carver.bytes(d.vertices.div_ceil(4))?;
        hidden.fill(occlusion::NEVER);
        if options.occlusion {
            occlusion::fill(model, hidden);
        }
        let view = View::initial(photo.image.width, photo.image.height);
        Some(Self {
            photo: *photo,
            number,
            view,
            before: view,
            initial: view,
            hidden,
            landmarks,
            planes,
            frame,
            window,
            seen: (0, 0.0),
            expected: 0.0,
        })
    }

    /// The view so far.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// The view by the landmarks alone, the subject being the mean.
    pub fn initial(&self) -> &View {
        &self.initial
    }

    /// Probability of every pixel to show the face, row by row; 0 where the face does not reach.
    pub fn mask(&self) -> &[f32] {
        self.planes.mask
    }

    /// Root mean square difference per channel between photo and rendering, `[0, 1]`, over the pixels that
    /// the model covers, each weighted by its mask.
    pub fn seen_rmse(&self) -> f64 {
        let Planes { photo, rendering, mask, .. } = &self.planes;
        let (mut sum, mut seen) = (0.0, 0.0);
        for (photo, rendering) in photo.iter().zip(rendering) {
            for ((p, r), m) in photo.iter().zip(&**rendering).zip(&**mask) {
                if *m > 0.0 && !r.is_nan() {
                    sum += f64::from(m * (p - r) * (p - r));
                    seen += f64::from(*m);
                }
            }
        }
        math::sqrt_f64(sum / f64::max(seen, f64::MIN_POSITIVE))
    }

    /// Columns and rows of the photo.
    pub(super) fn size(&self) -> [usize; 2] {
        [self.width(), self.photo.image.height as usize]
    }

    /// Pixels of a row.
    pub(super) fn width(&self) -> usize {
        self.photo.image.width as usize
    }

    /// The photo at a pixel.
    #[inline(always)]
    pub(super) fn photo_at(&self, index: usize) -> Vec3 {
        let [r, g, b] = &self.planes.photo;
        [at(r, index), at(g, index), at(b, index)]
    }

    /// Goes a step, which can be taken back once.
    pub(super) fn advance(&mut self, layout: Layout, step: &mut [f32]) {
        self.before = self.view;
        if let Some(parts) = layout.split(step, self.number) {
            parts.advance_view(&mut self.view);
        }
    }

    /// Goes that step back.
    pub(super) fn retreat(&mut self) {
        self.view = self.before;
    }

    /// Pose and camera by the landmarks, the subject being the mean: upright, unless begun on a side
    /// or upside down they explain the landmarks better.
    #[inline(never)]
    pub(super) fn find_pose(&mut self, common: &mut Common<'_, '_>, passing: &mut [f32]) {
        // Nothing here pulls on light and colour.
        let sought = core::mem::replace(
            &mut common.layout,
            Layout { shape_rank: 0, albedo_rank: 0, views: 1 },
        );
        let number = core::mem::take(&mut self.number);
        let mut best: Option<(f64, View)> = None;
        for roll in WAYS_UP {
            let (energy, view) = self.find_pose_from(common, roll, passing);
            if best.as_ref().is_none_or(|(least, _)| energy < least - 1.0) {
                best = Some((energy, view));
            }
        }
        (common.layout, self.number) = (sought, number);
        if let Some((_, view)) = best {
            (self.view, self.initial) = (view, view);
        }
    }

    /// The same from a face turned by `roll`, and its energy.
    fn find_pose_from(
        &mut self,
        common: &Common<'_, '_>,
        roll: f32,
        passing: &mut [f32],
    ) -> (f64, View) {
        let image = self.photo.image;
        self.view = View::initial(image.width, image.height);
        self.view.pose.roll = roll;
        let energy = |evidence: &Self| {
            evidence.landmark_energy(common) + common.priors().energy_of_view(&evidence.view)
        };
        let mut damping = 1e-3;
        for _ in 0..POSE_ITERATIONS {
            let before = energy(self);
            if self.find_pose_step(common, damping, passing).is_none() {
                self.before = self.view;
            }
            if energy(self) < before {
                damping *= 0.2;
            } else {
                self.retreat();
                damping *= 5.0;
            }
        }
        (energy(self), self.view)
    }

    /// Goes a step of pose and camera alone.
    fn find_pose_step(
        &mut self,
        common: &Common<'_, '_>,
        lambda: f32,
        passing: &mut [f32],
    ) -> Option<()> {
        let (equations, matrix) = passing.split_at_mut_checked(system_words(VIEW))?;
        let mut step = [0.0; VIEW];
        let engine = common.problem.engine;
        let mut system = System::new(VIEW, engine.normal_equations, equations)?;
        self.add_landmarks_and_priors(common, &mut system);
        system.solve_damped(lambda, damping, matrix, &mut step)?;
        self.advance(common.layout, &mut step);
        Some(())
    }

    /// Blurs the photo for the level, `memory` being as long as the picture has pixels.
    #[inline(never)]
    pub(super) fn enter(&mut self, common: &Common<'_, '_>, memory: &mut [f32]) {
        let (blur, width) = (common.level().blur, self.width());
        for (c, plane) in self.planes.photo.iter_mut().enumerate() {
            for (value, pixel) in plane.iter_mut().zip(self.photo.image.pixels) {
                *value = f32::from(at(pixel, c)) / 255.0;
            }
            picture::blur(plane, memory, width, blur);
        }
    }

    /// Rasterizes the subject's surface in the view.
    pub(super) fn render(&mut self, common: &Common<'_, '_>) {
        let Problem { model, engine, .. } = common.problem;
        (engine.project)(&self.view, common.instance.positions, self.window);
        (engine.rasterize)(model.triangles, self.window, &mut self.frame);
    }

    /// Compares what has been rendered with the photo, which renews the mask. Infinite if nothing of
    /// the face is seen. `memory` has room for three planes.
    pub(super) fn judge(&mut self, common: &Common<'_, '_>, memory: &mut [f32]) -> Energy {
        Energy {
            image: self.compare(common, memory).unwrap_or(f64::INFINITY),
            landmarks: self.landmark_energy(common),
            prior: common.priors().energy_of_view(&self.view),
        }
    }

    /// Negative log density of the landmarks.
    pub(super) fn landmark_energy(&self, common: &Common<'_, '_>) -> f64 {
        let sd = common.problem.config.landmark_sd;
        landmarks::energy(&self.landmarks, &common.subject, &self.view, sd)
    }

    /// Adds the Gauss–Newton matrix of so many pixels, drawn for this iteration, and what landmarks
    /// and priors say.
    pub(super) fn add_equations(
        &self,
        common: &Common<'_, '_>,
        pixels: usize,
        iteration: u32,
        scratch: &mut Scratch<'_>,
        system: &mut System<'_>,
    ) {
        self.add_curvature(common, pixels, iteration, scratch, system);
        self.add_landmarks_and_priors(common, system);
    }

    /// Adds what landmarks and the view's priors say.
    pub(super) fn add_landmarks_and_priors(
        &self,
        common: &Common<'_, '_>,
        system: &mut impl Equations,
    ) {
        let (view, number) = (&self.view, self.number);
        landmarks::add_equations(common, &self.landmarks, view, number, system);
        common.priors().add_of_view(view, number, common.layout, system);
    }
}

/// Levenberg's absolute damping of a view's unknowns: half a radian, 100 mm, half the focal length,
/// and of the light; none of colours.
pub(super) fn damping(i: usize) -> f32 {
    let light = if i < POSE + LIGHT { 1.0 } else { 0.0 };
    [4.0, 4.0, 4.0, 1e-4, 1e-4, 4.0, 0.0].get(i).copied().unwrap_or(light)
}
