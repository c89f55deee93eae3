//! The posterior around a mode, with what the photo shows held as the mode has it.
//!
//! At the mode the pixel in the middle of a block of three by three shows some point of the surface: in a
//! triangle, at some weights of its corners. These points are held, and followed wherever the surface goes:
//!
//! `E = priors + landmarks − W/Σa · 1/(2 patch) · Σ_b a_b ℓ_b`,
//!
//! where `ℓ_b` is the log ratio of face and background, bounded, with shade (`image_term.rs`), of the block's
//! mean square difference from the photo. As its point goes from looking like `c₀` to looking like `c`, and
//! moves by `δ` pixels, the block's mean difference goes from `d` to
//!
//! `d + c₀ + δ · s − c`:
//!
//! what comes in the point's place is told by the slopes `s` of the picture that the mode renders, on average
//! over the block. How far its pixels' differences are from their mean stays. So `E` is smooth,
//! [`Held::force`] is its slope in the coordinates of `chart.rs`, and at the mode it is about what the search
//! follows (`gradient.rs`). `a_b` is the sum of what the block's pixels count at the mode, their mask included,
//! and stays: a mask that followed the state would make it no sampler. `W` is `Σa` of all pixels, for which
//! the blocks stand. Twice as many pixels share an error as for the search ([`WIDER`]).
//!
//! What else was tried (docs/posterior.md): to render anew for every state (where triangles are smaller than
//! pixels colours jump, and contours come by, so that chains stick), and to look at the photo where the point
//! has moved to (which draws points to edges that are not theirs, so that the mean face is further from
//! the truth than the mode).

#[cfg(test)]
pub(crate) mod probe;

use super::chart::{Chart, Origin, chart_words};
use super::common::Common;
use super::curvature::{Shades, shades_words};
use super::evidence::Evidence;
use super::gradient::{Pixel, gradient_words};
use super::image_term::{LogRatio, SHADE, SHADE_SHARE, bounded, mean, set, shade_most};
use super::instance::{Instance, at};
use super::part::{APART, HARDLY, Part, seen};
use super::picture;
use super::shading::Shading;
use super::state::ModeSearch;
use super::unknowns::{Layout, MAX_PHOTOS};
use super::window::Window;
use crate::least_squares::{Pulled, Slope, System, system_words};
use crate::math;
use crate::memory::Carver;
use crate::render::rasterize::Hit;
use crate::scene::{Subject, View};
use crate::vector::{Vec3, add, dot, scale, sub};
use core::ops::Range;

/// Times as many pixels share an error as for the search: with as many, intervals of albedo hold the truth too
/// seldom (docs/calibration.md).
pub(crate) const WIDER: f32 = 2.0;
/// Planes that a force needs of a photo.
const PLANES: usize = 7;
/// Words of what is held of a block.
const HELD: usize = 4 + LOOK;
/// Of these, of a [`Look`].
const LOOK: usize = 10;

/// Blocks of a photo with so many columns and rows.
const fn blocks([width, height]: [usize; 2]) -> usize {
    width.div_ceil(APART) * height.div_ceil(APART)
}

/// Words for what is needed in passing, of a photo of that size.
fn passing_words(vertices: usize, layout: Layout, size: [usize; 2]) -> usize {
    let force = PLANES * blocks(size) + gradient_words(vertices, 0);
    force.max(shades_words(layout.len(), size[0]))
}

/// Words of memory a [`Held`] needs besides its search's, of photos of so many columns and rows: of every
/// block what is held, and what a force needs.
pub(crate) fn held_words(
    vertices: usize,
    layout: Layout,
    photos: impl Iterator<Item = [usize; 2]>,
) -> usize {
    let (mut own, mut passing) = (0, 0);
    for size in photos {
        own += HELD * blocks(size);
        passing = passing.max(passing_words(vertices, layout, size));
    }
    chart_words(layout.albedo_rank) + own + passing
}

/// A search at its end, whose memory serves the sampler.
pub(crate) struct Held<'a, 'w, const OTHERS: usize> {
    search: ModeSearch<'a, 'w, OTHERS>,
    subject: Subject,
    photos: heapless::Vec<Photo<'w>, MAX_PHOTOS>,
    chart: Chart<'w>,
    scratch: &'w mut [f32],
}

/// What is held of a photo.
struct Photo<'w> {
    origin: Origin,
    /// Columns of blocks.
    width: usize,
    /// `a` of every block.
    counts: &'w mut [f32],
    /// `1/√G'a` of the shade's Gaussian.
    shares: &'w mut [f32],
    /// Numbers of the blocks that count; the triangles that their points are in; and what they look like.
    points: &'w mut [u32],
    triangles: &'w mut [u32],
    looks: &'w mut [[f32; LOOK]],
    /// How many count.
    count: usize,
    /// Columns and rows of a box around them.
    face: [Range<usize>; 2],
    /// `W/(2 Σa)`.
    share: f32,
}

/// What is held of a block that counts.
#[derive(Clone, Copy)]
struct Look {
    /// What its point should look like, `d + c₀`.
    color: Vec3,
    /// `s`, along x and y.
    slopes: [Vec3; 2],
    /// Log density under the background; and, for what its pixels' differences are apart from their mean,
    /// half their square in units of the variance.
    ln_background: f32,
}

impl Look {
    fn pack(&self) -> [f32; LOOK] {
        let ([r, g, b], [[rx, gx, bx], [ry, gy, by]]) = (self.color, self.slopes);
        [r, g, b, rx, gx, bx, ry, gy, by, self.ln_background]
    }

    fn unpack(&[r, g, b, rx, gx, bx, ry, gy, by, ln_background]: &[f32; LOOK]) -> Self {
        Self { color: [r, g, b], slopes: [[rx, gx, bx], [ry, gy, by]], ln_background }
    }
}

impl<'a, 'w, const OTHERS: usize> Held<'a, 'w, OTHERS> {
    /// Holds what a search has found, in [`held_words`] of memory; `None` if there is less.
    pub(crate) fn new(
        mut search: ModeSearch<'a, 'w, OTHERS>,
        carver: &mut Carver<'w>,
    ) -> Option<Self> {
        search.make_judged();
        let Common { problem, layout, subject, instance, .. } = &mut search.common;
        let (vertices, layout) = (problem.model.vertices(), *layout);
        // The instance is made again below.
        let basis = &problem.model.albedo;
        let chart = Chart::carve(carver, basis, layout.albedo_rank, instance.albedo)?;
        let albedo = chart.albedo(&subject.albedo);
        let subject = subject.clone();
        let mut photos = heapless::Vec::new();
        for evidence in search.evidence() {
            let origin = Origin::new(evidence.view, albedo);
            let photo = Photo::carve(carver, evidence, origin)?;
            photos.push(photo).ok()?;
        }
        let sizes = search.evidence().map(Evidence::size);
        let words = sizes.map(|size| passing_words(vertices, layout, size)).max()?;
        let scratch = carver.floats(words)?;
        let Common { problem, subject: mode, instance, .. } = &mut search.common;
        instance.update(problem.model, problem.engine, mode);
        for (evidence, photo) in search.evidence().zip(&mut photos) {
            photo.hold(evidence, &search.common, scratch)?;
        }
        Some(Self { search, subject, photos, chart, scratch })
    }

    /// Words of memory that it needs of a search.
    pub(crate) fn words(search: &ModeSearch<'_, '_, OTHERS>) -> usize {
        let Common { problem, layout, .. } = &search.common;
        held_words(problem.model.vertices(), *layout, search.evidence().map(Evidence::size))
    }

    /// Looks at nothing but a part of the model from now on, which the photos of this search show; `None` if
    /// there is less memory than [`Part::instance_words`], or it is another's part.
    pub(crate) fn look_at(&mut self, part: &'a Part<'a>, carver: &mut Carver<'w>) -> Option<()> {
        for photo in &mut self.photos {
            for triangle in photo.triangles.iter_mut().take(photo.count) {
                *triangle = part.number(*triangle as usize)? as u32;
            }
        }
        let common = &mut self.search.common;
        common.problem.model = part.model();
        common.instance = Instance::carve(carver, part.model())?;
        Some(())
    }

    /// Factorises the mode's Gauss–Newton matrix; `None` if it is singular or there is too little memory,
    /// and the factor's is then lost.
    pub(crate) fn factorise(&mut self, factor: &mut [f32]) -> Option<()> {
        let n = self.layout().len();
        let Self { search, photos, chart, scratch, subject, .. } = self;
        let ModeSearch { common, first, others, scratch: rows, passing, step, .. } = search;
        let normal_equations = common.problem.engine.normal_equations;
        let mut system = System::new(n, normal_equations, passing.get_mut(..system_words(n))?)?;
        let albedo = chart.albedo(&subject.albedo);
        let all = core::iter::once(&*first).chain(&*others).zip(&*photos);
        for (number, (evidence, photo)) in all.enumerate() {
            let pull = |row: &mut [f32]| {
                let at = (&evidence.view, albedo);
                chart.pull(row, common.layout, number, &photo.origin, at, 0.0);
            };
            let shades = Shades::new(n, evidence.width(), scratch)?;
            let points = photo.points().map(|(point, ..)| {
                let a = at(photo.counts, point);
                (photo.pixel(point), a, a * at(photo.shares, point))
            });
            evidence.add_whole(common, (points, photo.share), pull, rows, shades, &mut system);
            evidence.add_landmarks_and_priors(common, &mut Pulled(&mut system, pull));
        }
        common.priors().add_of_subject(&common.subject, common.layout, &mut system);
        // So little that it is lost but where nothing is known.
        system.solve_damped(1e-6, |_| 1e-6, factor, step)
    }

    /// The unknowns.
    pub(crate) fn layout(&self) -> Layout {
        self.search.common.layout
    }

    /// The subject a step away from the mode.
    pub(crate) fn subject(&self, step: &mut [f32]) -> Subject {
        let mut subject = self.subject.clone();
        if let Some(parts) = self.layout().split(step, 0) {
            parts.advance_subject(&mut subject);
        }
        subject
    }

    /// Its views there.
    pub(crate) fn views(&self, mut step: impl AsMut<[f32]>) -> impl Iterator<Item = View> {
        let layout = self.layout();
        let albedo = self.chart.albedo(&self.subject(step.as_mut()).albedo);
        self.photos.iter().enumerate().filter_map(move |(number, photo)| {
            Some(photo.origin.view(layout, number, step.as_mut(), albedo)?.0)
        })
    }

    /// Goes a step away from the mode; gives the mean albedo and the logarithm of the Jacobian, if there
    /// is something.
    fn go(&mut self, step: &mut [f32]) -> Option<([f32; 3], f64)> {
        let subject = self.subject(step);
        let Self { search, photos, chart, .. } = self;
        let layout = search.common.layout;
        let albedo = chart.albedo(&subject.albedo);
        search.common.subject = subject;
        let mut volume = 0.0;
        for (number, (evidence, photo)) in search.evidence_mut().zip(photos).enumerate() {
            let (view, part) = photo.origin.view(layout, number, step, albedo)?;
            evidence.view = view;
            volume += part;
        }
        let Common { problem, subject, instance, .. } = &mut search.common;
        instance.update(problem.model, problem.engine, subject);
        Some((albedo, volume))
    }

    /// Goes a step away from the mode, and gives the energy there; `None` where the density is
    /// nought.
    pub(crate) fn energy(&mut self, step: &mut [f32]) -> Option<f64> {
        let (albedo, volume) = self.go(step)?;
        let Self { search, photos, chart, scratch, .. } = self;
        let ModeSearch { common, first, others, scratch: rows, gradient, .. } = search;
        let mut sum = common.priors().energy_of_subject(&common.subject) - volume;
        gradient.fill(0.0);
        for (evidence, photo) in core::iter::once(&*first).chain(&*others).zip(&*photos) {
            sum +=
                evidence.landmark_energy(common) + common.priors().energy_of_view(&evidence.view);
            sum += evidence.held_energy(common, photo, scratch, gradient)?;
        }
        if !sum.is_finite() {
            return None;
        }
        let [row, ..] = &mut rows.rows;
        let row = row.get_mut(..common.layout.len()).unwrap_or_default();
        let mut slope = Slope { row, gradient };
        common.priors().add_of_subject(&common.subject, common.layout, &mut slope);
        for evidence in core::iter::once(&*first).chain(&*others) {
            evidence.add_landmarks_and_priors(common, &mut slope);
        }
        let all = core::iter::once(&*first).chain(&*others).zip(&*photos);
        for (number, (evidence, photo)) in all.enumerate() {
            let at = (&evidence.view, albedo);
            chart.pull(gradient, common.layout, number, &photo.origin, at, 1.0);
        }
        Some(sum)
    }

    /// `−∂E/∂u` there, but for rotations, of which it is the slope along a further one.
    pub(crate) fn force(&self) -> &[f32] {
        self.search.gradient
    }
}

impl<'w> Photo<'w> {
    /// Takes the memory; `None` if there is too little.
    fn carve(carver: &mut Carver<'w>, evidence: &Evidence<'_, '_>, origin: Origin) -> Option<Self> {
        let size = evidence.size();
        let all = blocks(size);
        Some(Self {
            origin,
            width: size[0].div_ceil(APART),
            counts: carver.floats(all)?,
            shares: carver.floats(all)?,
            points: carver.words(all)?,
            triangles: carver.words(all)?,
            looks: carver.groups(all)?,
            count: 0,
            face: [0..0, 0..0],
            share: 0.0,
        })
    }

    /// Holds what evidence that has been judged sees; `scratch` is as long as there are blocks.
    fn hold(
        &mut self,
        evidence: &Evidence<'_, '_>,
        common: &Common<'_, '_>,
        scratch: &mut [f32],
    ) -> Option<()> {
        let shading = Shading::new(&evidence.view);
        let (mut least, mut end) = ([usize::MAX; 2], [0; 2]);
        let mut sum = 0.0;
        self.counts.fill(0.0);
        self.count = 0;
        for (pixel, hit) in seen(evidence) {
            let (_, point) = common.point(&shading, &hit)?;
            let (count, look) = evidence.look(common, pixel, point.color);
            let place = pixel.map(|x| x / APART);
            let number = place[1] * self.width + place[0];
            set(self.counts, number, count);
            *self.points.get_mut(self.count)? = number as u32;
            *self.triangles.get_mut(self.count)? = hit.triangle as u32;
            *self.looks.get_mut(self.count)? = look.pack();
            self.count += 1;
            sum += count;
            for axis in 0..2 {
                least[axis] = least[axis].min(place[axis]);
                end[axis] = end[axis].max(place[axis] + 1);
            }
        }
        let whole: f32 = evidence.planes.weights.iter().filter(|a| **a > HARDLY).sum();
        // Nothing may be seen.
        self.face = [0, 1].map(|axis| least[axis].min(end[axis])..end[axis]);
        self.share = if sum > 0.0 { whole / (WIDER * sum) } else { 0.0 };
        self.find_shares(scratch);
        Some(())
    }

    /// Computes the shade's shares of what counts.
    fn find_shares(&mut self, scratch: &mut [f32]) {
        let shares = core::mem::take(&mut self.shares);
        shares.copy_from_slice(self.counts);
        self.spread(shares, scratch);
        for share in &mut *shares {
            *share = if *share > 0.0 { math::rsqrt(*share) } else { 0.0 };
        }
        self.shares = shares;
    }

    /// Blurs a plane by the shade's Gaussian.
    fn spread(&self, plane: &mut [f32], scratch: &mut [f32]) {
        let sd = SHADE / APART as f32;
        picture::blur_box(plane, scratch, self.width, self.face.clone(), sd);
    }

    /// Of the blocks that count their numbers, triangles, and looks.
    fn points(&self) -> impl Iterator<Item = (usize, usize, Look)> {
        let points = self.points.iter().zip(&*self.triangles).zip(&*self.looks).take(self.count);
        points.map(|((point, triangle), look)| {
            (*point as usize, *triangle as usize, Look::unpack(look))
        })
    }

    /// The pixel in the middle of a block.
    fn pixel(&self, point: usize) -> [usize; 2] {
        let width = self.width.max(1);
        [point % width, point / width].map(|x| APART * x + APART / 2)
    }
}

impl Evidence<'_, '_> {
    /// What a block counts around a pixel whose point has that colour, and what is held of it.
    fn look(&self, common: &Common<'_, '_>, [x, y]: [usize; 2], color: Vec3) -> (f32, Look) {
        const HALF: usize = APART / 2;
        let [width, height] = self.size();
        let (mut count, mut ln_background, mut square): (f32, f32, f32) = (0.0, 0.0, 0.0);
        let (mut difference, mut slopes) = ([0.0; 3], [[0.0; 3]; 2]);
        for y in y - HALF..height.min(y + HALF + 1) {
            for x in x - HALF..width.min(x + HALF + 1) {
                let index = y * width + x;
                let a = at(self.planes.weights, index);
                if a > HARDLY {
                    let own = self.difference(index);
                    difference = add(difference, scale(own, a));
                    square += a * dot(own, own);
                    for (sum, slope) in slopes.iter_mut().zip(self.differences(x, y)) {
                        *sum = add(*sum, scale(slope, a));
                    }
                    ln_background += a * at(self.planes.ln_background, index);
                    count += a;
                }
            }
        }
        let k = 1.0 / count;
        let mean = scale(difference, k);
        let apart = 0.5 * (k * square - dot(mean, mean)) / (common.sd() * common.sd());
        let look = Look {
            color: add(color, mean),
            slopes: slopes.map(|slope| scale(slope, k)),
            ln_background: k * ln_background + apart,
        };
        (count, look)
    }

    /// The image term of a surface; adds minus its derivative.
    fn held_energy(
        &self,
        common: &Common<'_, '_>,
        photo: &Photo<'_>,
        memory: &mut [f32],
        gradient: &mut [f32],
    ) -> Option<f64> {
        let Photo { counts, shares, share, .. } = photo;
        let (planes, memory) = memory.split_at_mut_checked(PLANES * counts.len())?;
        let mut planes = planes.chunks_exact_mut(counts.len().max(1));
        let mut plane = || planes.next();
        let mut differences = [plane()?, plane()?, plane()?];
        let [shade, other, weights, spare] = [plane()?, plane()?, plane()?, plane()?];
        let (shading, window) = (Shading::new(&self.view), Window::new(&self.view));
        let show = |point: usize, triangle: usize| {
            let [x, y] = photo.pixel(point);
            let hit = Hit { triangle, ..self.frame.hit(x, y)? };
            Some((hit, common.point(&shading, &hit)?))
        };
        let difference_of = |planes: &[&mut [f32]; 3], point: usize| {
            planes.each_ref().map(|plane| at(plane, point))
        };
        let most = shade_most(common.sd());
        let shaded = |difference: Vec3| mean(difference).max(-most).min(most);
        shade.fill(0.0);
        other.fill(0.0);
        for (point, triangle, look) in photo.points() {
            let (hit, (corners, shown)) = show(point, triangle)?;
            let [x, y] = window.of(common.instance.place(corners, &hit));
            let pixel = photo.pixel(point);
            let [right, down] = [x - pixel[0] as f32, y - pixel[1] as f32];
            let moved = add(scale(look.slopes[0], right), scale(look.slopes[1], down));
            let difference = sub(add(look.color, moved), shown.color);
            for (plane, difference) in differences.iter_mut().zip(difference) {
                set(plane, point, difference);
            }
            set(shade, point, at(counts, point) * at(shares, point) * shaded(difference));
        }
        photo.spread(shade, spare);
        let ln = LogRatio::new(common.sd());
        let mut sum = 0.0;
        for (point, _, look) in photo.points() {
            let [a, own] = [at(counts, point), at(shares, point)];
            let difference = difference_of(&differences, point);
            let shaded = shaded(difference);
            let taken = SHADE_SHARE * own * at(shade, point);
            let ratio = ln.of(difference, look.ln_background) + ln.of_shade(shaded * taken);
            let (ratio, face) = bounded(ratio);
            sum += f64::from(a * ratio);
            set(shade, point, taken);
            set(weights, point, a * face);
            set(other, point, a * face * own * shaded);
        }
        // What points' shade takes from that of others.
        photo.spread(other, spare);
        let unit = share * common.pixel_weight();
        let pixels = photo.points().filter_map(|(point, triangle, look)| {
            let (_, (corners, shown)) = show(point, triangle)?;
            let [a, own] = [at(counts, point), at(shares, point)];
            let (difference, weight) = (difference_of(&differences, point), at(weights, point));
            let all = mean(difference).abs() < most;
            let other = SHADE_SHARE * own * at(other, point);
            let taken = if all { 0.5 * (weight * at(shade, point) + a * other) } else { 0.0 };
            let cost = difference.map(|d| unit * (weight * d - taken));
            let adjoint = shading.adjoint(&shown, cost);
            let by_place = look.slopes.map(|slope| -dot(cost, slope));
            Some(Pixel { corners, weights: shown.weights, adjoint, by_place })
        });
        self.add_gradient_of(common, memory, gradient, pixels);
        Some(-f64::from(share / common.patch()) * sum)
    }
}
