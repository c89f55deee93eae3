//! A fish and a bird of [`solid`](super::solid)s: the templates, and others of their kind.

use super::solid::{Ellipsoid, Solid};
use crate::mesh::Mesh;
use crate::mesh::landmarks::Landmark;
use onescan_core::rng::Rng;

/// Distance of the grid's points, millimetres.
const SPACING: f64 = 2.6;

/// What is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A surgeonfish, about 25 cm long; its head looks along z.
    Fish,
    /// A standing songbird, 20 cm high.
    Bird,
}

/// One animal: its surface and landmarks.
#[derive(Clone, Debug)]
pub struct Animal {
    /// The surface.
    pub mesh: Mesh,
    /// Named vertices.
    pub landmarks: Vec<Landmark>,
}

/// Where a landmark is: name, part, direction in the part's own axes.
type Anchor = (&'static str, &'static str, [f64; 3]);

/// Those on the plane of symmetry are `center.`, the others come as `left.` and `right.`.
const FISH_ANCHORS: [Anchor; 10] = [
    ("center.mouth", "mouth", [0.0, 0.0, 1.0]),
    ("eye", "eye", [1.0, 0.0, 0.0]),
    ("center.dorsal_fin.front", "dorsal fin", [0.0, 0.4, 1.0]),
    ("center.dorsal_fin.rear", "dorsal fin", [0.0, 0.4, -1.0]),
    ("center.anal_fin.front", "anal fin", [0.0, -0.4, 1.0]),
    ("center.anal_fin.rear", "anal fin", [0.0, -0.4, -1.0]),
    ("center.tail.upper", "upper tail", [0.0, 1.0, 0.0]),
    ("center.tail.lower", "lower tail", [0.0, -1.0, 0.0]),
    ("pectoral_fin", "pectoral fin", [0.3, 0.0, -1.0]),
    ("flank", "body", [1.0, 0.0, 0.0]),
];

const BIRD_ANCHORS: [Anchor; 9] = [
    ("center.beak", "beak", [0.0, 0.0, 1.0]),
    ("eye", "eye", [1.0, 0.0, 0.0]),
    ("center.crown", "head", [0.0, 1.0, 0.0]),
    ("center.breast", "belly", [0.0, 0.0, 1.0]),
    ("center.back", "body", [0.0, 1.0, 0.0]),
    ("center.tail", "tail", [0.0, 0.0, -1.0]),
    ("wing.tip", "wing", [0.0, 0.0, -1.0]),
    ("wing.shoulder", "wing", [0.0, 0.3, 1.0]),
    ("foot", "foot", [0.0, 0.0, 1.0]),
];

impl Kind {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fish => "fish",
            Self::Bird => "bird",
        }
    }

    /// The animal that models are made of.
    pub fn template(self) -> Animal {
        self.animal(&self.solid())
    }

    /// Another one of its kind: proportions and paint at random.
    pub fn specimen(self, rng: &mut Rng) -> Animal {
        let mut solid = self.solid();
        let mut factor =
            |deviation: f32| f64::from(rng.normal_sd(deviation)).clamp(-0.3, 0.3).exp();
        // The same for all parts, and a little for each.
        let whole = [factor(0.06), factor(0.10), factor(0.07)];
        for part in &mut solid.parts {
            for ((centre, radius), whole) in part.centre.iter_mut().zip(&mut part.radii).zip(whole)
            {
                *centre *= whole;
                *radius *= whole * factor(0.04);
            }
        }
        let palette = self.palettes()[rng.below(self.palettes().len() as u32) as usize];
        for part in &mut solid.parts {
            let Some(color) = palette.iter().find(|(name, _)| *name == part.name) else { continue };
            part.color = color.1.map(|c| (c + f64::from(rng.normal_sd(0.02))).clamp(0.02, 0.95));
        }
        solid.bands = if rng.uniform() < 0.3 { 34.0 } else { 0.0 };
        self.animal(&solid)
    }

    fn animal(self, solid: &Solid) -> Animal {
        let mesh = solid.mesh(SPACING);
        let anchors: &[Anchor] = match self {
            Self::Fish => &FISH_ANCHORS,
            Self::Bird => &BIRD_ANCHORS,
        };
        let nearest = |place: [f64; 3]| {
            let squared = |p: &[f32; 3]| -> f64 {
                (0..3).map(|k| (f64::from(p[k]) - place[k]).powi(2)).sum()
            };
            let numbers = 0..mesh.points.len() as u32;
            let by = |a: &u32, b: &u32| {
                squared(&mesh.points[*a as usize]).total_cmp(&squared(&mesh.points[*b as usize]))
            };
            numbers.min_by(by).unwrap_or(0)
        };
        let mut landmarks = Vec::new();
        for (name, part, direction) in anchors {
            let Some(part) = solid.parts.iter().find(|p| p.name == *part) else { continue };
            let mut add = |name: String, side: f64| {
                landmarks.push(Landmark { name, vertex: nearest(part.tip(*direction, side)) });
            };
            if name.starts_with("center.") {
                add((*name).to_string(), 1.0);
            } else {
                add(format!("left.{name}"), 1.0);
                add(format!("right.{name}"), -1.0);
            }
        }
        Animal { mesh, landmarks }
    }

    fn solid(self) -> Solid {
        let part = |name, centre: [f64; 3], radii: [f64; 3], pitch: f64, color: [f64; 3]| {
            Ellipsoid { name, centre, radii, pitch, paired: centre[0] > 0.0, color }
        };
        let parts = match self {
            Self::Fish => {
                let (blue, dark, yellow) =
                    ([0.20, 0.35, 0.62], [0.10, 0.14, 0.28], [0.85, 0.70, 0.15]);
                vec![
                    part("body", [0.0, 0.0, 0.0], [21.0, 46.0, 82.0], 0.0, blue),
                    part("head", [0.0, -6.0, 58.0], [18.0, 32.0, 40.0], -8.0, blue),
                    part("mouth", [0.0, -14.0, 97.0], [6.5, 6.5, 9.0], -8.0, yellow),
                    part("peduncle", [0.0, 0.0, -88.0], [8.0, 12.0, 30.0], 0.0, blue),
                    part("upper tail", [0.0, 23.0, -121.0], [4.6, 34.0, 13.0], 28.0, yellow),
                    part("lower tail", [0.0, -23.0, -121.0], [4.6, 34.0, 13.0], -28.0, yellow),
                    part("dorsal fin", [0.0, 43.0, -18.0], [4.6, 20.0, 68.0], 9.0, dark),
                    part("anal fin", [0.0, -43.0, -24.0], [4.6, 18.0, 58.0], -10.0, dark),
                    part("pectoral fin", [22.0, -10.0, 34.0], [4.6, 9.0, 21.0], 12.0, yellow),
                    part("eye", [16.0, 9.0, 70.0], [4.5, 6.5, 6.5], 0.0, [0.03, 0.03, 0.04]),
                ]
            }
            Self::Bird => {
                let (brown, dark, pale) =
                    ([0.42, 0.30, 0.20], [0.22, 0.15, 0.11], [0.82, 0.74, 0.62]);
                let horn = [0.35, 0.31, 0.26];
                vec![
                    part("body", [0.0, 0.0, 0.0], [34.0, 38.0, 66.0], 36.0, brown),
                    part("belly", [0.0, -8.0, 20.0], [29.0, 36.0, 46.0], 36.0, pale),
                    part("neck", [0.0, 40.0, 44.0], [23.0, 30.0, 26.0], 20.0, brown),
                    part("head", [0.0, 68.0, 56.0], [22.0, 23.0, 26.0], 5.0, brown),
                    part("beak", [0.0, 64.0, 90.0], [5.0, 5.0, 17.0], -6.0, horn),
                    part("tail", [0.0, -54.0, -82.0], [17.0, 5.0, 48.0], 32.0, dark),
                    part("wing", [31.0, -2.0, -16.0], [7.5, 27.0, 66.0], 36.0, dark),
                    part("leg", [14.0, -62.0, 2.0], [5.0, 32.0, 5.0], 0.0, horn),
                    part("foot", [14.0, -92.0, 10.0], [7.0, 5.0, 17.0], 0.0, horn),
                    part("eye", [19.0, 73.0, 64.0], [4.0, 4.5, 4.5], 0.0, [0.03, 0.03, 0.04]),
                ]
            }
        };
        Solid { parts, bands: 0.0 }
    }

    /// Paints of others of the kind, by part; parts that are not named stay as the template's.
    fn palettes(self) -> &'static [&'static [(&'static str, [f64; 3])]] {
        match self {
            Self::Fish => &[
                &[
                    ("body", [0.30, 0.24, 0.17]),
                    ("head", [0.42, 0.33, 0.20]),
                    ("peduncle", [0.80, 0.42, 0.12]),
                    ("upper tail", [0.80, 0.42, 0.12]),
                    ("lower tail", [0.80, 0.42, 0.12]),
                ],
                &[
                    ("body", [0.80, 0.72, 0.22]),
                    ("head", [0.80, 0.72, 0.22]),
                    ("peduncle", [0.80, 0.72, 0.22]),
                    ("dorsal fin", [0.75, 0.62, 0.15]),
                    ("anal fin", [0.75, 0.62, 0.15]),
                ],
                &[
                    ("body", [0.16, 0.42, 0.70]),
                    ("head", [0.07, 0.10, 0.16]),
                    ("upper tail", [0.75, 0.77, 0.80]),
                    ("lower tail", [0.75, 0.77, 0.80]),
                ],
                &[("body", [0.55, 0.58, 0.62]), ("head", [0.50, 0.52, 0.55])],
            ],
            Self::Bird => &[
                &[
                    ("body", [0.45, 0.47, 0.50]),
                    ("neck", [0.45, 0.47, 0.50]),
                    ("head", [0.30, 0.32, 0.36]),
                    ("wing", [0.25, 0.27, 0.31]),
                    ("belly", [0.86, 0.85, 0.84]),
                ],
                &[
                    ("body", [0.25, 0.42, 0.66]),
                    ("neck", [0.25, 0.42, 0.66]),
                    ("head", [0.22, 0.38, 0.64]),
                    ("wing", [0.18, 0.32, 0.58]),
                    ("tail", [0.18, 0.32, 0.58]),
                ],
                &[
                    ("belly", [0.74, 0.33, 0.14]),
                    ("head", [0.70, 0.34, 0.17]),
                    ("body", [0.38, 0.33, 0.24]),
                ],
                &[
                    ("body", [0.74, 0.62, 0.20]),
                    ("neck", [0.78, 0.66, 0.22]),
                    ("head", [0.80, 0.68, 0.22]),
                    ("belly", [0.85, 0.78, 0.40]),
                ],
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::landmarks;
    use crate::mesh::ply;
    use crate::scan::doctor::Findings;
    use std::path::Path;

    /// `onescan experiment fish --template -o fixtures/fish` writes them anew.
    #[test]
    fn the_fixtures_are_the_templates() {
        for kind in [Kind::Fish, Kind::Bird] {
            let place = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures").join(kind.name());
            let mesh = ply::read(&place.join("template.ply")).unwrap();
            let Animal { mesh: made, landmarks } = kind.template();
            assert_eq!(made.triangles, mesh.triangles);
            for (a, b) in mesh.points.as_flattened().iter().zip(made.points.as_flattened()) {
                assert!((a - b).abs() < 1e-3, "{a} {b}");
            }
            let named = landmarks::read(&place.join("landmarks.json"), &mesh.points, 1.0).unwrap();
            assert_eq!(named, landmarks);
        }
    }

    #[test]
    fn animals_are_whole_symmetric_and_named() {
        for kind in [Kind::Fish, Kind::Bird] {
            let Animal { mesh, landmarks } = kind.template();
            assert!((4000..14_000).contains(&mesh.points.len()), "{}", mesh.points.len());
            assert!(landmarks.len() >= 12);
            let mut places: Vec<u32> = landmarks.iter().map(|l| l.vertex).collect();
            places.sort_unstable();
            places.dedup();
            assert_eq!(places.len(), landmarks.len(), "landmarks lie apart");
            for left in landmarks.iter().filter(|l| l.name.starts_with("left.")) {
                let name = left.name.replace("left.", "right.");
                let right = landmarks.iter().find(|l| l.name == name).unwrap();
                let [a, b] = [left, right].map(|l| mesh.points[l.vertex as usize]);
                assert!(a[0] > 0.0 && a == [-b[0], b[1], b[2]], "{a:?} {b:?}");
            }
            let mut rng = Rng::new(1, 0);
            let other = kind.specimen(&mut rng);
            assert_eq!(other.landmarks.len(), landmarks.len());
            assert_ne!(other.mesh, mesh);
            for mesh in [&mesh, &other.mesh] {
                let found = Findings::of(mesh, 1.0);
                let edges = (found.border_edges, found.crowded_edges, found.clashing_edges);
                assert_eq!(edges, (0, 0, 0));
            }
        }
    }
}
