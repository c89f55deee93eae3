//! The posterior around a mode, with what the photo shows held as the mode has it.
//!
//! At the mode every third pixel of every third row shows some point of the surface: in a triangle, at
//! some weights of its corners. These points are held, and followed wherever the surface goes:
//!
//! `E = priors + landmarks − W/Σa · 1/patch · Σ_p a_p ℓ_p`,
//!
//! where `ℓ_p` is the log ratio of face and background, bounded, with shade (`image_term.rs`), of the
//! difference between what the point looks like and the photo at the place where it now is. `a_p` is what
//! the pixel counts at the mode, its mask included, and stays: a mask that followed the state would make
//! it no sampler. `W` is `Σa` of all pixels, for which those that are looked at stand. Pixels near a
//! contour of the surface, where one part hides another or it ends, have none.
//!
//! The photo is seen through a lens that blurs by [`LENS`] pixels, and interpolated by cubic B-splines. So
//! `E` is smooth, and [`Held::force`] its slope, in the coordinates of `chart.rs`. (With pixels that are held
//! while the surface moves under them it is not: where triangles are smaller than pixels colours jump,
//! and contours come by.)

#[cfg(test)]
pub(crate) mod probe;

use super::chart::{Chart, Origin, chart_words};
use super::common::Common;
use super::curvature::{Shades, shades_words};
use super::evidence::Evidence;
use super::gradient::{Pixel, gradient_words};
use super::image_term::{LogRatio, SHADE, SHADE_SHARE, bounded, mean, set, shade_most};
use super::part::{APART, HARDLY, Part, seen};
use super::picture;
use super::shading::Shading;
use super::state::ModeSearch;
use super::surface::{Surface, at};
use super::unknowns::{Layout, MAX_PHOTOS};
use super::vector::{Vec3, dot, sub};
use super::window::Window;
use crate::least_squares::{Slope, System, system_words};
use crate::math;
use crate::memory::Carver;
use crate::render::rasterize::Hit;
use crate::scene::{Subject, View};
use core::ops::Range;

/// Standard deviation of the lens's blur, pixels.
const LENS: f32 = 2.0;
/// How near a contour is, pixels.
const NEAR: f32 = 2.0;
/// Planes that a force needs of a photo.
const PLANES: usize = 13;

/// Pixels that are looked at, of a photo with so many columns and rows.
const fn looked_at([width, height]: [usize; 2]) -> usize {
    width.div_ceil(APART) * height.div_ceil(APART)
}

/// Words for what is needed in passing, of a photo of that size.
fn passing_words(vertices: usize, layout: Layout, size: [usize; 2]) -> usize {
    let [width, height] = size;
    let force = PLANES * looked_at(size) + gradient_words(vertices, 0);
    force.max(width * height).max(shades_words(layout.len(), width))
}

/// Words of memory a [`Held`] needs besides its search's, of photos of so many columns and rows: of every
/// pixel that is looked at four numbers and what a force needs, and of every pixel one to blur it.
pub(crate) fn held_words(
    vertices: usize,
    layout: Layout,
    photos: impl Iterator<Item = [usize; 2]>,
) -> usize {
    let (mut own, mut passing) = (0, 0);
    for size in photos {
        own += 4 * looked_at(size);
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
    /// Columns of the pixels that are looked at.
    width: usize,
    /// `a` of these pixels.
    counts: &'w mut [f32],
    /// `1/√G'a` of the shade's Gaussian.
    shares: &'w mut [f32],
    /// Numbers of those that count, the points.
    points: &'w mut [u32],
    /// Triangles that these are in.
    triangles: &'w mut [u32],
    /// Columns and rows of a box around them.
    face: [Range<usize>; 2],
    /// `W/Σa`.
    share: f32,
}

impl<'a, 'w, const OTHERS: usize> Held<'a, 'w, OTHERS> {
    /// Holds what a search has found, in [`held_words`] of memory; `None` if there is less.
    pub(crate) fn new(
        mut search: ModeSearch<'a, 'w, OTHERS>,
        carver: &mut Carver<'w>,
    ) -> Option<Self> {
        search.make_judged();
        let Common { problem, layout, subject, surface, .. } = &mut search.common;
        let (vertices, layout) = (problem.model.vertices(), *layout);
        // The surface is made again below.
        let basis = &problem.model.albedo;
        let chart = Chart::carve(carver, basis, layout.albedo_rank, surface.albedo)?;
        let albedo = chart.albedo(&subject.albedo);
        let subject = subject.clone();
        let mut photos = heapless::Vec::new();
        for evidence in search.evidence() {
            let photo = Photo::carve(carver, evidence, &search.common, albedo)?;
            photos.push(photo).ok()?;
        }
        let sizes = search.evidence().map(Evidence::size);
        let words = sizes.map(|size| passing_words(vertices, layout, size)).max()?;
        let scratch = carver.floats(words)?;
        for (evidence, photo) in search.evidence_mut().zip(&mut photos) {
            photo.find_shares(scratch);
            let width = evidence.width();
            for plane in &mut evidence.planes.photo {
                picture::blur(plane, scratch, width, LENS);
            }
        }
        let Common { problem, subject: mode, surface, .. } = &mut search.common;
        surface.update(problem.model, problem.engine, mode);
        Some(Self { search, subject, photos, chart, scratch })
    }

    /// Words of memory that it needs of a search.
    pub(crate) fn words(search: &ModeSearch<'_, '_, OTHERS>) -> usize {
        let Common { problem, layout, .. } = &search.common;
        held_words(problem.model.vertices(), *layout, search.evidence().map(Evidence::size))
    }

    /// Looks at nothing but a part of the model from now on, which the photos of this search show; `None` if
    /// there is less memory than [`Part::surface_words`], or it is another's part.
    pub(crate) fn look_at(&mut self, part: &'a Part<'a>, carver: &mut Carver<'w>) -> Option<()> {
        for photo in &mut self.photos {
            for triangle in &mut *photo.triangles {
                *triangle = part.number(*triangle as usize)? as u32;
            }
        }
        let common = &mut self.search.common;
        common.problem.model = part.model();
        common.surface = Surface::carve(carver, part.model())?;
        Some(())
    }

    /// Factorises the mode's Gauss–Newton matrix; `None` if it is singular or there is too little memory,
    /// and the factor's is then lost.
    pub(crate) fn factorise(&mut self, factor: &mut [f32]) -> Option<()> {
        let n = self.layout().len();
        let Self { search, photos, chart, scratch, subject } = self;
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
            let points = photo.points().map(|(point, _)| {
                let a = at(photo.counts, point);
                (photo.pixel(point), a, a * at(photo.shares, point))
            });
            evidence.add_whole(common, (points, photo.share), pull, rows, shades, &mut system);
            evidence.add_landmarks_and_priors(common, &mut system);
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
        let Common { problem, subject, surface, .. } = &mut search.common;
        surface.update(problem.model, problem.engine, subject);
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
    /// Of evidence that has been judged, where the mean albedo is that.
    fn carve(
        carver: &mut Carver<'w>,
        evidence: &Evidence<'_, '_>,
        common: &Common<'_, '_>,
        albedo: [f32; 3],
    ) -> Option<Self> {
        let size = evidence.size();
        let [columns, width] = [size[0], size[0].div_ceil(APART)];
        let all = looked_at(size);
        let [counts, shares] = [carver.floats(all)?, carver.floats(all)?];
        let [points, triangles] = [carver.words(all)?, carver.words(all)?];
        // What is near a contour is marked.
        let marks = carver.scratch(columns * size[1])?;
        marks.fill(0);
        evidence.mark_contours(common, marks);
        let weights = evidence.planes.weights.iter().zip(&*marks);
        let whole: f32 =
            weights.filter(|(a, mark)| **a > HARDLY && **mark == 0).map(|(a, _)| a).sum();
        let (mut sum, mut count): (f32, _) = (0.0, 0);
        counts.fill(0.0);
        let (mut first, mut end) = ([usize::MAX; 2], [0; 2]);
        for ([x, y], hit) in seen(evidence) {
            let pixel = y * columns + x;
            if at(marks, pixel) != 0 {
                continue;
            }
            let place = [x / APART, y / APART];
            let point = place[1] * width + place[0];
            let weight = at(evidence.planes.weights, pixel);
            set(counts, point, weight);
            *points.get_mut(count)? = point as u32;
            *triangles.get_mut(count)? = hit.triangle as u32;
            sum += weight;
            count += 1;
            for axis in 0..2 {
                first[axis] = first[axis].min(place[axis]);
                end[axis] = end[axis].max(place[axis] + 1);
            }
        }
        let (points, _) = points.split_at_mut_checked(count)?;
        let (triangles, _) = triangles.split_at_mut_checked(count)?;
        // Nothing may be seen.
        let face = [0, 1].map(|axis| first[axis].min(end[axis])..end[axis]);
        let share = if sum > 0.0 { whole / sum } else { 0.0 };
        let origin = Origin::new(evidence.view, albedo);
        Some(Self { origin, width, counts, shares, points, triangles, face, share })
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

    /// Numbers of the points, and their triangles.
    fn points(&self) -> impl Iterator<Item = (usize, usize)> {
        let points = self.points.iter().zip(&*self.triangles);
        points.map(|(point, triangle)| (*point as usize, *triangle as usize))
    }

    /// The pixel that showed a point.
    fn pixel(&self, point: usize) -> [usize; 2] {
        let width = self.width.max(1);
        [APART * (point % width), APART * (point / width)]
    }
}

impl Evidence<'_, '_> {
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
        let differences = [plane()?, plane()?, plane()?];
        let mut slopes = [[plane()?, plane()?, plane()?], [plane()?, plane()?, plane()?]];
        let [shade, other, weights, spare] = [plane()?, plane()?, plane()?, plane()?];
        let (shading, window) = (Shading::new(&self.view), Window::new(&self.view));
        let look = |point: usize, triangle: usize| {
            let [x, y] = photo.pixel(point);
            let hit = Hit { triangle, ..self.frame.hit(x, y)? };
            Some((hit, common.point(&shading, &hit)?))
        };
        let vector = |planes: &[&mut [f32]; 3], point: usize| {
            planes.each_ref().map(|plane| at(plane, point))
        };
        let most = shade_most(common.sd());
        let shaded = |difference: Vec3| mean(difference).max(-most).min(most);
        shade.fill(0.0);
        other.fill(0.0);
        for (point, triangle) in photo.points() {
            let (hit, (corners, looks)) = look(point, triangle)?;
            let place = window.of(common.surface.place(corners, &hit));
            let (seen, along) = picture::sample(&self.planes.photo, self.width(), place);
            let difference = sub(seen, looks.color);
            for c in 0..3 {
                set(differences[c], point, difference[c]);
                for (slopes, along) in slopes.iter_mut().zip(along) {
                    set(slopes[c], point, along[c]);
                }
            }
            set(shade, point, at(counts, point) * at(shares, point) * shaded(difference));
        }
        photo.spread(shade, spare);
        let ln = LogRatio::new(common.sd());
        let mut sum = 0.0;
        for (point, _) in photo.points() {
            let [a, own] = [at(counts, point), at(shares, point)];
            let difference = vector(&differences, point);
            let shaded = shaded(difference);
            let taken = SHADE_SHARE * own * at(shade, point);
            let [x, y] = photo.pixel(point);
            let background = at(self.planes.ln_background, y * self.width() + x);
            let ratio = ln.of(difference, background) + ln.of_shade(shaded * taken);
            let (ratio, face) = bounded(ratio);
            sum += f64::from(a * ratio);
            set(shade, point, taken);
            set(weights, point, a * face);
            set(other, point, a * face * own * shaded);
        }
        // What points' shade takes from that of others.
        photo.spread(other, spare);
        let unit = share * common.pixel_weight();
        let pixels = photo.points().filter_map(|(point, triangle)| {
            let (_, (corners, looks)) = look(point, triangle)?;
            let [a, own] = [at(counts, point), at(shares, point)];
            let (difference, weight) = (vector(&differences, point), at(weights, point));
            let all = mean(difference).abs() < most;
            let other = SHADE_SHARE * own * at(other, point);
            let taken = if all { 0.5 * (weight * at(shade, point) + a * other) } else { 0.0 };
            let cost = difference.map(|d| unit * (weight * d - taken));
            let adjoint = shading.adjoint(&looks, cost);
            let by_place = slopes.each_ref().map(|slopes| -dot(cost, vector(slopes, point)));
            Some(Pixel { corners, weights: looks.weights, adjoint, by_place })
        });
        self.add_gradient_of(common, memory, gradient, pixels);
        Some(-f64::from(share / common.patch()) * sum)
    }

    /// Marks the pixels near a contour.
    fn mark_contours(&self, common: &Common<'_, '_>, marks: &mut [u32]) {
        let triangles = common.problem.model.triangles;
        let place = |v: usize| {
            let [x, y, ..] = at(self.window, v);
            [x, y]
        };
        let area = |corners: [usize; 3]| {
            let [a, b, c] = corners.map(place);
            (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        };
        for corners in (0..triangles.len()).filter_map(|t| triangles.get(t)) {
            let [a, b, c] = corners.map(|v| v as usize);
            let own = area([a, b, c]);
            for edge in [[a, b], [b, c], [c, a]] {
                let (mut faces, mut turned) = (0, false);
                for face in common.surface.faces_of(triangles, edge) {
                    faces += 1;
                    turned |= own * area(face) < 0.0;
                }
                if faces == 1 || turned {
                    mark_along(edge.map(place), marks, self.size());
                }
            }
        }
    }
}

/// Marks what is [`NEAR`] a line in the window.
fn mark_along([from, to]: [[f32; 2]; 2], marks: &mut [u32], [width, height]: [usize; 2]) {
    let way = [to[0] - from[0], to[1] - from[1]];
    let square = (way[0] * way[0] + way[1] * way[1]).max(f32::MIN_POSITIVE);
    let range = |axis: usize, end: usize| {
        let (low, high) = (from[axis].min(to[axis]), from[axis].max(to[axis]));
        let clamp = |x: f32| x.max(0.0).min(end as f32) as usize;
        clamp(low - NEAR)..clamp(high + NEAR + 1.0)
    };
    for y in range(1, height) {
        for x in range(0, width) {
            let off = [x as f32 - from[0], y as f32 - from[1]];
            let along = (off[0] * way[0] + off[1] * way[1]) / square;
            let along = along.clamp(0.0, 1.0);
            let rest = [off[0] - along * way[0], off[1] - along * way[1]];
            let near = rest[0] * rest[0] + rest[1] * rest[1] < NEAR * NEAR;
            if let Some(mark) = marks.get_mut(y * width + x).filter(|_| near) {
                *mark = 1;
            }
        }
    }
}
