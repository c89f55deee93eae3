//! Textures of fitted objects, baked from their photos.
//!
//! Where a photo shows the surface, its colours, divided by the fitted light, are an albedo; where it
//! shows only the mirror image, that one's; elsewhere the fit's own. What lies below is brought to the
//! brightness of what lies above before they are blended, so that no border is seen.

mod canvas;
mod mirror;
mod seen;
mod show;
mod smooth;
mod unwrap;

use crate::error::Result;
use crate::mesh::Mesh;
use crate::mesh::skin::{Colors, Skin, Texture};
use crate::vector::length;
use canvas::{Canvas, Layer};
use onescan_core::model::Model;
use onescan_core::scene::Subject;
use seen::Seen;
pub use seen::Shot;
pub use show::show;
use smooth::Smoother;
use std::fmt;

/// What a mesh's colours are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "full", derive(clap::ValueEnum))]
pub enum Kind {
    /// As in the photo, its light included: for viewers that add none.
    #[default]
    Photo,
    /// The photo without its light; for scenes with a light of their own.
    Albedo,
    /// The fitted albedo alone, at the vertices.
    None,
}

impl fmt::Display for Kind {
    /// As the command has it.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Photo => "photo",
            Self::Albedo => "albedo",
            Self::None => "none",
        })
    }
}

/// Sides of a texture, pixels. Chosen, not measured.
const SIDES: [u32; 2] = [512, 2048];

/// The colours of a fitted object. `mesh` is the fit's, `shots` are the photos it was fitted to, of which the
/// first lies on top.
///
/// # Errors
/// A crop that does not fit its photo.
pub fn bake(
    model: &Model<'_>,
    subject: &Subject,
    mesh: &Mesh,
    shots: &[Shot<'_>],
    kind: Kind,
) -> Result<Skin> {
    if shots.is_empty() || kind == Kind::None {
        return Ok(Skin { colors: Colors::Vertices(mesh.colors.clone()), lit: true });
    }
    let mean = crate::render::instance(model, &[], &[]);
    let longer = shots.iter().flat_map(|shot| shot.crop.size).max().unwrap_or(0);
    // A face is some half of the crop across, but its sides lie beside it in a texture.
    let side = (longer - longer / 4).next_power_of_two().clamp(SIDES[0], SIDES[1]);
    let normals = mesh.normals();
    let object = extent(&mean.points);
    let painter = Painter {
        canvas: Canvas::new(&mean.points, &mean.triangles, side as usize),
        smoother: Smoother::new(&mean.points, &mean.triangles, object),
        mesh,
        normals: &normals,
    };
    let mut looks = Vec::new();
    for shot in shots {
        looks.push(Seen::new(model, subject, shot, &normals, object)?);
    }
    let mut layers = looks.iter().map(|seen| painter.seen(seen));
    let mut seen = layers.next().unwrap_or_default();
    for other in layers {
        seen = over(&seen, &painter.matched(other, &seen));
    }
    let ground = painter.layer(|spot| {
        let [r, g, b] = spot.albedo;
        [r, g, b, 1.0]
    });
    let mut whole = over(&seen, &painter.matched(ground, &seen));
    if let Some(counterparts) = mirror::counterparts(&mean.points, &mean.triangles) {
        let image = painter.canvas.mirrored(&seen, &mesh.triangles, &counterparts);
        let image = painter.matched(image, &whole);
        whole = over(&seen, &over(&image, &whole));
    }
    if kind == Kind::Photo
        && let Some(seen) = looks.first()
    {
        whole = painter.layer(|s| {
            let [r, g, b, _] = whole[s.place];
            let [r, g, b] = seen.lamp().color([r, g, b], s.normal);
            [r, g, b, 1.0]
        });
    }
    let lit = kind == Kind::Albedo;
    let colors = match painter.canvas.picture(&whole) {
        Some((picture, uvs)) => Colors::Texture(Texture::new(uvs.to_vec(), picture)?),
        None => Colors::Vertices(
            whole.iter().map(|&[r, g, b, _]| [r, g, b].map(|x| x.clamp(0.0, 1.0))).collect(),
        ),
    };
    Ok(Skin { colors, lit })
}

/// A point of the surface.
struct Spot {
    /// Its number in a layer.
    place: usize,
    point: [f32; 3],
    /// Of unit length.
    normal: [f32; 3],
    albedo: [f32; 3],
}

/// Makes layers of colour over a mesh.
struct Painter<'a> {
    canvas: Canvas,
    smoother: Smoother,
    mesh: &'a Mesh,
    normals: &'a [[f32; 3]],
}

impl Painter<'_> {
    fn layer(&self, mut of: impl FnMut(Spot) -> [f32; 4]) -> Layer {
        self.canvas.layer(&self.mesh.triangles, &mut |place, corners, weights| {
            let mix = |field: &[[f32; 3]]| {
                let [p, q, r] = corners.map(|i| field[i as usize]);
                let [u, v, w] = weights;
                [0, 1, 2].map(|k| u * p[k] + v * q[k] + w * r[k])
            };
            let n = mix(self.normals);
            let length = length(n);
            let normal = if length > 0.0 { n.map(|x| x / length) } else { [0.0, 0.0, 1.0] };
            of(Spot {
                place,
                point: mix(&self.mesh.points),
                normal,
                albedo: mix(&self.mesh.colors),
            })
        })
    }

    fn seen(&self, seen: &Seen) -> Layer {
        self.layer(|spot| seen.look(spot.point, spot.normal))
    }

    /// A layer brought, smoothly, to the brightness of another where both are.
    fn matched(&self, mut layer: Layer, to: &Layer) -> Layer {
        let triangles = &self.mesh.triangles;
        let pairs = layer.iter().zip(to);
        let difference: Layer =
            pairs.map(|(l, t)| [t[0] - l[0], t[1] - l[1], t[2] - l[2], t[3].min(l[3])]).collect();
        let difference = self.canvas.at_vertices(&difference, self.normals.len(), triangles);
        let field = self.smoother.smooth(&difference);
        let add = self.canvas.layer(triangles, &mut |_, corners, weights| {
            let mix = |k: usize| {
                corners.iter().zip(weights).map(|(&i, w)| w * field[i as usize][k]).sum()
            };
            [mix(0), mix(1), mix(2), 0.0]
        });
        for (l, add) in layer.iter_mut().zip(add) {
            for (l, add) in l.iter_mut().zip(add) {
                *l += add;
            }
        }
        layer
    }
}

/// One layer over another.
fn over(over: &Layer, under: &Layer) -> Layer {
    let pairs = over.iter().zip(under);
    let mixed = pairs.map(|(&o, &u)| {
        let rest = (1.0 - o[3]) * u[3];
        let weight = o[3] + rest;
        let mix = |k: usize| (o[3] * o[k] + rest * u[k]) / weight;
        if weight > 0.0 { [mix(0), mix(1), mix(2), weight] } else { [0.0; 4] }
    });
    mixed.collect()
}

/// The longest side of the box around points.
fn extent(points: &[[f32; 3]]) -> f32 {
    let side = |k: usize| {
        let values = points.iter().map(|p| p[k]);
        values.clone().fold(f32::MIN, f32::max) - values.fold(f32::MAX, f32::min)
    };
    side(0).max(side(1)).max(side(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::layout;
    use crate::photo::Crop;
    use crate::photo::picture::Picture;
    use onescan_core::scene::View;

    /// A ball of one albedo, and the skin that a photo of one colour gives it.
    fn ball(kind: Kind) -> (Mesh, Skin) {
        let rings = 24_u32;
        let mut mesh = Mesh { points: vec![[0.0, 50.0, 0.0]], colors: vec![], triangles: vec![] };
        for ring in 1..rings {
            for i in 0..2 * rings {
                let turn = |k: u32| {
                    onescan_core::math::sin_cos(std::f32::consts::PI * k as f32 / rings as f32)
                };
                let ((sin, cos), (x, z)) = (turn(ring), turn(i));
                mesh.points.push([50.0 * sin * x, 50.0 * cos, 50.0 * sin * z]);
            }
        }
        mesh.points.push([0.0, -50.0, 0.0]);
        let last = mesh.points.len() as u32 - 1;
        for i in 0..2 * rings {
            let at = |ring: u32, i: u32| match ring {
                0 => 0,
                ring if ring == rings => last,
                ring => 1 + (ring - 1) * 2 * rings + i % (2 * rings),
            };
            for ring in 0..rings {
                let [a, b, c, d] =
                    [at(ring, i), at(ring + 1, i), at(ring + 1, i + 1), at(ring, i + 1)];
                let both = [[a, b, c], [a, c, d]].into_iter();
                mesh.triangles.extend(both.filter(|[a, b, c]| a != b && b != c && c != a));
            }
        }
        mesh.colors = vec![[0.25; 3]; mesh.points.len()];
        let file = layout::rigid(&mesh, &[]).unwrap();
        let model = file.view();
        let photo = Picture::filled(200, 200, [153; 3]);
        let view = View {
            light: onescan_core::light::ambient_white(),
            ..crate::render::portrait(&model, [200; 2], 0.0, 0.0).view
        };
        let crop = Crop::whole([200; 2]);
        let shot = Shot { photo: &photo, crop, mask: None, hidden: None, view: &view };
        let skin = bake(&model, &Subject::default(), &mesh, &[shot], kind).unwrap();
        (mesh, skin)
    }

    #[test]
    fn a_closed_surface_has_the_photos_colours_at_its_vertices() {
        let (mesh, skin) = ball(Kind::Photo);
        assert!(!skin.lit);
        let Colors::Vertices(colors) = skin.colors else { panic!("a ball cannot be laid flat") };
        for ([_, _, z], [r, ..]) in mesh.points.iter().zip(&colors) {
            if *z > 25.0 {
                assert!((r - 0.6).abs() < 0.02, "{z}: seen, {r}");
            }
            // Behind, the photo says nothing of it.
            assert!((0.24..0.62).contains(r), "{z}: {r}");
        }
        let darkest = colors.iter().map(|[r, ..]| *r).fold(1.0, f32::min);
        assert!(darkest < 0.4, "{darkest}");
    }

    #[test]
    fn without_a_photo_the_fitted_albedo_is_left() {
        let (mesh, skin) = ball(Kind::None);
        assert_eq!(skin, Skin { colors: Colors::Vertices(mesh.colors), lit: true });
        assert!(ball(Kind::Albedo).1.lit);
    }
}
