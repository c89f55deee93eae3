//! Where a texture's colours lie on the surface: at its pixels, or at the vertices.

use super::unwrap::unwrap;
use crate::photo::picture::Picture;

/// Places on a surface that get colours.
pub(super) enum Canvas {
    /// The pixels of a square picture.
    Texels {
        side: usize,
        uvs: Vec<[f32; 2]>,
        /// Of each pixel the triangle there, `NONE` off the surface, and the weights of its second and
        /// third corner.
        places: Vec<(u32, [f32; 2])>,
    },
    /// The vertices, so many.
    Vertices(usize),
}

const NONE: u32 = u32::MAX;

/// Of every place a colour and a weight.
pub(super) type Layer = Vec<[f32; 4]>;

impl Canvas {
    /// The pixels of a texture for a surface that can be laid flat; else the vertices.
    pub(super) fn new(points: &[[f32; 3]], triangles: &[[u32; 3]], side: usize) -> Self {
        let Some(uvs) = unwrap(points, triangles) else { return Self::Vertices(points.len()) };
        let mut places = vec![(NONE, [0.0; 2]); side * side];
        for (number, t) in triangles.iter().enumerate() {
            let [a, b, c] = t.map(|i| pixel(uvs[i as usize], side));
            let edge = |p: [f32; 2], q: [f32; 2], r: [f32; 2]| {
                (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
            };
            let whole = edge(a, b, c);
            let range = |k: usize| {
                let (low, high) = (a[k].min(b[k]).min(c[k]), a[k].max(b[k]).max(c[k]));
                low.ceil().max(0.0) as usize..=(high.floor() as usize).min(side - 1)
            };
            for y in range(1) {
                for x in range(0) {
                    let p = [x as f32, y as f32];
                    let [second, third] = [edge(c, a, p) / whole, edge(a, b, p) / whole];
                    if second >= 0.0 && third >= 0.0 && second + third <= 1.0 {
                        places[y * side + x] = (number as u32, [second, third]);
                    }
                }
            }
        }
        Self::Texels { side, uvs, places }
    }

    /// A layer: of every place what `of` says of its number, its triangle's corners and their weights; off
    /// the surface nothing.
    pub(super) fn layer(
        &self,
        triangles: &[[u32; 3]],
        of: &mut dyn FnMut(usize, [u32; 3], [f32; 3]) -> [f32; 4],
    ) -> Layer {
        match self {
            Self::Texels { places, .. } => places
                .iter()
                .enumerate()
                .map(|(place, &(number, [v, w]))| match triangles.get(number as usize) {
                    Some(&corners) => of(place, corners, [1.0 - v - w, v, w]),
                    None => [0.0; 4],
                })
                .collect(),
            Self::Vertices(count) => {
                (0..*count).map(|i| of(i, [i as u32; 3], [1.0, 0.0, 0.0])).collect()
            }
        }
    }

    /// A layer's means about the vertices, weighted, and their mean weights.
    pub(super) fn at_vertices(
        &self,
        layer: &Layer,
        vertices: usize,
        triangles: &[[u32; 3]],
    ) -> Layer {
        let Self::Texels { places, .. } = self else { return layer.clone() };
        // Colour times weight, weight, share.
        let mut sums = vec![[0.0_f32; 5]; vertices];
        for (&(number, [v, w]), &[r, g, b, weight]) in places.iter().zip(layer) {
            let Some(corners) = triangles.get(number as usize) else { continue };
            for (&i, share) in corners.iter().zip([1.0 - v - w, v, w]) {
                let sum = &mut sums[i as usize];
                let part = share * weight;
                for (sum, value) in sum.iter_mut().zip([part * r, part * g, part * b, part, share])
                {
                    *sum += value;
                }
            }
        }
        let mean = |[r, g, b, weight, share]: [f32; 5]| {
            if weight > 0.0 {
                [r / weight, g / weight, b / weight, weight / share]
            } else {
                [0.0; 4]
            }
        };
        sums.into_iter().map(mean).collect()
    }

    /// The layer that shows everywhere what this one has at the mirror image; nothing where there is none.
    pub(super) fn mirrored(
        &self,
        layer: &Layer,
        triangles: &[[u32; 3]],
        counterparts: &[Option<u32>],
    ) -> Layer {
        match self {
            Self::Vertices(_) => counterparts
                .iter()
                .map(|image| image.map_or([0.0; 4], |i| layer[i as usize]))
                .collect(),
            Self::Texels { side, uvs, .. } => self.layer(triangles, &mut |_, corners, weights| {
                let mut at = [0.0; 2];
                for (i, weight) in corners.into_iter().zip(weights) {
                    let Some(image) = counterparts[i as usize] else { return [0.0; 4] };
                    let uv = uvs[image as usize];
                    at = [at[0] + weight * uv[0], at[1] + weight * uv[1]];
                }
                let sum = between([*side; 2], pixel(at, *side), &|i| {
                    let [r, g, b, weight] = layer[i];
                    [weight * r, weight * g, weight * b, weight]
                });
                let [r, g, b, weight] = sum;
                if weight > 0.0 { [r / weight, g / weight, b / weight, weight] } else { [0.0; 4] }
            }),
        }
    }

    /// The picture of a layer, continued beyond the surface, and the texture coordinates; of vertices
    /// nothing.
    pub(super) fn picture(&self, layer: &Layer) -> Option<(Picture, &[[f32; 2]])> {
        let Self::Texels { side, uvs, places } = self else { return None };
        let mut pixels: Vec<[f32; 4]> = layer
            .iter()
            .zip(places)
            .map(
                |(&[r, g, b, _], (number, _))| {
                    if *number == NONE { [0.0; 4] } else { [r, g, b, 1.0] }
                },
            )
            .collect();
        fill(&mut pixels, *side);
        let colors: Vec<[f32; 3]> = pixels.into_iter().map(|[r, g, b, _]| [r, g, b]).collect();
        let side = *side as u32;
        Some((Picture::from_unit(side, side, &colors), uvs))
    }
}

/// Where texture coordinates are among the centres of pixels.
pub(super) fn pixel(uv: [f32; 2], side: usize) -> [f32; 2] {
    uv.map(|t| t * side as f32 - 0.5)
}

/// Linearly between the four pixels around a place of a picture, whose border goes on beyond it.
pub(super) fn between(
    [width, height]: [usize; 2],
    at: [f32; 2],
    pixel: &dyn Fn(usize) -> [f32; 4],
) -> [f32; 4] {
    // The casts saturate, and make 0 of what is no number.
    let tap = |t: f32, side: usize| {
        let first = (t as usize).min(side - 1);
        (first, (first + 1).min(side - 1), (t - first as f32).clamp(0.0, 1.0))
    };
    let ((left, right, s), (top, below, t)) = (tap(at[0], width), tap(at[1], height));
    let [a, b] = [left, right].map(|x| pixel(top * width + x));
    let [c, d] = [left, right].map(|x| pixel(below * width + x));
    std::array::from_fn(|i| {
        let (above, under) = (a[i] + s * (b[i] - a[i]), c[i] + s * (d[i] - c[i]));
        above + t * (under - above)
    })
}

/// Colours for the pixels without one (weight 0): those of ever coarser pictures.
fn fill(pixels: &mut [[f32; 4]], side: usize) {
    if side < 2 {
        return;
    }
    let half = side.div_ceil(2);
    let mut coarse = vec![[0.0_f32; 4]; half * half];
    for (i, &[r, g, b, weight]) in pixels.iter().enumerate() {
        let sum = &mut coarse[i / side / 2 * half + i % side / 2];
        *sum = [sum[0] + weight * r, sum[1] + weight * g, sum[2] + weight * b, sum[3] + weight];
    }
    for [r, g, b, weight] in &mut coarse {
        if *weight > 0.0 {
            [*r, *g, *b, *weight] = [*r / *weight, *g / *weight, *b / *weight, 1.0];
        }
    }
    fill(&mut coarse, half);
    for (i, pixel) in pixels.iter_mut().enumerate() {
        if pixel[3] == 0.0 {
            let [r, g, b, _] = coarse[i / side / 2 * half + i % side / 2];
            *pixel = [r, g, b, 1.0];
        }
    }
}
