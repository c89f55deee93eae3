//! Z-buffered, perspective-correct rasterization of small triangles.
//!
//! The triangles of a face in a 256-pixel picture cover one or two pixels each, so the work is in
//! the set-up, not in the filling, and branches that nobody can predict cost more than the
//! arithmetic between them. Hence two passes over `CHUNK` triangles at a time: the first finds,
//! without branches and so many triangles abreast as the processor has lanes, which of the 4×4
//! pixels from a triangle's top left corner on it covers; the second visits the covered pixels.
//! The few triangles that need more than 4×4 pixels, or that leave the picture, are filled one
//! by one.
//!
//! Visible surfaces are kept as (triangle, parts of its corners) per pixel and not as colours, so
//! that new colours need no new rasterization.
//!
//! There are no cracks: window coordinates lie on a 1/256 grid, so differences of coordinates are
//! exact, and of two edge functions with a common edge one subtracts the very products that the
//! other subtracts the other way round. Their signs are opposite, or both are zero and inside.

use crate::lanes::{LANES, chunks};
use crate::math::{self, less, more};
use crate::memory::Carver;
use crate::mesh::{self, CHUNK, Index};
use crate::model::{MAX_TRIANGLES, Triangles};
use core::ops::Range;

/// A triangle at a pixel: the inverse distance of its surface there, the parts of it that come
/// from the second and the third corner, and the triangle's number. A corner's part is its
/// window-space weight times its inverse distance; over the whole it is the perspective-correct
/// weight. The first three are linear in the window and the last is constant, so the way from
/// pixel to pixel is one multiplication and addition of four lanes, and what it ends in is what
/// the frame keeps.
type Pixel = [f32; 4];

/// A pixel where nothing is visible: infinitely far.
const EMPTY: Pixel = [0.0; 4];

/// Added to a triangle's index it gives its number: a float whose low bits are the index.
const NUMBER: u32 = 8_388_608.0_f32.to_bits();

// The indices a number has room for.
const _: () = assert!(MAX_TRIANGLES <= 1 << 23);

/// [`LANES`] pixels of a row.
pub type Visible = [Pixel; LANES];

/// What is visible at every pixel.
pub struct Frame<'w> {
    width: usize,
    height: usize,
    /// Chunks of pixels per row.
    stride: usize,
    pixels: &'w mut [Visible],
    /// Bit `l` says whether pixel `l` of a chunk is covered.
    covered: &'w mut [u32],
    /// Rows and columns that may be covered.
    rows: Range<usize>,
    columns: Range<usize>,
}

/// Words of memory a [`Frame`] needs.
pub const fn frame_words(width: usize, height: usize) -> usize {
    (4 * LANES + 1) * chunks(width, height)
}

/// What is visible at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Index of the triangle.
    pub triangle: usize,
    /// Perspective-correct weights of its second and third corner.
    pub weights: [f32; 2],
}

/// Index of a pixel's triangle, and the perspective-correct weights of its second and third corner.
#[inline(always)]
pub fn triangle([inverse, second, third, number]: Pixel) -> (usize, [f32; 2]) {
    let k = 1.0 / inverse;
    (number.to_bits().wrapping_sub(NUMBER) as usize, [second * k, third * k])
}

impl<'w> Frame<'w> {
    /// Takes a frame's memory; `None` if there is too little. Nothing is visible in it.
    pub fn carve(carver: &mut Carver<'w>, width: usize, height: usize) -> Option<Self> {
        let count = chunks(width, height);
        let pixels = carver.quads(LANES * count)?.as_chunks_mut().0;
        let covered = carver.words(count)?;
        pixels.fill([EMPTY; LANES]);
        covered.fill(0);
        Some(Self {
            width,
            height,
            stride: chunks(width, 1),
            pixels,
            covered,
            rows: 0..0,
            columns: 0..0,
        })
    }

    /// Rows that may hold covered pixels.
    pub fn rows(&self) -> Range<usize> {
        self.rows.clone()
    }

    /// Columns that may hold covered pixels.
    pub fn columns(&self) -> Range<usize> {
        self.columns.clone()
    }

    /// Numbers of the chunks of a row that may hold covered pixels: chunk `i` is the pixels
    /// `LANES·i..` of all rows, each row padded to whole chunks.
    #[inline(always)]
    pub fn row(&self, y: usize) -> Range<usize> {
        let first = y * self.stride;
        first + self.columns.start / LANES..first + self.columns.end.div_ceil(LANES)
    }

    /// What is visible at column `x` of row `y`.
    pub fn hit(&self, x: usize, y: usize) -> Option<Hit> {
        let pixel = self.pixels.get(y * self.stride + x / LANES)?[x % LANES];
        let (triangle, weights) = triangle(pixel);
        (x < self.width && pixel != EMPTY).then_some(Hit { triangle, weights })
    }

    /// Which pixels of a chunk are covered, one bit each; none past the end.
    #[inline(always)]
    pub fn covered(&self, index: usize) -> u32 {
        self.covered.get(index).copied().unwrap_or(0)
    }

    /// What is visible at the pixels of a chunk; `None` if nothing is.
    #[inline(always)]
    pub fn chunk(&self, index: usize) -> Option<&Visible> {
        if self.covered(index) == 0 { None } else { self.pixels.get(index) }
    }

    /// The chunks of a row that may hold covered pixels, and which pixels of them are covered.
    #[inline(always)]
    fn chunks(&mut self, y: usize) -> (&mut [Visible], &mut [u32]) {
        let row = self.row(y);
        let pixels = self.pixels.get_mut(row.clone()).unwrap_or_default();
        (pixels, self.covered.get_mut(row).unwrap_or_default())
    }

    /// Forgets everything visible; cost follows what may have been covered.
    #[inline(always)]
    fn clear(&mut self) {
        for y in self.rows() {
            let (pixels, covered) = self.chunks(y);
            pixels.fill([EMPTY; LANES]);
            covered.fill(0);
        }
    }

    /// Notes which pixels are covered.
    #[inline(always)]
    fn note(&mut self) {
        for y in self.rows() {
            let (pixels, covered) = self.chunks(y);
            for (pixels, covered) in pixels.iter().zip(covered) {
                *covered = 0;
                for (l, [inverse, ..]) in pixels.iter().enumerate() {
                    *covered |= u32::from(*inverse > 0.0) << l;
                }
            }
        }
    }

    /// Finds the rows and columns that triangles with these corners may cover.
    #[inline(always)]
    fn bound(&mut self, window: &[[f32; 4]]) {
        let mut low = [f32::INFINITY; 4];
        let mut high = [f32::NEG_INFINITY; 4];
        for corner in window {
            for l in 0..4 {
                // In this order a vertex that is not drawn, NaN, changes nothing.
                low[l] = less(corner[l], low[l]);
                high[l] = more(corner[l], high[l]);
            }
        }
        // Conversions saturate. Without any vertex the range is empty.
        let range = |axis: usize, side: usize| {
            let first = (low[axis] as usize).min(side);
            first..((high[axis] + 1.0) as usize).clamp(first, side)
        };
        self.columns = range(0, self.width);
        self.rows = range(1, self.height);
    }

    /// Draws a triangle at a pixel, unless something nearer is there.
    #[inline(always)]
    fn draw(&mut self, at: usize, triangle: Pixel) {
        if let Some(pixel) = self.pixels.as_flattened_mut().get_mut(at)
            && triangle[0] > pixel[0]
        {
            *pixel = triangle;
        }
    }
}

/// The triangle where its edge functions are `e`, without its number; or its change along the way
/// that changes them by `e`. `z` are the inverse distances of the corners.
#[inline(always)]
fn plane(e: [f32; 3], z: Corners, inverse_area: f32) -> [f32; 3] {
    let w = [e[0] * z[0], e[1] * z[1], e[2] * z[2]];
    [(w[0] + w[1] + w[2]) * inverse_area, w[1] * inverse_area, w[2] * inverse_area]
}

/// The number of a triangle.
#[inline(always)]
fn number(triangle: u32) -> f32 {
    f32::from_bits(NUMBER.wrapping_add(triangle))
}

/// Fills `frame` with what is visible of the triangles. `window` is [`super::project::project`]'s.
///
/// A pixel belongs to a triangle if its three edge functions at the pixel's integer coordinates
/// are not negative (edges inclusive); of several the nearest wins. Back faces, triangles with a
/// corner before the near plane and triangles without area are skipped.
#[inline(always)]
pub fn rasterize(triangles: Triangles<'_>, window: &[[f32; 4]], frame: &mut Frame<'_>) {
    frame.clear();
    frame.bound(window);
    match triangles {
        Triangles::U16(t) => draw(t, window, frame),
        Triangles::U32(t) => draw(t, window, frame),
    }
    frame.note();
}

/// One number of each corner of a triangle.
type Corners = [f32; 3];

/// Twice the areas of the triangles that a point makes with the edges opposite each corner. Not
/// negative inside of a front face: counter-clockwise for a viewer, in a window whose y is down.
#[inline(always)]
fn edges([px, qx, rx]: Corners, [py, qy, ry]: Corners, [x, y]: [f32; 2]) -> [f32; 3] {
    let [px, qx, rx] = [px - x, qx - x, rx - x];
    let [py, qy, ry] = [py - y, qy - y, ry - y];
    [qy * rx - qx * ry, ry * px - rx * py, py * qx - px * qy]
}

/// Triangles whose pixels one loop visits: its end, which is a surprise, comes once for them all.
const GROUP: usize = 4;
/// Pixels along each side of what a small triangle may cover.
const SIDE: usize = 4;
/// One bit per pixel, so that a group's fit into one word.
const PIXELS: usize = SIDE * SIDE;

/// Adding this to a small number rounds it to a whole one, left in the low bits of the sum.
const WHOLE: f32 = 12_582_912.0;
/// A number on the 1/256 grid plus this rounds to the next whole number not below it.
const ALMOST_HALF: f32 = 0.5 - 1.0 / 512.0;

/// The first pass's input and results, one triangle per lane.
struct Chunk {
    /// Window coordinates and inverse distances, `[corner][triangle]`.
    x: mesh::Corners,
    y: mesh::Corners,
    z: mesh::Corners,
    /// The first pixel of those a small triangle may cover; the triangle there, and how it
    /// changes to the right and down.
    pixel: [u32; CHUNK],
    first: [Pixel; CHUNK],
    right: [Pixel; CHUNK],
    down: [Pixel; CHUNK],
    /// Pixels that a small triangle covers: bit `SIDE·row + column`.
    covered: [u32; CHUNK],
    /// Not 0 for triangles that may be visible and are not small.
    large: [u32; CHUNK],
}

/// The way from a small triangle's first pixel to another.
struct Step {
    /// Columns and rows, in every lane.
    x: Pixel,
    y: Pixel,
    pixels: u32,
}

#[inline(always)]
fn draw<I: Index>(triangles: &[[I; 3]], window: &[[f32; 4]], frame: &mut Frame<'_>) {
    let steps: [Step; PIXELS] = core::array::from_fn(|bit| {
        let (x, y) = (bit % SIDE, bit / SIDE);
        Step { x: [x as f32; 4], y: [y as f32; 4], pixels: (y * LANES * frame.stride + x) as u32 }
    });
    let mut chunk = Chunk {
        x: [[0.0; CHUNK]; 3],
        y: [[0.0; CHUNK]; 3],
        z: [[0.0; CHUNK]; 3],
        pixel: [0; CHUNK],
        first: [[0.0; 4]; CHUNK],
        right: [[0.0; 4]; CHUNK],
        down: [[0.0; 4]; CHUNK],
        covered: [0; CHUNK],
        large: [0; CHUNK],
    };
    for (i, triangles) in mesh::Chunks::new(triangles).iter().enumerate() {
        chunk.draw((CHUNK * i) as u32, triangles, window, &steps, frame);
    }
}

impl Chunk {
    /// Draws triangles, the first of which has the index `first`.
    #[inline(always)]
    fn draw<I: Index>(
        &mut self,
        first: u32,
        triangles: &[[I; 3]; CHUNK],
        window: &[[f32; 4]],
        steps: &[Step; PIXELS],
        frame: &mut Frame<'_>,
    ) {
        mesh::gather(triangles, window, [&mut self.x, &mut self.y, &mut self.z]);
        let any_large = self.cover(first, frame);
        for (group, &covered) in self.covered.as_chunks::<GROUP>().0.iter().enumerate() {
            let [a, b, c, d] = covered.map(u64::from);
            let mut rest = a | b << PIXELS | c << (2 * PIXELS) | d << (3 * PIXELS);
            while rest != 0 {
                let bit = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                // Below CHUNK anyway: the remainder spares four checks.
                let t = (GROUP * group + bit / PIXELS) % CHUNK;
                let step = &steps[bit % PIXELS];
                let (start, right, down) = (self.first[t], self.right[t], self.down[t]);
                let mut pixel = EMPTY;
                for l in 0..pixel.len() {
                    pixel[l] = start[l] + step.x[l] * right[l] + step.y[l] * down[l];
                }
                frame.draw(self.pixel[t].wrapping_add(step.pixels) as usize, pixel);
            }
        }
        if any_large {
            for (t, &large) in self.large.iter().enumerate() {
                if large != 0 {
                    draw_large(first + t as u32, self.corners(t), frame);
                }
            }
        }
    }

    /// x, y and inverse distance of a triangle's corners.
    #[inline(always)]
    fn corners(&self, t: usize) -> [Corners; 3] {
        let (Self { x, y, z, .. }, t) = (self, t % CHUNK);
        [[x[0][t], x[1][t], x[2][t]], [y[0][t], y[1][t], y[2][t]], [z[0][t], z[1][t], z[2][t]]]
    }

    /// First pass: fills the results. `first` is the first triangle's index. Tells whether any
    /// triangle is large.
    ///
    /// One loop without branches, calls or exits, so that it is compiled for several lanes.
    #[inline(always)]
    fn cover(&mut self, first: u32, frame: &Frame<'_>) -> bool {
        let stride = (LANES * frame.stride) as u32;
        let (width, height) = (frame.width as f32, frame.height as f32);
        let mut any_large = 0;
        for t in 0..CHUNK {
            let [px, qx, rx] = [self.x[0][t], self.x[1][t], self.x[2][t]];
            let [py, qy, ry] = [self.y[0][t], self.y[1][t], self.y[2][t]];
            let (x0, x1) = (less(less(px, qx), rx), more(more(px, qx), rx));
            let (y0, y1) = (less(less(py, qy), ry), more(more(py, qy), ry));

            // First column and row: rounded up.
            let column = x0 + ALMOST_HALF + WHOLE;
            let row = y0 + ALMOST_HALF + WHOLE;
            let (left, top) = (column - WHOLE, row - WHOLE);
            let whole = |x: f32| x.to_bits().wrapping_sub(WHOLE.to_bits());
            self.pixel[t] = whole(row).wrapping_mul(stride).wrapping_add(whole(column));

            // How the edge functions change to the right and down.
            let right = [ry - qy, py - ry, qy - py];
            let down = [qx - rx, rx - px, px - qx];
            let area = right[2] * down[1] - right[1] * down[2];
            let front = if area > 0.0 { u32::MAX } else { 0 };
            let side = SIDE as f32;
            let small = (x0 >= 0.0)
                & (y0 >= 0.0)
                & (x1 < width)
                & (y1 < height)
                & (x1 < left + side)
                & (y1 < top + side);
            let small = if small { u32::MAX } else { 0 };
            let large = front & !small;
            self.large[t] = large;
            any_large |= large;

            // On the grid these small sums are exact: they equal `edges` at the other pixels.
            let e0 = edges([px, qx, rx], [py, qy, ry], [left, top]);
            let e1 = sum(e0, down);
            let e2 = sum(e1, down);
            let e3 = sum(e2, down);
            let covered = cover_row(e0, right)
                | cover_row(e1, right) << SIDE
                | cover_row(e2, right) << (2 * SIDE)
                | cover_row(e3, right) << (3 * SIDE);
            self.covered[t] = covered & front & small;

            let z = [self.z[0][t], self.z[1][t], self.z[2][t]];
            let inverse_area = 1.0 / area;
            let [start, right, down] = [e0, right, down].map(|e| plane(e, z, inverse_area));
            self.first[t] = [start[0], start[1], start[2], number(first + t as u32)];
            self.right[t] = [right[0], right[1], right[2], 0.0];
            self.down[t] = [down[0], down[1], down[2], 0.0];
        }
        any_large != 0
    }
}

#[inline(always)]
fn sum(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// Which of a row's [`SIDE`] pixels a triangle covers, one bit each; `e` are its edge functions at
/// the first pixel.
#[inline(always)]
fn cover_row(e: [f32; 3], right: [f32; 3]) -> u32 {
    let inside = |e: [f32; 3], bit: u32| if less(less(e[0], e[1]), e[2]) >= 0.0 { bit } else { 0 };
    let e1 = sum(e, right);
    let e2 = sum(e1, right);
    let e3 = sum(e2, right);
    inside(e, 1) | inside(e1, 2) | inside(e2, 4) | inside(e3, 8)
}

/// Draws a front face of any size, at any place.
#[inline(always)]
fn draw_large(triangle: u32, [x, y, z]: [Corners; 3], frame: &mut Frame<'_>) {
    let range = |[p, q, r]: Corners, side: usize| {
        // Conversions saturate.
        let first = math::ceil(less(less(p, q), r)).max(0) as usize;
        first..(math::floor(more(more(p, q), r)).saturating_add(1).max(0) as usize).min(side)
    };
    let columns = range(x, frame.width);
    for row in range(y, frame.height) {
        for first in columns.clone().step_by(LANES) {
            let mut covered = 0_u32;
            for l in 0..LANES {
                let e = edges(x, y, [(first + l) as f32, row as f32]);
                let inside = less(less(e[0], e[1]), e[2]) >= 0.0;
                covered |= u32::from(inside & (first + l < columns.end)) << l;
            }
            while covered != 0 {
                let column = first + covered.trailing_zeros() as usize;
                covered &= covered - 1;
                let e = edges(x, y, [column as f32, row as f32]);
                let [inverse, second, third] = plane(e, z, 1.0 / (e[0] + e[1] + e[2]));
                let at = row * LANES * frame.stride + column;
                frame.draw(at, [inverse, second, third, number(triangle)]);
            }
        }
    }
}
