//! `onescan register` by the command: a turned scan of other topology is registered, the same way
//! twice; what cannot be is refused in a line.

use onescan::experiment::faces::scan_truths;
use onescan::mesh::ply::{self, Encoding};
use onescan_core::scene::Pose;
use onescan_tests::program::{Onescan, fixtures, json};
use std::fs;
use tempfile::tempdir;

#[test]
fn a_turned_scan_is_registered_where_it_lies() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    run("build @face/template.ply --landmarks @face/landmarks.json --rank 60 -o face.3dmm");

    let pose =
        Pose { scale: 1.0, translation: [0.0, 50.0, -900.0], roll: 0.3, yaw: 0.5, pitch: -0.2 };
    let mut scan = ply::read(&fixtures().join("face/scans/scan_07.ply")).unwrap();
    scan.points.iter_mut().for_each(|p| *p = pose.to_world(*p));
    let mut bytes = Vec::new();
    ply::write(&mut bytes, &scan, Encoding::Binary).unwrap();
    fs::create_dir(at("scans")).unwrap();
    fs::write(at("scans/turned.ply"), &bytes).unwrap();

    run("register face.3dmm scans/turned.ply -o one --uncertainty --unit 1 --up=y --front=z");
    let truth = &scan_truths(&fixtures()).unwrap()[7];
    let found = ply::read(&at("one/registered.ply")).unwrap();
    let squares = found.points.iter().zip(truth).map(|(p, t)| {
        let t = pose.to_world(*t);
        (0..3).map(|i| f64::from(p[i] - t[i]).powi(2)).sum::<f64>()
    });
    let rms = (squares.sum::<f64>() / truth.len() as f64).sqrt();
    assert!(rms < 2.2, "{rms} mm from the truth");
    let numbers = json(&at("one/register.json"));
    let command =
        "onescan register face.3dmm scans/turned.ply -o DIR --uncertainty --unit 1 --front=z";
    assert_eq!(numbers["command"], command);
    assert!(numbers["chamfer_mm"].as_f64().unwrap() < 1.0, "{numbers}");
    assert!(numbers["hausdorff_95_mm"].as_f64() <= numbers["hausdorff_mm"].as_f64());
    for name in ["registered.glb", "aligned.ply", "distances.ply", "uncertainty.ply", "report.html"]
    {
        assert!(at("one").join(name).exists(), "{name}");
    }

    assert!(numbers["doubt"].is_null(), "{numbers}");
    // What an older registration left there is not taken for this one's.
    fs::create_dir(at("fish")).unwrap();
    fs::write(at("fish/uncertainty.ply"), "old").unwrap();
    run("register face.3dmm @fish/template.ply -o fish");
    assert!(!at("fish/uncertainty.ply").exists());
    let doubt = json(&at("fish/register.json"))["doubt"].to_string();
    assert!(doubt.contains("the model holds what was found for improbable"), "{doubt}");

    // A scan that is none does not keep the others from being registered.
    fs::write(at("scans/broken.ply"), "ply\nno").unwrap();
    let batch = Onescan::new(place.path(), "register face.3dmm scans -o many --batch").run();
    assert_eq!(batch.code, Some(1), "{}", batch.stderr);
    assert!(batch.stderr.contains("1 of 2 scans"), "{}", batch.stderr);
    let again = fs::read(at("many/turned/registered.ply")).unwrap();
    assert!(again == fs::read(at("one/registered.ply")).unwrap(), "same bits");

    // What is registered is left alone, until its scan changes.
    fs::remove_file(at("scans/broken.ply")).unwrap();
    let written = || fs::metadata(at("many/turned/register.json")).unwrap().modified().unwrap();
    let (first, batch) = (written(), "register face.3dmm scans -o many --batch");
    run(batch);
    assert_eq!(written(), first);
    assert_eq!(json(&at("many/batch.json"))[0]["chamfer_mm"], numbers["chamfer_mm"]);
    fs::write(at("scans/turned.ply"), fs::read(at("scans/turned.ply")).unwrap()).unwrap();
    run(batch);
    assert!(written() > first);

    run("register face.3dmm scans/turned.ply -o shape --shape-only");
    assert!(fs::read(at("shape/registered.ply")).unwrap() != again);
    run("model pca one/aligned.ply shape/aligned.ply -o pca.3dmm");
}

#[test]
fn what_cannot_be_registered_is_named() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    fs::write(at("far.json"), r#"[{"id": "ear", "coordinates": [0, 0, 0]}]"#).unwrap();
    let one = "register @golden/small.3dmm @face/scans/scan_00.ply -o out";
    for (line, expected) in [
        (format!("{one} --landmarks far.json"), "no landmark has a name"),
        (format!("{one} --landmarks none.json"), "none.json"),
        (format!("{one} --landmarks far.json far.json"), "one per scan"),
        ("register @golden/small.3dmm @face/scans -o out".into(), "--batch"),
        ("register @golden/small.3dmm nothing.ply -o out".into(), "nothing.ply"),
        ("register @face/template.ply @face/scans/scan_00.ply -o out".into(), "template.ply"),
        (format!("{one} --unit 0.0001"), "scan_00.ply"),
    ] {
        let run = Onescan::new(place.path(), &line).run();
        assert_eq!(run.code, Some(1), "{line}: {}", run.stderr);
        assert!(run.stderr.contains(expected) && run.stderr.lines().count() == 1, "{}", run.stderr);
        assert!(!at("out/register.json").exists(), "{line}");
    }
}
