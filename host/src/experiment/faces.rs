//! The faces of `fixtures/face` as meshes on the template's topology: 60 identities, and the true
//! surfaces of ten scans of other people. Both are packed.
//!
//! Layout, all bytes being one zlib stream of planes, each of N·3·V bytes ordered by face, axis,
//! and place in the walk over the template (N faces, V vertices):
//!
//! ```text
//! plane 0, 1   low and high bytes of the position residuals, units of 0.005 mm
//! plane 2      residuals of the 8-bit sRGB colours (identities only)
//! ```
//!
//! With q a quantised position or a colour, t the template's, and d = q − t:
//!
//! ```text
//! r[v] = d[v] − ⌊mean of d[u] over the neighbours u of v that come before v in the walk⌋
//! z[v] = 2r for r ≥ 0, −2r − 1 for r < 0         (what the planes hold)
//! t    = ⌊200 p + ½⌋ in f64, p the template's f32 coordinate; or its colour byte
//! ```
//!
//! `fixtures/encode_identities.py` writes it.

use crate::demo;
use crate::error::{Error, Result};
use crate::files;
use crate::mesh::Mesh;
use crate::mesh::ply;
use crate::scan::rigid::Rigid;
use crate::scan::surface::Surface;
use flate2::read::ZlibDecoder;
use std::io::Read as _;
use std::path::Path;

/// A face on the template's topology: vertex order and triangles as in `face/template.ply`.
#[derive(Debug, Clone, PartialEq)]
pub struct Identity {
    /// Positions in millimetres, +y up, +z out of the face, rigidly aligned to the template;
    /// multiples of 0.005 mm, each the nearest `f32`.
    pub points: Vec<[f32; 3]>,
    /// sRGB colours in 0..=1; multiples of 1/255, each the nearest `f32`.
    pub colors: Vec<[f32; 3]>,
}

impl Identity {
    /// The face as a mesh.
    fn mesh(self, triangles: &[[u32; 3]]) -> Mesh {
        Mesh { points: self.points, colors: self.colors, triangles: triangles.to_vec() }
    }
}

/// The 60 identities of `face/identities.bin` in the directory of fixtures. They hold other people
/// than the ten scans.
///
/// # Errors
/// A file that cannot be read or is not whole.
pub fn identities(fixtures: &Path) -> Result<Vec<Identity>> {
    let template = Template::new()?;
    let path = fixtures.join("face/identities.bin");
    let planes: [Vec<u8>; 3] = inflate(&path, &template)?;
    let field = template.points.len();
    Ok((0..planes[0].len())
        .step_by(field)
        .map(|at| {
            let color: Vec<u16> = planes[2][at..][..field].iter().map(|&z| z.into()).collect();
            Identity {
                points: template.points(&planes[0][at..], &planes[1][at..]),
                colors: triples(&template.restore(&color, &template.colors), 255.0),
            }
        })
        .collect())
}

/// [`identities`] as meshes.
///
/// # Errors
/// See [`identities`].
pub fn identity_meshes(fixtures: &Path) -> Result<Vec<Mesh>> {
    let (template, _) = demo::template()?;
    Ok(identities(fixtures)?.into_iter().map(|face| face.mesh(&template.triangles)).collect())
}

/// What the ten scans `face/scans/scan_NN.ply` would be without noise, holes and a topology of
/// their own: the positions of the template's vertices in the scan's place, in millimetres,
/// rounded to 0.005 mm. Element NN belongs to scan NN.
///
/// # Errors
/// A file that cannot be read or is not whole.
pub fn scan_truths(fixtures: &Path) -> Result<Vec<Vec<[f32; 3]>>> {
    let template = Template::new()?;
    let planes: [Vec<u8>; 2] = inflate(&fixtures.join("face/scans/truths.bin"), &template)?;
    Ok((0..planes[0].len())
        .step_by(template.points.len())
        .map(|at| template.points(&planes[0][at..], &planes[1][at..]))
        .collect())
}

/// The people of the ten scans on the template's topology and in its place (rigidly aligned, not
/// scaled). Positions are the true ones; a colour is that of the scan's nearest point, which in a
/// hole is on its rim.
///
/// # Errors
/// See [`scan_truths`] and [`ply::read`].
pub fn scan_meshes(fixtures: &Path) -> Result<Vec<Mesh>> {
    let (template, _) = demo::template()?;
    scan_truths(fixtures)?
        .into_iter()
        .enumerate()
        .map(|(number, truth)| {
            let path = fixtures.join(format!("face/scans/scan_{number:02}.ply"));
            let scan = ply::read(&path)?;
            let surface = Surface::new(&scan);
            let nearest = |p: &[f32; 3]| surface.nearest(p.map(f64::from));
            let colors = truth.iter().map(|p| nearest(p).interpolate(&scan.colors)).collect();
            let home = Rigid::between(&truth, &template.points)
                .ok_or_else(|| Error::file(&path, "its true surface cannot be aligned"))?;
            Ok(Mesh {
                points: truth.iter().map(|&p| home.apply(p)).collect(),
                colors,
                triangles: template.triangles.clone(),
            })
        })
        .collect()
}

/// The N planes of a packed file, each a whole number of fields of the template's size.
fn inflate<const N: usize>(path: &Path, template: &Template) -> Result<[Vec<u8>; N]> {
    let packed = files::read(path).map_err(|e| {
        Error::file(path, format_args!("{e}; give --fixtures, the directory of that name"))
    })?;
    let mut bytes = Vec::new();
    ZlibDecoder::new(&packed[..])
        .read_to_end(&mut bytes)
        .map_err(|e| Error::file(path, format_args!("{e}; the file is damaged")))?;
    let (length, step) = (bytes.len(), N * template.points.len());
    if !length.is_multiple_of(step) {
        return Err(Error::file(
            path,
            format_args!("inflates to {length} bytes, expected a multiple of {step}"),
        ));
    }
    Ok(std::array::from_fn(|k| bytes[k * length / N..][..length / N].to_vec()))
}

/// What the residuals are relative to.
struct Template {
    /// 3·V coordinates in units of 0.005 mm, x y z interleaved.
    points: Vec<i32>,
    /// 3·V sRGB bytes, interleaved.
    colors: Vec<i32>,
    /// Vertices breadth first, each with its neighbours before it.
    walk: Vec<(usize, Vec<usize>)>,
}

impl Template {
    fn new() -> Result<Self> {
        let (mesh, _) = demo::template()?;
        let coordinates = mesh.points.as_flattened().iter();
        let points = coordinates.map(|&p| (200.0 * f64::from(p) + 0.5).floor() as i32).collect();
        let bytes = mesh.colors.as_flattened().iter().map(|c| (255.0 * c).round() as i32);
        let mut near = vec![Vec::new(); mesh.points.len()];
        for triangle in &mesh.triangles {
            let corners = triangle.map(|corner| corner as usize);
            for (k, &corner) in corners.iter().enumerate() {
                near[corner].extend([corners[(k + 1) % 3], corners[(k + 2) % 3]]);
            }
        }
        Ok(Self { points, colors: bytes.collect(), walk: walk(near) })
    }

    /// One face's positions from its low and high bytes, which begin the slices.
    fn points(&self, low: &[u8], high: &[u8]) -> Vec<[f32; 3]> {
        let bytes = low.iter().zip(high).take(self.points.len());
        let stored: Vec<u16> = bytes.map(|(&a, &b)| u16::from_le_bytes([a, b])).collect();
        triples(&self.restore(&stored, &self.points), 200.0)
    }

    /// q from z (3·V, axis by axis along the walk), interleaved like the template's t.
    fn restore(&self, z: &[u16], t: &[i32]) -> Vec<i32> {
        let mut q = t.to_vec();
        for (axis, z) in z.chunks_exact(self.walk.len()).enumerate() {
            let mut d = vec![0_i32; self.walk.len()];
            for (&z, (v, earlier)) in z.iter().zip(&self.walk) {
                let sum: i32 = earlier.iter().map(|&u| d[u]).sum();
                let mean = sum.div_euclid(i32::try_from(earlier.len().max(1)).unwrap_or(i32::MAX));
                let r = i32::from(z >> 1) ^ -i32::from(z & 1);
                d[*v] = mean + r;
                q[3 * v + axis] += d[*v];
            }
        }
        q
    }
}

/// Breadth first from vertex 0, neighbours in ascending order; further components start at their
/// lowest vertex. Each vertex comes with those of its neighbours that come before it.
fn walk(mut near: Vec<Vec<usize>>) -> Vec<(usize, Vec<usize>)> {
    let mut order: Vec<usize> = Vec::with_capacity(near.len());
    let mut place = vec![usize::MAX; near.len()];
    for neighbours in &mut near {
        neighbours.sort_unstable();
        neighbours.dedup();
    }
    for start in 0..near.len() {
        let mut done = order.len();
        if place[start] == usize::MAX {
            place[start] = done;
            order.push(start);
        }
        while done < order.len() {
            for &u in &near[order[done]] {
                if place[u] == usize::MAX {
                    place[u] = order.len();
                    order.push(u);
                }
            }
            done += 1;
        }
    }
    let earlier = |v: usize| near[v].iter().copied().filter(|&u| place[u] < place[v]).collect();
    order.iter().map(|&v| (v, earlier(v))).collect()
}

/// Interleaved integers as triples, each divided by `unit`: correctly rounded, so any reader of
/// the same integers gets the same bits.
fn triples(q: &[i32], unit: f32) -> Vec<[f32; 3]> {
    q.as_chunks().0.iter().map(|triple: &[i32; 3]| triple.map(|q| q as f32 / unit)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scans_come_home_and_keep_their_colours() {
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
        let (template, _) = demo::template().unwrap();
        let [scans, faces] =
            [scan_meshes(&fixtures), identity_meshes(&fixtures)].map(Result::unwrap);
        assert_eq!((scans.len(), faces.len()), (10, 60));
        for mesh in scans.iter().chain(&faces) {
            let far = |a: &[[f32; 3]], b: &[[f32; 3]]| {
                let pairs = a.as_flattened().iter().zip(b.as_flattened());
                let squares: f64 = pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum();
                (squares / a.len() as f64).sqrt()
            };
            let (shape, color) =
                (far(&mesh.points, &template.points), far(&mesh.colors, &template.colors));
            assert!(shape > 1.0 && shape < 9.0, "{shape} mm from the template");
            assert!(color > 0.02 && color < 0.9, "{color} from the template's colours");
        }
    }

    #[test]
    fn a_missing_fixture_is_named() {
        let error = identities(Path::new("/nowhere")).unwrap_err().to_string();
        assert!(error.starts_with("/nowhere/face/identities.bin: "), "{error}");
    }
}
