//! Colours of vertices, gathered from the corners that meet there.

use crate::error::{Error, Result};
use crate::files;
use crate::photo;
use crate::photo::picture::Picture;
use std::path::Path;

/// The mean colour of all corners at each vertex: what joins a texture's seams.
pub(super) struct Paint {
    /// Sum of the colours, and their number.
    sums: Vec<[f64; 4]>,
}

impl Paint {
    pub(super) fn new(vertices: usize) -> Self {
        Self { sums: vec![[0.0; 4]; vertices] }
    }

    /// Adds the colour of a corner at a vertex.
    pub(super) fn add(&mut self, vertex: u32, color: [f32; 3]) {
        if let Some([r, g, b, count]) = self.sums.get_mut(vertex as usize) {
            *r += f64::from(color[0]);
            *g += f64::from(color[1]);
            *b += f64::from(color[2]);
            *count += 1.0;
        }
    }

    /// The means; none where no corner was coloured.
    pub(super) fn colors(&self) -> impl Iterator<Item = Option<[f32; 3]>> + '_ {
        self.sums.iter().map(|&[r, g, b, count]| {
            (count > 0.0).then(|| [r, g, b].map(|sum| (sum / count) as f32))
        })
    }
}

/// What textures show between the corners of triangles that these do not have.
#[derive(Default)]
pub(super) struct Lost {
    /// Pixels of the triangles' parts of the textures, all together.
    texels: f64,
    /// Squares of what is missing, times those pixels.
    squares: f64,
    triangles: f64,
}

/// How far colours between vertices may be from those of the texture, of 1, before that is told. Chosen,
/// not measured, as are the next.
const FAR: f64 = 0.05;
/// A texture with fewer pixels to a triangle has little that vertices have not.
const FEW: f64 = 4.0;
/// Triangles that are still worked with easily.
const MANY: f64 = 400_000.0;

impl Lost {
    /// The colours of a triangle's corners.
    pub(super) fn read(
        &mut self,
        picture: &Picture,
        uvs: [[f32; 2]; 3],
        wrap: [Wrap; 2],
    ) -> [[f32; 3]; 3] {
        /// Places between the corners: the middle, and halfway to it from each.
        const PLACES: [[f32; 3]; 4] =
            [[1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0], [0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5]];
        let corners = uvs.map(|uv| sample(picture, uv, wrap));
        let mix = |values: [f32; 3], weights: [f32; 3]| -> f32 {
            values.iter().zip(weights).map(|(x, w)| w * x).sum()
        };
        let apart = PLACES.map(|w| {
            let uv = [0, 1].map(|i| mix(uvs.map(|uv| uv[i]), w));
            let there = sample(picture, uv, wrap);
            (0..3).map(|i| f64::from(there[i] - mix(corners.map(|c| c[i]), w)).powi(2)).sum::<f64>()
        });
        let [[a, b], [c, d]] = [1, 2].map(|k| {
            [0, 1].map(|i| {
                f64::from(uvs[k][i] - uvs[0][i]) * f64::from([picture.width, picture.height][i])
            })
        });
        let texels = 0.5 * (a * d - b * c).abs();
        if texels.is_finite() {
            self.texels += texels;
            // Of three channels at four places.
            self.squares += texels * apart.iter().sum::<f64>() / 12.0;
            self.triangles += 1.0;
        }
        corners
    }

    /// What to say of it, of a mesh with so many triangles; nothing if little is missing.
    pub(super) fn note(&self, triangles: usize) -> Option<String> {
        let each = self.texels / self.triangles;
        let error = (self.squares / self.texels).sqrt();
        // Not a number without textures.
        if !(each > FEW && error > FAR) {
            return None;
        }
        let wanted = (each / 2.0).log(4.0).ceil();
        let easy = (MANY / triangles as f64).log(4.0).floor();
        let times = wanted.min(easy).max(1.0);
        Some(format!(
            "its texture holds more than its vertices can: {each:.0} pixels to a triangle, and colours \
             between vertices are off by {:.0} % (root mean square); --subdivide {times} keeps more of it",
            100.0 * error
        ))
    }
}

/// What lies beyond the border of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Wrap {
    Repeat,
    Mirror,
    Clamp,
}

impl Wrap {
    /// A coordinate brought into `[0, 1]`; those that lie there stay.
    fn fold(self, t: f64) -> f64 {
        match self {
            _ if (0.0..=1.0).contains(&t) => t,
            Self::Repeat => t - t.floor(),
            Self::Mirror => 1.0 - (t.rem_euclid(2.0) - 1.0).abs(),
            Self::Clamp => t.clamp(0.0, 1.0),
        }
    }
}

/// The colour at `(u, v)`, v down, between the four nearest pixels, as stored in `[0, 1]`. At the
/// border the outermost pixels go on: the opposite edge of an atlas belongs to another part.
pub(super) fn sample(picture: &Picture, [u, v]: [f32; 2], wrap: [Wrap; 2]) -> [f32; 3] {
    let tap = |t: f32, wrap: Wrap, side: u32| {
        let last = f64::from(side.saturating_sub(1));
        let at = (wrap.fold(t.into()) * f64::from(side) - 0.5).clamp(0.0, last);
        (at.floor() as u32, (at.floor() + 1.0).min(last) as u32, at - at.floor())
    };
    let (left, right, across) = tap(u, wrap[0], picture.width);
    let (top, bottom, down) = tap(v, wrap[1], picture.height);
    let pixel = |x, y| picture.pixel(x, y).unwrap_or_default().map(f64::from);
    let [a, b] = [pixel(left, top), pixel(right, top)];
    let [c, d] = [pixel(left, bottom), pixel(right, bottom)];
    std::array::from_fn(|i| {
        let above = a[i] + across * (b[i] - a[i]);
        let below = c[i] + across * (d[i] - c[i]);
        ((above + down * (below - above)) / 255.0) as f32
    })
}

/// Reads the picture of a texture.
///
/// # Errors
/// A file that cannot be read, and those of [`photo::decode_stored`]; they name the file.
pub(super) fn texture(path: &Path) -> Result<Picture> {
    let bytes = files::read(path).map_err(|e| {
        Error::file(path, format_args!("{e}; put the texture there or give one by --texture"))
    })?;
    photo::decode_stored(&bytes).map_err(|e| Error::file(path, e))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLAMP: [Wrap; 2] = [Wrap::Clamp; 2];

    #[test]
    fn pixels_are_met_at_their_centres_and_mixed_between() {
        let picture = Picture::from_fn(2, 2, |x, y| [255 * x as u8, 255 * y as u8, 51]);
        assert_eq!(sample(&picture, [0.25, 0.25], CLAMP), [0.0, 0.0, 0.2]);
        assert_eq!(sample(&picture, [0.75, 0.25], CLAMP), [1.0, 0.0, 0.2]);
        assert_eq!(sample(&picture, [0.5, 0.75], CLAMP), [0.5, 1.0, 0.2]);
        assert_eq!(sample(&picture, [1.0, 0.0], [Wrap::Repeat; 2]), [1.0, 0.0, 0.2]);
    }

    #[test]
    fn beyond_the_border_a_texture_wraps_as_it_says() {
        let picture = Picture::from_fn(4, 1, |x, _| [[0, 51, 102, 255][x as usize]; 3]);
        let red = |u, wrap| sample(&picture, [u, 0.5], [wrap, Wrap::Clamp])[0];
        assert_eq!(red(1.125, Wrap::Repeat), 0.0);
        assert_eq!(red(-0.125, Wrap::Repeat), 1.0);
        assert_eq!(red(1.125, Wrap::Mirror), 1.0);
        assert_eq!(red(2.375, Wrap::Mirror), 0.2);
        assert_eq!(red(7.0, Wrap::Clamp), 1.0);
        for wild in [f32::NAN, f32::INFINITY, f32::MIN] {
            for wrap in [Wrap::Repeat, Wrap::Mirror, Wrap::Clamp] {
                red(wild, wrap);
            }
        }
    }

    #[test]
    fn corners_that_meet_are_averaged() {
        let mut paint = Paint::new(3);
        paint.add(0, [1.0, 0.0, 0.5]);
        paint.add(0, [0.0, 0.0, 0.5]);
        paint.add(2, [0.2; 3]);
        let colors: Vec<_> = paint.colors().collect();
        assert_eq!(colors, [Some([0.5, 0.0, 0.5]), None, Some([0.2; 3])]);
    }
}
