//! Z-buffered, perspective-correct rasterization of small triangles.
//!
//! The triangles of a face in a 256-pixel picture cover one or two pixels each, so the work is in
//! the set-up, not in the filling: one gather per corner, one orientation test (which is the
//! back-face test), a bounding box of pixel centres that is usually 0 to 4 pixels, and plain edge
//! functions. Visible surfaces are kept as (triangle, two weights) per pixel and not as colours,
//! so that new colours need no new rasterization.

use crate::math;
use crate::mesh::Index;
use crate::model::Triangles;
use crate::workspace::Carver;

/// Marks a pixel no triangle covers.
const NONE: u32 = u32::MAX;

/// What is visible at every pixel.
pub struct Frame<'w> {
    width: usize,
    height: usize,
    /// Inverse distance of the visible surface, 0 where nothing is.
    inverse_depth: &'w mut [f32],
    /// Index of the visible triangle, [`NONE`] where nothing is.
    triangle: &'w mut [u32],
    /// Perspective-correct weights of the triangle's second and third corner.
    weights: &'w mut [[f32; 2]],
    /// First and one-past-last row that may be covered.
    rows: [usize; 2],
}

/// Words of memory a [`Frame`] needs.
pub const fn frame_words(width: usize, height: usize) -> usize {
    4 * width * height
}

impl<'w> Frame<'w> {
    /// Takes a frame's memory; `None` if there is too little. Nothing is visible in it.
    pub fn carve(carver: &mut Carver<'w>, width: usize, height: usize) -> Option<Self> {
        let pixels = width * height;
        let inverse_depth = carver.floats(pixels)?;
        let triangle = carver.words(pixels)?;
        let weights = carver.pairs(pixels)?;
        triangle.fill(NONE);
        inverse_depth.fill(0.0);
        Some(Self { width, height, inverse_depth, triangle, weights, rows: [0, 0] })
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Rows that may hold covered pixels.
    pub fn rows(&self) -> core::ops::Range<usize> {
        self.rows[0]..self.rows[1]
    }

    /// The inverse distance at a pixel, 0 where nothing is visible.
    pub fn inverse_depth(&self) -> &[f32] {
        self.inverse_depth
    }

    /// Corners of the visible triangle and the weights of its second and third corner.
    #[inline]
    pub fn hit(&self, triangles: Triangles<'_>, pixel: usize) -> Option<([u32; 3], [f32; 2])> {
        let corners = triangles.get(*self.triangle.get(pixel)? as usize)?;
        Some((corners, *self.weights.get(pixel)?))
    }

    /// Forgets everything visible; cost follows the rows that were covered.
    fn clear(&mut self) {
        let range = self.rows[0] * self.width..self.rows[1] * self.width;
        self.inverse_depth[range.clone()].fill(0.0);
        self.triangle[range].fill(NONE);
        self.rows = [self.height, 0];
    }
}

/// Fills `frame` with what is visible of the triangles. `window` is [`super::project::project`]'s.
///
/// A pixel belongs to a triangle if its three edge functions at the pixel's integer coordinates
/// are not negative (edges inclusive); of several the nearest wins, the first drawn on ties.
/// Back faces, triangles with a corner before the near plane and triangles without area are
/// skipped.
pub fn rasterize(triangles: Triangles<'_>, window: &[[f32; 4]], frame: &mut Frame<'_>) {
    frame.clear();
    if frame.width == 0 || frame.height == 0 {
        frame.rows = [0, 0];
        return;
    }
    match triangles {
        Triangles::U16(t) => draw(t, window, frame),
        Triangles::U32(t) => draw(t, window, frame),
    }
    if frame.rows[0] > frame.rows[1] {
        frame.rows = [0, 0];
    }
}

fn draw<I: Index>(triangles: &[[I; 3]], window: &[[f32; 4]], frame: &mut Frame<'_>) {
    let last = |side: usize| i32::try_from(side - 1).unwrap_or(i32::MAX);
    let (right, bottom) = (last(frame.width), last(frame.height));
    for (id, triangle) in triangles.iter().enumerate() {
        let [p, q, r] = triangle.map(|corner| window[corner.index()]);
        // Twice the signed area, y down: negative is counter-clockwise for a viewer, a front face.
        let area = (q[0] - p[0]) * (r[1] - p[1]) - (r[0] - p[0]) * (q[1] - p[1]);
        let behind = p[2] == 0.0 || q[2] == 0.0 || r[2] == 0.0;
        if !(area < 0.0) || behind {
            continue;
        }
        let x0 = math::ceil(p[0].min(q[0]).min(r[0])).max(0);
        let x1 = math::floor(p[0].max(q[0]).max(r[0])).min(right);
        let y0 = math::ceil(p[1].min(q[1]).min(r[1])).max(0);
        let y1 = math::floor(p[1].max(q[1]).max(r[1])).min(bottom);
        if x0 > x1 || y0 > y1 {
            continue;
        }
        frame.rows[0] = frame.rows[0].min(y0 as usize);
        frame.rows[1] = frame.rows[1].max(y1 as usize + 1);
        let minus_inverse_area = -1.0 / area;
        for y in y0..=y1 {
            let fy = y as f32;
            let row = y as usize * frame.width;
            for x in x0..=x1 {
                let fx = x as f32;
                // Opposite sub-areas; their signs follow the triangle's, hence the flip.
                let ep = (r[0] - q[0]) * (fy - q[1]) - (r[1] - q[1]) * (fx - q[0]);
                let eq = (p[0] - r[0]) * (fy - r[1]) - (p[1] - r[1]) * (fx - r[0]);
                let er = (q[0] - p[0]) * (fy - p[1]) - (q[1] - p[1]) * (fx - p[0]);
                if ep > 0.0 || eq > 0.0 || er > 0.0 {
                    continue;
                }
                // 1/d is linear in the window: its value is also the perspective divisor.
                let (wp, wq, wr) = (-ep * p[2], -eq * q[2], -er * r[2]);
                let sum = wp + wq + wr;
                let inverse_depth = sum * minus_inverse_area;
                let pixel = row + x as usize;
                if inverse_depth > frame.inverse_depth[pixel] {
                    frame.inverse_depth[pixel] = inverse_depth;
                    frame.triangle[pixel] = id as u32;
                    frame.weights[pixel] = [wq / sum, wr / sum];
                }
            }
        }
    }
}
