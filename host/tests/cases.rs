//! Odd files of `fixtures/cases`: each gives what its README calls right.

use onescan::interchange;
use onescan::mesh::{Mesh, ply};
use onescan::model::build::{BuildOptions, Method, build};
use onescan::model::decompose::Truncation;
use onescan::model::kernel::{Hyper, PRESETS};
use onescan::scan::doctor::{Findings, mend};
use onescan::scan::mesh_file::{self, Options};
use std::path::{Path, PathBuf};

fn case(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures/cases").join(name)
}

/// What a file is to give.
enum Right {
    /// The dome of `truth`, scaled and then moved.
    Dome(f32, [f32; 3]),
    /// The dome, its colours to 8 bits of linear light, of which the dark ones are few.
    Linear,
    /// The dome, one of whose vertices has all blue.
    Blue(usize),
    /// The dome, of one colour.
    Painted([u8; 3]),
    /// The dome, of the texture that is brighter in red to +x, in green to +y.
    Ramp,
    /// The dome's shape, the colour given by the options.
    Shape,
    /// Triangles of this area together, square millimetres.
    Area(f32),
    /// A message with these words.
    Refused(&'static [&'static str]),
}
use Right::{Area, Blue, Dome, Linear, Painted, Ramp, Refused, Shape};

const SAME: Right = Dome(1.0, [0.0; 3]);
const RED: Right = Painted([200, 30, 20]);
const GREY: [f32; 3] = [0.4; 3];

/// What needs no options.
const CASES: [(&str, Right); 31] = [
    ("bom-elsewhere/g9.gltf", SAME),
    ("bom-elsewhere/p12.ply", SAME),
    ("bom-elsewhere/s7.stl", Refused(&["has no colours", "--colour"])),
    ("gltf-1.0/g48.gltf", Refused(&["version \"1.0\"", "convert"])),
    ("gltf-colour-not-normalised/g6.glb", Linear),
    ("gltf-custom-attribute/g56.glb", SAME),
    ("gltf-emissive/g23.glb", Ramp),
    ("gltf-skin/g47.glb", Dome(0.5, [0.0, 1600.0, 0.0])),
    ("obj-bom-mtllib/t2.obj", RED),
    ("obj-bom-mtllib/t3.obj", RED),
    ("obj-colour-over-one/o3.obj", Blue(5)),
    ("obj-coloured-texture-gone/gone2.obj", SAME),
    ("obj-coloured-texture-gone/p32.ply", SAME),
    ("obj-concave/cc.obj", Area(6000.0)),
    ("obj-concave/cq.obj", Area(2500.0)),
    ("obj-continuation/o10.obj", SAME),
    ("obj-continuation/o10b.obj", SAME),
    ("obj-mapkd-identity/k0.obj", RED),
    ("obj-mapkd-identity/k1.obj", RED),
    ("obj-no-usemtl/nu.obj", RED),
    ("ply-ascii-numbers/n1.ply", SAME),
    ("ply-ascii-numbers/n2.ply", SAME),
    ("ply-ascii-numbers/n9.ply", SAME),
    ("ply-ascii-numbers/p10.ply", SAME),
    ("ply-ascii-numbers/p3.ply", SAME),
    ("ply-texture-names/p31.ply", RED),
    ("ply-texture-names/p31b.ply", RED),
    ("ply-texture-this/mythis.ply", RED),
    ("ply-tristrips/p25.ply", SAME),
    ("ply-ushort-255/p21b.ply", SAME),
    ("truth/dome.ply", SAME),
];

fn area(mesh: &Mesh) -> f32 {
    let triangle = |corners: &[u32; 3]| {
        let [a, b, c] = corners.map(|i| mesh.points[i as usize]);
        let (u, v): ([f32; 3], [f32; 3]) =
            (std::array::from_fn(|i| b[i] - a[i]), std::array::from_fn(|i| c[i] - a[i]));
        let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
        n.iter().map(|x| x * x).sum::<f32>().sqrt() / 2.0
    };
    mesh.triangles.iter().map(triangle).sum()
}

fn bytes(mesh: &Mesh) -> Vec<[u8; 3]> {
    mesh.colors.iter().map(|color| color.map(|c| (255.0 * c).round() as u8)).collect()
}

fn check(name: &str, options: &Options, right: &Right) {
    let read = mesh_file::read(&case(name), options);
    if let Refused(words) = right {
        let message = read.unwrap_err().to_string();
        assert!(words.iter().all(|word| message.contains(word)), "{name}: {message}");
        return;
    }
    let scan = read.unwrap_or_else(|e| panic!("{name}: {e}"));
    let mut mesh = scan.mesh;
    mesh.points.as_flattened_mut().iter_mut().for_each(|c| *c *= scan.millimetres);
    if let Area(right) = right {
        let found = area(&mesh);
        assert!((found - right).abs() < 1e-3 * right, "{name}: {found} mm²");
        return;
    }
    let truth = ply::read(&case("truth/dome.ply")).unwrap();
    let (scale, by) = if let Dome(scale, by) = right { (*scale, *by) } else { (1.0, [0.0; 3]) };
    // Formats that join vertices number them as triangles do.
    let place = |p: &[f32; 3]| -> [f32; 3] { std::array::from_fn(|i| scale * p[i] + by[i]) };
    assert_eq!(mesh.points.len(), truth.points.len(), "{name}");
    assert_eq!(mesh.triangles.len(), truth.triangles.len(), "{name}");
    let (found, right_bytes) = (bytes(&mesh), bytes(&truth));
    for (p, color) in truth.points.iter().zip(right_bytes) {
        let at = place(p);
        let near = |q: &[f32; 3]| (0..3).all(|i| (q[i] - at[i]).abs() < 2e-3);
        let Some(vertex) = mesh.points.iter().position(near) else {
            panic!("{name}: no vertex at {at:?}");
        };
        match right {
            Blue(of) if *of == vertex => {
                assert_eq!(found[vertex], [color[0], color[1], 255], "{name}: vertex {vertex}");
            }
            Painted(color) => assert_eq!(found[vertex], *color, "{name}: vertex {vertex}"),
            Ramp => {
                let [red, green] = [p[0] / 100.0, p[1] / 130.0].map(|t| 252.0 * (t + 0.5));
                let [r, g, b] = found[vertex].map(f32::from);
                let off = (r - red).abs().max((g - green).abs());
                assert!(off < 4.0 && b == 128.0, "{name}: {:?} at {p:?}", found[vertex]);
            }
            Shape => assert_eq!(found[vertex], [102; 3], "{name}: vertex {vertex}"),
            Linear => {
                let close = (0..3).all(|i| found[vertex][i].abs_diff(color[i]) < 4);
                assert!(close, "{name}: {:?} for {color:?}", found[vertex]);
            }
            _ => assert_eq!(found[vertex], color, "{name}: vertex {vertex}"),
        }
    }
    let right = area(&truth) * scale * scale;
    assert!((area(&mesh) - right).abs() < 1e-3 * right, "{name}: {} mm²", area(&mesh));
}

#[test]
fn every_case_gives_what_is_right() {
    for (name, right) in &CASES {
        check(name, &Options::default(), right);
    }
    let grey = Options { color: Some(GREY), ..Options::default() };
    check("bom-elsewhere/s7.stl", &grey, &Shape);
    // The file's own colours are better.
    check("obj-coloured-texture-gone/gone2.obj", &grey, &SAME);
}

#[test]
fn a_missing_texture_is_told() {
    for name in ["gone2.obj", "p32.ply"] {
        let path = case("obj-coloured-texture-gone").join(name);
        let notes = mesh_file::read(&path, &Options::default()).unwrap().notes;
        assert!(notes.concat().contains("is not there; its other colours"), "{notes:?}");
    }
}

#[test]
fn landmarks_may_begin_with_a_mark() {
    let points = [[0.0; 3]; 8];
    let landmarks =
        onescan::mesh::landmarks::read(&case("bom-elsewhere/lm_bom.json"), &points, 1.0).unwrap();
    assert_eq!((landmarks[0].name.as_str(), landmarks[0].vertex), ("a", 7));
}

#[test]
fn what_is_wrong_with_a_scan_is_told_before_a_model_is_built() {
    let scan = |name: &str| mesh_file::read(&case("build-unit").join(name), &Options::default());
    let (metres, off) = (scan("metres.ply").unwrap().mesh, scan("off.ply").unwrap().mesh);
    let faults = |mesh: &Mesh| Findings::of(mesh, 1.0).faults(true).join("\n");
    assert!(
        faults(&metres).contains("kernels suit what is as large as a face"),
        "{}",
        faults(&metres)
    );
    assert!(faults(&off).contains("have a partner across x = 0"), "{}", faults(&off));
    let options = BuildOptions {
        scan_name: "metres.ply",
        kernels: PRESETS[0].kernels(&Hyper::default(), None),
        method: Method::Exact(Truncation::Rank(199)),
        millimetres: 1.0,
    };
    let error = build(&metres, &[], &options, &mut |_, _| ()).err().unwrap().to_string();
    assert!(error.contains("0.173 mm across") && error.contains("--unit m"), "{error}");
    assert!(
        build(&metres, &[], &BuildOptions { millimetres: 1000.0, ..options }, &mut |_, _| ())
            .is_ok()
    );
}

#[test]
fn mending_leaves_out_the_colours_of_what_no_triangle_shows() {
    let scan = mesh_file::read(&case("mend-mixes-unused/spare.obj"), &Options::default()).unwrap();
    let (mended, _) = mend(&scan.mesh, false);
    assert_eq!(bytes(&mended)[0], [255, 0, 0]);
}

#[test]
fn models_that_are_none_of_ours_say_what_they_are() {
    for (name, words) in [
        ("h5-color-255.h5", &["0 to 255"][..]),
        ("h5-root-ssm.h5", &["shape alone"][..]),
        ("h5-shape-only.h5", &["shape alone"][..]),
    ] {
        let folder = if name.contains("255") { "h5-colour-255" } else { "h5-shape-only" };
        let message = interchange::read(&case(folder).join(name)).err().unwrap().to_string();
        assert!(words.iter().all(|word| message.contains(word)), "{name}: {message}");
    }
}
