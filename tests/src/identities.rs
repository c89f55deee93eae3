//! Reads the packed identities and scan truths of `fixtures/face`.
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

use std::io::Read as _;
use std::path::Path;

use flate2::read::ZlibDecoder;

/// A face on the template's topology: vertex order and triangles as in `face/template.ply`.
#[derive(Debug, Clone, PartialEq)]
pub struct Identity {
    /// Positions in millimetres, +y up, +z out of the face, rigidly aligned to the template;
    /// multiples of 0.005 mm, each the nearest `f32`.
    pub points: Vec<[f32; 3]>,
    /// sRGB colours in 0..=1; multiples of 1/255, each the nearest `f32`.
    pub colors: Vec<[f32; 3]>,
}

/// The 60 identities of `face/identities.bin`. They hold other people than the ten scans.
///
/// # Panics
/// Where a file cannot be read or is not whole: a fixture is broken, and no test can go on.
pub fn identities(fixtures_dir: &Path) -> Vec<Identity> {
    let template = Template::read(&fixtures_dir.join("face/template.ply"));
    let path = fixtures_dir.join("face/identities.bin");
    let planes: [Vec<u8>; 3] = inflate(&path, &template);
    let field = template.points.len();
    (0..planes[0].len())
        .step_by(field)
        .map(|at| {
            let color: Vec<u16> = planes[2][at..][..field].iter().map(|&z| z.into()).collect();
            Identity {
                points: template.points(&planes[0][at..], &planes[1][at..]),
                colors: triples(&template.restore(&color, &template.colors), 255.0),
            }
        })
        .collect()
}

/// What the ten scans `face/scans/scan_NN.ply` would be without noise, holes and a topology of
/// their own: the positions of the template's vertices in the scan's place, in millimetres,
/// rounded to 0.005 mm. Element NN belongs to scan NN.
///
/// # Panics
/// As [`identities`].
pub fn scan_truths(fixtures_dir: &Path) -> Vec<Vec<[f32; 3]>> {
    let template = Template::read(&fixtures_dir.join("face/template.ply"));
    let planes: [Vec<u8>; 2] = inflate(&fixtures_dir.join("face/scans/truths.bin"), &template);
    (0..planes[0].len())
        .step_by(template.points.len())
        .map(|at| template.points(&planes[0][at..], &planes[1][at..]))
        .collect()
}

/// The N planes of a packed file, each a whole number of fields of the template's size.
fn inflate<const N: usize>(path: &Path, template: &Template) -> [Vec<u8>; N] {
    let mut bytes = Vec::new();
    ZlibDecoder::new(&read(path)[..])
        .read_to_end(&mut bytes)
        .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let (length, step) = (bytes.len(), N * template.points.len());
    assert!(
        length.is_multiple_of(step),
        "{}: inflates to {length} bytes, expected a multiple of {step}",
        path.display()
    );
    std::array::from_fn(|k| bytes[k * length / N..][..length / N].to_vec())
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
    /// Reads only the one form of PLY that `template.ply` has (f32 x y z, u8 red green blue;
    /// u8 count, i32 indices; little-endian), so that tests of the project's own reader may
    /// use these faces.
    fn read(path: &Path) -> Self {
        const END: &[u8] = b"end_header\n";
        let data = read(path);
        let name = path.display();
        let end = data
            .windows(END.len())
            .position(|window| window == END)
            .unwrap_or_else(|| panic!("{name}: no end_header"));
        let header = String::from_utf8_lossy(&data[..end]);
        let count = |element: &str| -> usize {
            let line = header.lines().find_map(|line| line.strip_prefix(element));
            line.and_then(|count| count.trim().parse().ok())
                .unwrap_or_else(|| panic!("{name}: no count in a header line {element:?}"))
        };
        let (vertices, faces) = (count("element vertex"), count("element face"));
        let body = &data[end + END.len()..];
        let (found, expected) = (body.len(), 15 * vertices + 13 * faces);
        assert_eq!(found, expected, "{name}: bytes after the header");

        let (vertex_rows, face_rows) = body.split_at(15 * vertices);
        let mut points = Vec::with_capacity(3 * vertices);
        let mut colors = Vec::with_capacity(3 * vertices);
        for row in vertex_rows.chunks_exact(15) {
            for bytes in row[..12].as_chunks().0 {
                points.push((200.0 * f64::from(f32::from_le_bytes(*bytes)) + 0.5).floor() as i32);
            }
            colors.extend(row[12..].iter().map(|&byte| i32::from(byte)));
        }
        let mut near = vec![Vec::new(); vertices];
        for row in face_rows.chunks_exact(13) {
            let corners = row[1..].as_chunks().0.iter().map(|&bytes| u32::from_le_bytes(bytes));
            let corners: Vec<usize> = corners.map(|corner| corner as usize).collect();
            for (k, &corner) in corners.iter().enumerate() {
                near[corner].extend([corners[(k + 1) % 3], corners[(k + 2) % 3]]);
            }
        }
        Self { points, colors, walk: walk(near) }
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

fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
