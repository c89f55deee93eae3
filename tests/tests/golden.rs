//! Results that stay the same, on every machine, until somebody means to change them:
//! `cargo xtask golden` writes what this compares.

use onescan::demo::template;
use onescan::mesh::ply::{self, Encoding};
use onescan::photo::{self, picture};
use onescan_tests::coarse::coarse;
use onescan_tests::full;
use onescan_tests::program::{Onescan, fingerprint, fixtures, json, target};
use serde_json::json;
use std::fmt::Write as _;
use std::fs;
use std::path::{Path, PathBuf};

/// Chains of the small model, by name.
const FITS: [(&str, &str); 4] = [
    ("astronaut", "@photos/astronaut.png --landmarks @photos/astronaut.tlms --schedule paper"),
    (
        "two_chains",
        "@photos/astronaut.png --landmarks @photos/astronaut.tlms --schedule paper --chains 2 --seed 1",
    ),
    ("sampler", "@photos/obama.jpg --landmarks @photos/obama.tlms --schedule sampler"),
    (
        "shape_alone",
        "@photos/obama.jpg --landmarks @photos/obama.tlms --schedule paper --albedo-rank 0 --size 128",
    ),
];
const STEPS: &str = "--landmark-samples 400 --samples 600";

/// About a thousand vertices.
const SPACING: f32 = 6.0;
const RANK: usize = 20;

/// Rendering is deterministic, and PNG lossless; what pictures may differ by is what an
/// intended change of rounding would.
const MEAN_DIFFERENCE: f64 = 0.05;
const LARGEST_DIFFERENCE: u8 = 8;

fn golden() -> PathBuf {
    fixtures().join("golden")
}

/// Whether `what` (`results`, or `model` and with it the results) is to be written anew.
fn writes(what: &str) -> bool {
    std::env::var("ONESCAN_GOLDEN").is_ok_and(|wanted| wanted == what || wanted == "model")
}

/// A model of a coarse face. Its last bits depend on the machine that built it (the eigenproblem
/// is solved by a library in whatever SIMD there is), so its bytes are kept.
#[test]
fn golden_results() {
    let out = tempfile::tempdir().unwrap();
    if writes("model") {
        let (mesh, landmarks) = template().unwrap();
        let (mesh, landmarks) = coarse(&mesh, &landmarks, SPACING);
        let mut file = fs::File::create(out.path().join("small.ply")).unwrap();
        ply::write(&mut file, &mesh, Encoding::Binary).unwrap();
        let entries: Vec<_> =
            landmarks.iter().map(|l| json!({ "id": l.name, "vertex": l.vertex })).collect();
        fs::write(out.path().join("small.json"), json!(entries).to_string()).unwrap();
        fs::create_dir_all(golden()).unwrap();
        let line = "build small.ply --landmarks small.json -o @golden/small.3dmm --rank";
        Onescan::new(out.path(), &format!("{line} {RANK}")).succeed();
    }
    fingerprints(out.path());
    pictures(out.path());
}

/// The full-size case. Its inputs stay in target/full: `cargo xtask` gives them to other shells,
/// which must come to the same fingerprint.
#[test]
fn full_size() {
    let out = target().join("full");
    fs::create_dir_all(&out).unwrap();
    full::write(&out, &fixtures().join("photos")).unwrap();
    let mut found = String::new();
    for (name, schedule) in [("fingerprint", "paper"), ("search", "mode")] {
        let photo = "@photos/astronaut.png --landmarks @photos/astronaut.tlms";
        let fit = format!("fit face.3dmm {photo} --schedule {schedule} -o {schedule}");
        Onescan::new(&out, &fit).succeed();
        let fit = json(&out.join(schedule).join("fit.json"));
        writeln!(found, "{name} {}", fingerprint(&fit)).unwrap();
    }
    let path = golden().join("full.txt");
    if writes("results") {
        fs::write(&path, found).unwrap();
        return;
    }
    let expected = fs::read_to_string(&path).unwrap();
    assert_eq!(found, expected, "the fingerprint changed; if it should, cargo xtask golden");
}

fn fingerprints(out: &Path) {
    let mut found = String::new();
    for (name, arguments) in FITS {
        let line = format!("fit @golden/small.3dmm {arguments} {STEPS} -o {name}");
        Onescan::new(out, &line).succeed();
        let fit = json(&out.join(name).join("fit.json"));
        writeln!(found, "{name} {}", fingerprint(&fit)).unwrap();
    }
    let path = golden().join("fingerprints.txt");
    if writes("results") {
        fs::write(&path, found).unwrap();
        // Parsers are fuzzed from files as they are written today.
        for name in ["fit.json", "fit.rps"] {
            let target = name.replace("fit.rps", "rps").replace('.', "_");
            let seeds = fixtures().join("../fuzz/seeds").join(target);
            fs::create_dir_all(&seeds).unwrap();
            let text = fs::read_to_string(out.join("shape_alone").join(name)).unwrap();
            // The command has the paths that were given, which are this machine's.
            let here = fixtures().display().to_string();
            fs::write(seeds.join(name), text.replace(&here, "fixtures")).unwrap();
        }
        return;
    }
    let expected = fs::read_to_string(&path).unwrap();
    assert_eq!(found, expected, "fingerprints changed; if they should, cargo xtask golden");
}

fn pictures(out: &Path) {
    Onescan::new(out, "render @golden/small.3dmm --yaw 25 --size 256x256 -o render.png").succeed();
    let (actual, expected) = (out.join("render.png"), golden().join("render.png"));
    if writes("results") {
        fs::copy(&actual, &expected).unwrap();
        return;
    }
    let [a, e] = [&actual, &expected].map(|path| photo::read(path).unwrap());
    assert_eq!((a.width, a.height), (e.width, e.height));
    let differences = a.bytes().iter().zip(e.bytes()).map(|(a, e)| a.abs_diff(*e));
    let largest = differences.clone().max().unwrap_or(0);
    let mean = differences.map(f64::from).sum::<f64>() / a.bytes().len() as f64;
    if mean > MEAN_DIFFERENCE || largest > LARGEST_DIFFERENCE {
        let failures = target().join("golden-failures");
        fs::create_dir_all(&failures).unwrap();
        fs::copy(&actual, failures.join("actual.png")).unwrap();
        fs::copy(&expected, failures.join("expected.png")).unwrap();
        let difference = picture::difference(&a, &e, 0.1).unwrap();
        difference.write_png(&failures.join("difference.png")).unwrap();
        panic!("mean {mean:.3}, largest {largest}; see {}", failures.display());
    }
}
