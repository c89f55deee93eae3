//! Faces in a picture by MediaPipe's short-range detector (Bazarevsky et al. 2019), and 468 points of each
//! by its face mesh (Kartynnik et al. 2019).
//!
//! Both networks see a square of the picture. MediaPipe samples number `i` of `n` at `i/n` of the square's
//! side from its corner, between the pixels whose coordinates are those of their *corners*, and what the
//! networks tell is in the same measure; so it is done here. Only at the end half a pixel comes off, since
//! our pixels have their centres at whole numbers.

use super::network::Network;
use crate::photo::picture::Picture;
use onescan_core::math;

/// What the detector tells of each anchor: a box's centre and size, then six points.
const TOLD: usize = 16;
/// Least score of a face; this and the next, like the factor for the mesh, are MediaPipe's.
const SCORE: f32 = 0.5;
/// Boxes that share more of their union than this are of one face.
const SAME: f32 = 0.3;
/// Points whose mean a network sees, across, at the most.
const MOST_POINTS: u16 = 6;
/// What the mesh sees is this many times as large as the box.
const AROUND: f32 = 1.5;

/// A square part of a picture: its centre and side in pixels, and how far it is turned, radians clockwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Square {
    pub(super) center: [f32; 2],
    pub(super) side: f32,
    pub(super) turn: f32,
}

impl Square {
    /// Where something is in the picture that is at `(x, y)` of the square, from −½ to ½.
    fn place(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (sine, cosine) = math::sin_cos(self.turn);
        [
            self.center[0] + self.side * (cosine * x - sine * y),
            self.center[1] + self.side * (sine * x + cosine * y),
        ]
    }

    /// What is seen there, `[row][column][channel]`, linear between pixels, times and plus the numbers of
    /// `scale`; beyond the picture it is as at the rim, or black. Of a picture that is much finer the mean
    /// over some points counts.
    fn sample(&self, picture: &Picture, size: usize, rim: bool, scale: [f32; 2]) -> Vec<f32> {
        let [width, height] = [picture.width, picture.height].map(|side| side as f32);
        let pixel = |x: f32, y: f32| {
            let inside = x >= 0.0 && y >= 0.0 && x < width && y < height;
            let (x, y) = (x.clamp(0.0, width - 1.0), y.clamp(0.0, height - 1.0));
            let color = picture.pixel(x as u32, y as u32).filter(|_| inside || rim);
            color.unwrap_or_default().map(f32::from)
        };
        let at = |x: f32, y: f32| {
            let [left, top] = [x.floor(), y.floor()];
            let [u, v] = [x - left, y - top];
            let [a, b] = [pixel(left, top), pixel(left + 1.0, top)];
            let [c, d] = [pixel(left, top + 1.0), pixel(left + 1.0, top + 1.0)];
            std::array::from_fn::<f32, 3, _>(|k| {
                let above = a[k] * (1.0 - u) + b[k] * u;
                let below = c[k] * (1.0 - u) + d[k] * u;
                above * (1.0 - v) + below * v
            })
        };
        let points = ((self.side / size as f32) as u16).clamp(1, MOST_POINTS);
        let inner = |i: u16| (f32::from(i) + 0.5) / f32::from(points) - 0.5;
        let mut seen = Vec::with_capacity(3 * size * size);
        for (row, column) in (0..size).flat_map(|row| (0..size).map(move |column| (row, column))) {
            let mut sum = [0.0; 3];
            for (i, j) in (0..points).flat_map(|i| (0..points).map(move |j| (i, j))) {
                let within = [column as f32 + inner(j), row as f32 + inner(i)];
                let [x, y] = self.place(within.map(|i| i / size as f32 - 0.5));
                for (sum, value) in sum.iter_mut().zip(at(x, y)) {
                    *sum += value;
                }
            }
            let count = f32::from(points * points);
            seen.extend(sum.map(|sum| sum / count * scale[0] + scale[1]));
        }
        seen
    }
}

/// A face that the detector has found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Found {
    /// How sure, ½ to 1.
    pub(super) score: f32,
    pub(super) center: [f32; 2],
    /// Of the longer side of its box, pixels.
    pub(super) size: f32,
    /// The subject's right eye, and the left one.
    eyes: [[f32; 2]; 2],
}

impl Found {
    /// Where the mesh is to look: upright by the eyes.
    fn square(&self) -> Square {
        let [right, left] = self.eyes;
        let turn = math::atan2(left[1] - right[1], left[0] - right[0]);
        Square { center: self.center, side: AROUND * self.size, turn }
    }
}

/// Centres of the detector's anchors as parts of the square, row by row.
fn anchors() -> impl Iterator<Item = [f32; 2]> {
    [(16, 2), (8, 6)].into_iter().flat_map(|(across, each)| {
        (0..across * across * each).map(move |i| {
            let cell = i / each;
            [cell % across, cell / across].map(|at| (at as f32 + 0.5) / across as f32)
        })
    })
}

fn logistic(x: f32) -> f32 {
    1.0 / (1.0 + math::exp_f32(-x.clamp(-100.0, 100.0)))
}

/// Which part of their union two boxes share: left, top, right, bottom.
fn shared(a: [f32; 4], b: [f32; 4]) -> f32 {
    let side = |axis: usize| (a[2 + axis].min(b[2 + axis]) - a[axis].max(b[axis])).max(0.0);
    let area = |[left, top, right, bottom]: [f32; 4]| (right - left) * (bottom - top);
    let both = side(0) * side(1);
    if both > 0.0 { both / (area(a) + area(b) - both) } else { 0.0 }
}

/// A box and the points, as parts of the square.
fn corners([x, y, width, height, ..]: [f32; TOLD]) -> [f32; 4] {
    [x - 0.5 * width, y - 0.5 * height, x + 0.5 * width, y + 0.5 * height]
}

/// The faces in a square of a picture, surest first.
pub(super) fn detect(detector: &Network, picture: &Picture, square: Square) -> Vec<Found> {
    let [size, ..] = detector.input_shape();
    let told = detector.run(square.sample(picture, size, false, [1.0 / 127.5, -1.0]));
    let [boxes, scores] = &told[..] else { return Vec::new() };
    let unit = 1.0 / size as f32;
    let mut candidates: Vec<(f32, [f32; TOLD])> = Vec::new();
    for ((told, score), anchor) in boxes.as_chunks::<TOLD>().0.iter().zip(scores).zip(anchors()) {
        let score = logistic(*score);
        if score >= SCORE {
            let mut found = told.map(|x| unit * x);
            for (i, x) in found.iter_mut().enumerate() {
                // But the box's size.
                *x += if matches!(i, 2 | 3) { 0.0 } else { anchor[i % 2] };
            }
            candidates.push((score, found));
        }
    }
    candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
    let mut faces = Vec::new();
    while let Some(&(score, best)) = candidates.first() {
        // The mean of all that is of this face, by score.
        let (mut sum, mut weight) = ([0.0; TOLD], 0.0);
        let mut first = true;
        candidates.retain(|(score, found)| {
            let same = first || shared(corners(best), corners(*found)) > SAME;
            first = false;
            if same {
                weight += score;
                for (sum, x) in sum.iter_mut().zip(found) {
                    *sum += score * x;
                }
            }
            !same
        });
        let face = sum.map(|x| x / weight);
        let place = |i: usize| square.place([face[2 * i] - 0.5, face[2 * i + 1] - 0.5]);
        let size = square.side * face[2].max(face[3]);
        faces.push(Found { score, center: place(0), size, eyes: [place(2), place(3)] });
    }
    faces
}

/// Points of the mesh in the picture, pixels, and how sure it is that there is a face, 0 to 1.
pub(super) fn points(network: &Network, picture: &Picture, face: &Found) -> (Vec<[f32; 2]>, f32) {
    let [size, ..] = network.input_shape();
    let square = face.square();
    let told = network.run(square.sample(picture, size, true, [1.0 / 255.0, 0.0]));
    let [points, presence] = &told[..] else { return (Vec::new(), 0.0) };
    let unit = 1.0 / size as f32;
    let place = |[x, y, _]: &[f32; 3]| {
        square.place([x * unit - 0.5, y * unit - 0.5]).map(|coordinate| coordinate - 0.5)
    };
    let presence = presence.first().map_or(0.0, |x| logistic(*x));
    (points.as_chunks().0.iter().map(place).collect(), presence)
}
