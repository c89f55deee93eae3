//! The posterior around a mode, with what pixels count held as the mode has it.
//!
//! `E = priors + landmarks − W/Σa · 1/patch · Σ_p a_p ℓ_p`
//!
//! over the covered pixels. `a_p` is what a pixel counts at the mode, its mask included
//! (`image_term.rs`), and stays: a mask that followed the state would make it no sampler. `W` is `Σa` of
//! all pixels: to cover less is no gain. `ℓ_p` is the log ratio of face and background, bounded, with
//! shade, but of the difference of photo and rendering as a lens shows it that blurs by [`LENS`] pixels:
//! `d = G(a·(photo − rendering))/Ga`. Where triangles are smaller than pixels a rendering is made of
//! lucky hits, and without the lens its differences jump as the surface moves.
//!
//! Pixels near a contour of the surface, where one part hides another or it ends, have `a_p = 0`,
//! wherever [`Held::leave_contours_out`] has looked for contours. So `E` is smooth there, and
//! [`Held::force`] its slope, in the coordinates of `chart.rs`; but for how colours follow the motion of
//! the surface, which is by differences of the rendering (`gradient.rs`).

use super::chart::{Chart, Origin, chart_words};
use super::common::Common;
use super::evidence::Evidence;
use super::gradient::{Pixel, gradient_words};
use super::image_term::{LogRatio, SHADE, SHADE_SHARE, bounded, mean, set, shade_most};
use super::picture;
use super::shading::Shading;
use super::state::ModeSearch;
use super::surface::at;
use super::unknowns::{Layout, MAX_PHOTOS};
use super::vector::{Vec3, dot, sub};
use crate::least_squares::{Slope, System, system_words};
use crate::math;
use crate::memory::Carver;
use crate::scene::{Subject, View};
use core::ops::Range;

/// Standard deviation of the lens's blur, pixels.
const LENS: f32 = 1.0;
/// How near a contour is, pixels.
const NEAR: f32 = 1.25;
/// What a pixel counts at least, or it does not.
const HARDLY: f32 = 0.01;
/// Part of what counts that a scene must cover.
const COVERED: f64 = 0.5;

/// Words of memory a [`Held`] needs besides its search's, of photos of so many pixels: of every pixel
/// what it counts and two planes that follow from it; seven planes, and what a gradient needs.
pub(crate) fn held_words(
    vertices: usize,
    albedo_rank: usize,
    photos: impl Iterator<Item = usize>,
) -> usize {
    let (sum, most) = photos.fold((0, 0), |(sum, most), pixels| (sum + pixels, pixels.max(most)));
    chart_words(albedo_rank) + 3 * sum + 7 * most + gradient_words(vertices, most)
}

/// A search at its end, whose memory serves the sampler.
pub(crate) struct Held<'a, 'w, const OTHERS: usize> {
    search: ModeSearch<'a, 'w, OTHERS>,
    subject: Subject,
    photos: heapless::Vec<Photo<'w>, MAX_PHOTOS>,
    chart: Chart<'w>,
    /// `a` of every photo's pixels, one photo after the other.
    counts: &'w mut [f32],
    scratch: &'w mut [f32],
}

/// What is held of a photo.
struct Photo<'w> {
    origin: Origin,
    /// `1/Ga`.
    near: &'w mut [f32],
    /// `1/√G'a` of the shade's wider Gaussian.
    shares: &'w mut [f32],
    /// `Σa`.
    whole: f64,
    /// Columns and rows of a box around all that counts. Only there the rendering is made anew, so
    /// that at its border the force takes one of two neighbours as it was when the chain began: the
    /// same wherever the state is, as it has to be.
    face: [Range<usize>; 2],
}

impl<'a, 'w, const OTHERS: usize> Held<'a, 'w, OTHERS> {
    /// Holds what a search has found, in [`held_words`] of memory; `None` if there is less.
    pub(crate) fn new(
        mut search: ModeSearch<'a, 'w, OTHERS>,
        carver: &mut Carver<'w>,
    ) -> Option<Self> {
        search.make_judged();
        let Common { problem, layout, subject, surface, .. } = &mut search.common;
        // The surface is made anew with every step.
        let basis = &problem.model.albedo;
        let chart = Chart::carve(carver, basis, layout.albedo_rank, surface.albedo)?;
        let albedo = chart.albedo(&subject.albedo);
        let mut photos = heapless::Vec::new();
        let pixels = || search.evidence().map(|evidence| evidence.planes.weights.len());
        let most = pixels().max().unwrap_or(0);
        let counts = carver.floats(pixels().sum())?;
        let mut rest = &mut *counts;
        for evidence in search.evidence() {
            let (own, others) = rest.split_at_mut_checked(evidence.planes.weights.len())?;
            rest = others;
            for (count, weight) in own.iter_mut().zip(&*evidence.planes.weights) {
                *count = if *weight > HARDLY { *weight } else { 0.0 };
            }
            let [near, shares] = [carver.floats(own.len())?, carver.floats(own.len())?];
            let (origin, face) = (Origin::new(evidence.view, albedo), [0..0, 0..0]);
            photos.push(Photo { origin, near, shares, whole: 0.0, face }).ok()?;
        }
        let vertices = search.common.problem.model.vertices();
        let scratch = carver.floats(7 * most + gradient_words(vertices, most))?;
        let subject = search.common.subject.clone();
        Some(Self { search, subject, photos, chart, counts, scratch })
    }

    /// Words of memory that it needs of a search.
    pub(crate) fn words(search: &ModeSearch<'_, '_, OTHERS>) -> usize {
        let Common { problem, layout, .. } = &search.common;
        let pixels = search.evidence().map(|evidence| evidence.planes.weights.len());
        held_words(problem.model.vertices(), layout.albedo_rank, pixels)
    }

    /// What pixels count, photo by photo.
    pub(crate) fn counts(&self) -> &[f32] {
        self.counts
    }

    /// Has pixels count what they count elsewhere; whether there are as many.
    pub(crate) fn count(&mut self, counts: &[f32]) -> bool {
        let same = counts.len() == self.counts.len();
        if same {
            self.counts.copy_from_slice(counts);
            self.settle();
        }
        same
    }

    /// Leaves out what is near a contour a step from the mode; [`Held::settle`] is to follow.
    pub(crate) fn leave_contours_out(&mut self, step: &mut [f32]) {
        if self.go(step).is_none() {
            return;
        }
        let mut rest = &mut *self.counts;
        for evidence in self.search.evidence() {
            let Some((counts, others)) = rest.split_at_mut_checked(evidence.planes.mask.len())
            else {
                return;
            };
            evidence.leave_contours_out(&self.search.common, counts);
            rest = others;
        }
    }

    /// Computes what follows from what pixels count.
    pub(crate) fn settle(&mut self) {
        let mut rest = &*self.counts;
        for (evidence, photo) in self.search.evidence().zip(&mut self.photos) {
            let Some((counts, others)) = rest.split_at_checked(photo.near.len()) else { return };
            photo.settle(counts, evidence.width(), self.scratch);
            rest = others;
        }
    }

    /// Factorises the mean of the Gauss–Newton matrices some steps from the mode, by so many pixels
    /// each; `None` if it is singular or there is too little memory, and the factor's is then lost.
    pub(crate) fn factorise(
        &mut self,
        steps: &mut [f32],
        samples: usize,
        factor: &mut [f32],
    ) -> Option<()> {
        // The search's, out of the way of what follows.
        let passing = core::mem::take(&mut self.search.passing);
        let made = self.factorise_in(passing, steps, samples, factor);
        self.search.passing = passing;
        made
    }

    fn factorise_in(
        &mut self,
        memory: &mut [f32],
        steps: &mut [f32],
        samples: usize,
        factor: &mut [f32],
    ) -> Option<()> {
        let n = self.layout().len();
        let engine = self.search.common.problem.engine.normal_equations;
        let mut system = System::new(n, engine, memory.get_mut(..system_words(n))?)?;
        let mut count = 0;
        for step in steps.chunks_exact_mut(n.max(1)) {
            let Some((albedo, _)) = self.go(step) else { continue };
            let ModeSearch { common, first, others, scratch, .. } = &mut self.search;
            let mut rest = &*self.counts;
            let all = core::iter::once(&mut *first).chain(&mut *others).zip(&self.photos);
            for (number, (evidence, photo)) in all.enumerate() {
                evidence.draw(common);
                let (counts, others) = rest.split_at_checked(evidence.planes.weights.len())?;
                evidence.planes.weights.copy_from_slice(counts);
                rest = others;
                let chart = &self.chart;
                let view = evidence.view;
                let pull = |row: &mut [f32]| {
                    chart.pull(row, common.layout, number, &photo.origin, (&view, albedo), 0.0);
                };
                evidence.add_curvature(common, samples, count, pull, scratch, &mut system);
                evidence.add_landmarks_and_priors(common, scratch.components, &mut system);
            }
            common.priors().add_of_subject(&common.subject, common.layout, &mut system);
            count += 1;
        }
        // So little that it is lost but where nothing is known.
        system.solve_damped(1e-6, |_| 1e-6, factor, self.search.step)?;
        let share = math::rsqrt(count as f32);
        for u in factor {
            *u *= share;
        }
        Some(())
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

    /// Goes a step away from the mode, and renders what is there; gives the mean albedo and the
    /// logarithm of the Jacobian, if there is something.
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
        search.render();
        Some((albedo, volume))
    }

    /// Goes a step away from the mode, and gives the energy there; `None` where the density is
    /// nought.
    pub(crate) fn energy(&mut self, step: &mut [f32]) -> Option<f64> {
        let (albedo, volume) = self.go(step)?;
        let Self { search, photos, chart, counts, scratch, .. } = self;
        let mut rest = &**counts;
        let ModeSearch { common, first, others, scratch: rows, gradient, .. } = search;
        let mut sum = common.priors().energy_of_subject(&common.subject) - volume;
        gradient.fill(0.0);
        for (evidence, photo) in core::iter::once(&mut *first).chain(&mut *others).zip(&*photos) {
            sum +=
                evidence.landmark_energy(common) + common.priors().energy_of_view(&evidence.view);
            if !sum.is_finite() {
                return None;
            }
            let (counts, others) = rest.split_at_checked(photo.near.len())?;
            sum += evidence.held_energy(common, photo, counts, scratch, gradient)?;
            rest = others;
        }
        let [row, ..] = &mut rows.rows;
        let row = row.get_mut(..common.layout.len()).unwrap_or_default();
        let mut slope = Slope { row, gradient };
        common.priors().add_of_subject(&common.subject, common.layout, &mut slope);
        for evidence in core::iter::once(&*first).chain(&*others) {
            evidence.add_landmarks_and_priors(common, rows.components, &mut slope);
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

impl Photo<'_> {
    /// Computes what follows from what pixels count.
    fn settle(&mut self, counts: &[f32], width: usize, scratch: &mut [f32]) {
        let Self { near, shares, .. } = self;
        let width = width.max(1);
        let counting = || counts.iter().enumerate().filter(|(_, a)| **a > 0.0).map(|(i, _)| i);
        let range = |along: fn(usize, usize) -> usize| {
            let first = counting().map(|i| along(i, width)).min().unwrap_or(0);
            first..counting().map(|i| along(i, width) + 1).max().unwrap_or(0)
        };
        self.face = [range(|i, width| i % width), range(|i, width| i / width)];
        self.whole = counts.iter().map(|a| f64::from(*a)).sum();
        near.copy_from_slice(counts);
        shares.copy_from_slice(counts);
        picture::blur_box(near, scratch, width, self.face.clone(), LENS);
        picture::blur_box(shares, scratch, width, self.face.clone(), SHADE);
        for ((near, share), a) in near.iter_mut().zip(shares.iter_mut()).zip(counts) {
            let seen = *a > 0.0;
            *near = if seen { 1.0 / *near } else { 0.0 };
            *share = if seen { math::rsqrt(*share) } else { 0.0 };
        }
    }
}

impl Evidence<'_, '_> {
    /// The image term of what has been rendered; adds minus its derivative.
    fn held_energy(
        &mut self,
        common: &Common<'_, '_>,
        photo: &Photo<'_>,
        counts: &[f32],
        memory: &mut [f32],
        gradient: &mut [f32],
    ) -> Option<f64> {
        let Photo { near, shares, whole, face, .. } = photo;
        let (width, pixels) = (self.width(), counts.len());
        let (planes, memory) = memory.split_at_mut_checked(7 * pixels)?;
        let mut planes = planes.chunks_exact_mut(pixels.max(1));
        let mut plane = || planes.next();
        let mut seen = [plane()?, plane()?, plane()?];
        let [shade, other, own, spare] = [plane()?, plane()?, plane()?, plane()?];
        let shading = Shading::new(&self.view);
        let [columns, rows] = face;
        let lines = || rows.clone().map(|y| y * width + columns.start..y * width + columns.end);
        self.look(common, photo, counts, &mut seen, spare);
        let most = shade_most(common.sd());
        let difference = |seen: &[&mut [f32]; 3], index: usize| -> Vec3 {
            seen.each_ref().map(|plane| at(plane, index))
        };
        let shaded = |d: Vec3| mean(d).max(-most).min(most);
        for index in lines().flatten() {
            let shaded = shaded(difference(&seen, index));
            set(shade, index, at(counts, index) * at(shares, index) * shaded);
        }
        picture::blur_box(shade, spare, width, face.clone(), SHADE);
        let ln = LogRatio::new(common.sd());
        let (mut weight, mut sum) = (0.0, 0.0);
        for y in rows.clone() {
            let (mut row_weight, mut row_sum) = (0.0, 0.0);
            for x in columns.clone() {
                let index = y * width + x;
                let a = at(counts, index);
                set(own, index, 0.0);
                if !(a > 0.0) || self.frame.hit(x, y).is_none() {
                    continue;
                }
                let difference = difference(&seen, index);
                set(shade, index, SHADE_SHARE * at(shares, index) * at(shade, index));
                let ratio = ln.of(difference, at(self.planes.ln_background, index))
                    + ln.of_shade(shaded(difference) * at(shade, index));
                let (ratio, share) = bounded(ratio);
                row_weight += a;
                row_sum += a * ratio;
                set(own, index, a * share);
            }
            weight += f64::from(row_weight);
            sum += f64::from(row_sum);
        }
        if !(weight > COVERED * whole) {
            return None;
        }
        let share = whole / weight;
        // What pixels' shade takes from that of others.
        for index in lines().flatten() {
            let shaded = shaded(difference(&seen, index));
            set(other, index, at(own, index) * at(shares, index) * shaded);
        }
        picture::blur_box(other, spare, width, face.clone(), SHADE);
        let unit = share as f32 * common.pixel_weight();
        for index in lines().flatten() {
            let difference = difference(&seen, index);
            let (a, own) = (at(counts, index), at(own, index));
            let other = SHADE_SHARE * at(shares, index) * at(other, index);
            let all = mean(difference).abs() < most;
            let taken = if all { 0.5 * (own * at(shade, index) + a * other) } else { 0.0 };
            let k = unit * at(near, index);
            for (plane, d) in seen.iter_mut().zip(difference) {
                set(plane, index, k * (own * d - taken));
            }
        }
        for plane in &mut seen {
            picture::blur_box(plane, spare, width, face.clone(), LENS);
        }
        self.add_gradient_of(common, memory, gradient, |[x, y], hit| {
            let index = y * width + x;
            let a = at(counts, index);
            if !(a > 0.0) {
                return None;
            }
            let (corners, point) = common.point(&shading, hit)?;
            let cost = difference(&seen, index).map(|cost| a * cost);
            let adjoint = shading.adjoint(&point, cost);
            let by_place = self.differences(x, y).map(|d| -dot(cost, d));
            Some(Pixel { corners, weights: point.weights, adjoint, by_place })
        });
        let patch = f64::from(common.patch());
        Some(-share * sum / patch)
    }

    /// Fills `seen` with how photo and rendering differ, channel by channel, as the lens shows it.
    fn look(
        &mut self,
        common: &Common<'_, '_>,
        photo: &Photo<'_>,
        counts: &[f32],
        seen: &mut [&mut [f32]; 3],
        spare: &mut [f32],
    ) {
        let Photo { near, face, .. } = photo;
        let (width, shading) = (self.width(), Shading::new(&self.view));
        let [columns, rows] = face;
        let lines = || rows.clone().map(|y| y * width + columns.start..y * width + columns.end);
        for y in rows.clone() {
            for x in columns.clone() {
                let index = y * width + x;
                let a = at(counts, index);
                let hit = self.frame.hit(x, y);
                let point = hit.and_then(|hit| common.point(&shading, &hit));
                for (c, plane) in self.planes.rendering.iter_mut().enumerate() {
                    set(plane, index, point.map_or(f32::NAN, |(_, point)| point.color[c]));
                }
                let difference = point.map(|(_, point)| sub(self.photo_at(index), point.color));
                for (c, plane) in seen.iter_mut().enumerate() {
                    set(plane, index, difference.map_or(0.0, |d| a * d[c]));
                }
            }
        }
        for plane in seen {
            picture::blur_box(plane, spare, width, face.clone(), LENS);
            for index in lines().flatten() {
                set(plane, index, at(plane, index) * at(near, index));
            }
        }
    }

    /// Sets to nought what pixels near a contour count, and those that are not covered.
    fn leave_contours_out(&self, common: &Common<'_, '_>, counts: &mut [f32]) {
        let width = self.width().max(1);
        for (index, count) in counts.iter_mut().enumerate() {
            if self.frame.hit(index % width, index / width).is_none() {
                *count = 0.0;
            }
        }
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
                    clear_along(edge.map(place), counts, width);
                }
            }
        }
    }
}

/// Sets to nought what is [`NEAR`] a line in the window.
fn clear_along([from, to]: [[f32; 2]; 2], counts: &mut [f32], width: usize) {
    let way = [to[0] - from[0], to[1] - from[1]];
    let square = (way[0] * way[0] + way[1] * way[1]).max(f32::MIN_POSITIVE);
    let height = counts.len() / width;
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
            if rest[0] * rest[0] + rest[1] * rest[1] < NEAR * NEAR {
                set(counts, y * width + x, 0.0);
            }
        }
    }
}
