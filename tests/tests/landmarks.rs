//! Landmarks found by the command: in photos, by `fit` itself, and on a scan.

use onescan::photo::tlms::Tlms;
use onescan_tests::program::{Onescan, fixtures, json};
use std::fs;
use tempfile::tempdir;

#[test]
fn a_fit_finds_the_landmarks_itself() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    run("landmarks @photos/astronaut.png -o found.tlms --picture marked.png");
    let found = fs::read_to_string(at("found.tlms")).unwrap();
    assert_eq!(Tlms::parse(&found).unwrap().landmarks.len(), 41);
    assert!(at("marked.png").exists());

    run("fit @golden/small.3dmm @photos/astronaut.png -o fit");
    // What the model knows of them.
    let used = fs::read_to_string(at("fit/landmarks.tlms")).unwrap();
    assert!(used.lines().count() >= 4 && used.lines().all(|line| found.contains(line)));
    let itself = json(&at("fit/fit.json"));
    // As they were given, so that it runs again.
    let [model, photo] =
        ["golden/small.3dmm", "photos/astronaut.png"].map(|name| fixtures().join(name));
    let (model, photo) = (model.display(), photo.display());
    assert_eq!(itself["command"], format!("onescan fit {model} {photo} -o fit"));

    fs::copy(at("fit/landmarks.tlms"), at("used.tlms")).unwrap();
    run("fit @golden/small.3dmm @photos/astronaut.png --landmarks used.tlms -o fit");
    let given = json(&at("fit/fit.json"));
    assert_eq!(given["fingerprint"], itself["fingerprint"]);
    assert!(!at("fit/landmarks.tlms").exists(), "an earlier fit's are not left behind");
    assert_eq!(
        given["command"],
        format!("onescan fit {model} {photo} --landmarks used.tlms -o fit")
    );
}

#[test]
fn landmarks_beside_the_face_are_doubted() {
    let place = tempdir().unwrap();
    let mut marks = Tlms::read(&fixtures().join("photos/astronaut.tlms"), [512, 512]).unwrap();
    let doubts = |marks: &Tlms| {
        fs::write(place.path().join("a.tlms"), marks.to_text()).unwrap();
        let line = "fit @golden/small.3dmm @photos/astronaut.png --landmarks a.tlms -o fit";
        Onescan::new(place.path(), line).succeed();
        json(&place.path().join("fit/fit.json"))["warnings"].to_string()
    };
    let said = doubts(&marks);
    assert!(!said.contains("no face"), "{said}");
    for mark in &mut marks.landmarks {
        mark.x -= 60.0;
    }
    let said = doubts(&marks);
    assert!(said.contains("the landmarks lie on no face; the nearest"), "{said}");
}

#[test]
fn landmarks_of_a_scan_make_a_model_that_is_fitted() {
    let place = tempdir().unwrap();
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    run("landmarks @face/scans/scan_03.ply -o scan.json --picture scan.png");
    let marks = json(&place.path().join("scan.json"));
    assert!(marks.as_array().unwrap().len() >= 38, "{marks}");
    run("build @face/scans/scan_03.ply --landmarks scan.json --rank 8 -o own.3dmm");
    run("fit own.3dmm @photos/obama.jpg -o fit");
    let fit = json(&place.path().join("fit/fit.json"));
    assert!(fit["landmark_rmse_px"].as_f64().unwrap() < 12.0, "{}", fit["landmark_rmse_px"]);
}

#[test]
fn what_has_no_face_is_refused() {
    let place = tempdir().unwrap();
    let refused = |line: &str, part: &str| {
        let run = Onescan::new(place.path(), line).run();
        assert_eq!(run.code, Some(1), "{line}: {}", run.stderr);
        assert!(run.stderr.contains(part), "{line}: {}", run.stderr);
        assert_eq!(run.stderr.trim().lines().count(), 1, "{line}: {}", run.stderr);
    };
    let render = "render @golden/small.3dmm -o back.png --size 128x128 --yaw 180";
    Onescan::new(place.path(), render).succeed();
    refused("landmarks back.png", "back.png: no face found; mark its landmarks yourself");
    refused("fit @golden/small.3dmm back.png -o out", "back.png: no face found");
    refused(
        "landmarks @photos/astronaut.png --face 2 -o x.tlms",
        "no face 2; the only one is 1 at (",
    );
    refused(
        "landmarks @photos/astronaut.png --unit cm -o x.tlms",
        "is a photo, and --unit 10 is about",
    );
    refused(
        "landmarks @face/template.ply --face 1 -o x.json",
        "is a scan, and --face is about photos",
    );
    refused("landmarks @fish/template.ply -o x.json", "no face found from any side");
    assert!(!place.path().join("x.tlms").exists() && !place.path().join("x.json").exists());
}

#[test]
fn landmarks_marked_by_hand_are_not_replaced_unasked() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    fs::copy(fixtures().join("photos/astronaut.png"), at("me.png")).unwrap();
    fs::write(at("me.tlms"), "by hand").unwrap();
    let line = |line: &str| Onescan::new(place.path(), line);
    let refused = line("landmarks me.png").run();
    assert_eq!(refused.code, Some(1));
    assert!(refused.stderr.contains("me.tlms: is there already"), "{}", refused.stderr);
    assert_eq!(fs::read_to_string(at("me.tlms")).unwrap(), "by hand");
    line("landmarks me.png -o me.tlms").succeed();
    assert!(fs::read_to_string(at("me.tlms")).unwrap().contains("center.nose.tip"));
}
