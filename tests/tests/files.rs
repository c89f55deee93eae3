//! What is written and printed, in places and to readers that are not as one would like them.
#![cfg(unix)]

use onescan_tests::program::{Onescan, fixtures, json};
use std::fs::{self, File};
use std::os::unix::fs::{FileTypeExt, symlink};
use std::path::Path;
use std::time::Duration;
use tempfile::tempdir;

#[test]
fn a_reader_that_goes_away_ends_the_command_quietly() {
    let place = tempdir().unwrap();
    for line in
        ["info @golden/small.3dmm --json", "info @golden/small.3dmm", "inspect @face/template.ply"]
    {
        let run = Onescan::new(place.path(), line).unread();
        assert_eq!((run.code, run.stderr.as_str()), (Some(0), ""), "{line}");
    }
    let full = File::options().write(true).open("/dev/full").unwrap();
    let run = Onescan::new(place.path(), "info @golden/small.3dmm").print_to(full);
    assert_eq!((run.code, run.stderr.lines().count()), (Some(1), 1), "{run:?}");
    assert!(run.stderr.starts_with("onescan: cannot write to standard output"), "{run:?}");
}

#[test]
fn a_device_stays_one_and_a_link_is_followed() {
    let place = tempdir().unwrap();
    Onescan::new(place.path(), "render @golden/small.3dmm -o /dev/null --size 32x32").succeed();
    assert!(fs::metadata("/dev/null").unwrap().file_type().is_char_device());
    symlink("real.png", place.path().join("link.png")).unwrap();
    Onescan::new(place.path(), "render @golden/small.3dmm -o link.png --size 32x32").succeed();
    assert!(place.path().join("link.png").symlink_metadata().unwrap().is_symlink());
    assert!(place.path().join("real.png").is_file());
}

#[test]
fn a_name_says_what_is_in_the_file() {
    let place = tempdir().unwrap();
    for (line, says) in [
        ("render @golden/small.3dmm -o f.glb", "f.glb: its name must end in .png"),
        ("inspect @face/template.ply --mend f.obj", "f.obj: its name must end in .ply"),
        ("convert @golden/small.3dmm -o f.bin", "f.bin: its name must end in .3dmm, .h5"),
        ("convert @golden/small.3dmm -o f.3dmm --zero-expression", "--zero-expression is for .h5"),
    ] {
        let run = Onescan::new(place.path(), line).run();
        assert_eq!(run.code, Some(1), "{line}: {run:?}");
        assert!(run.stderr.contains(says), "{line}: {run:?}");
    }
    assert_eq!(fs::read_dir(place.path()).unwrap().count(), 0);
}

#[test]
fn what_a_terminal_would_obey_is_shown() {
    let place = tempdir().unwrap();
    let name = "\u{1b}]0;owned\u{7}.ply";
    fs::write(place.path().join(name), "ply\n\u{1b}[2J\nend_header\n").unwrap();
    for line in [format!("inspect {name}"), format!("inspect {name}.gone.ply")] {
        let run = Onescan::new(place.path(), &line).run();
        assert_eq!(run.code, Some(1), "{run:?}");
        assert!(!run.stderr.contains(['\u{1b}', '\u{7}']), "{run:?}");
        assert!(run.stderr.contains("\\u{1b}]0;owned"), "{run:?}");
    }
}

#[test]
fn files_outside_a_scans_directory_are_left_alone() {
    let place = tempdir().unwrap();
    fs::create_dir(place.path().join("in")).unwrap();
    let case = |name: &str| fixtures().join("cases/obj-mapkd-identity").join(name);
    fs::copy(case("red.png"), place.path().join("secret.png")).unwrap();
    fs::copy(case("k0.obj"), place.path().join("in/k0.obj")).unwrap();
    let library = fs::read_to_string(case("k0.mtl")).unwrap().replace("red.png", "../secret.png");
    fs::write(place.path().join("in/k0.mtl"), library).unwrap();
    let run = Onescan::new(place.path(), "inspect in/k0.obj").run();
    assert_eq!(run.code, Some(1), "{run:?}");
    assert!(run.stderr.contains("outside the scan's directory"), "{run:?}");
    Onescan::new(place.path(), "inspect in/k0.obj --allow-outside").succeed();
}

#[test]
fn more_threads_than_there_can_be_are_not_asked_for() {
    let place = tempdir().unwrap();
    let line = "render @golden/small.3dmm -o a.png --size 32x32";
    let run = Onescan::new(place.path(), line).env("RAYON_NUM_THREADS", "10000000").run();
    assert_eq!(run.code, Some(0), "{run:?}");
    assert!(run.stderr.contains("1024 threads are the most"), "{run:?}");
}

const FIT: &str =
    "fit @golden/small.3dmm @photos/astronaut.png --landmarks @photos/astronaut.tlms -o fit";

#[test]
fn a_result_beside_its_inputs_leaves_them_alone() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    fs::copy(fixtures().join("photos/astronaut.png"), at("face.png")).unwrap();
    // Landmarks were found, corrected, and given from where they lie.
    fs::copy(fixtures().join("photos/astronaut.tlms"), at("landmarks.tlms")).unwrap();
    let line = "fit @golden/small.3dmm face.png --landmarks landmarks.tlms --size 64 -o .";
    for _ in 0..2 {
        Onescan::new(place.path(), line).succeed();
        assert!(at("landmarks.tlms").is_file() && at("fit.json").is_file());
    }
    // photo.png is what a fit writes.
    fs::rename(at("face.png"), at("photo.png")).unwrap();
    let before = fs::read(at("photo.png")).unwrap();
    let fit = fs::read(at("fit.json")).unwrap();
    let run = Onescan::new(place.path(), &line.replace("face.png", "photo.png")).run();
    assert_eq!(run.code, Some(1), "{run:?}");
    assert!(run.stderr.contains("photo.png: is read by this command"), "{run:?}");
    assert_eq!(fs::read(at("photo.png")).unwrap(), before);
    assert_eq!(fs::read(at("fit.json")).unwrap(), fit);
}

#[test]
fn a_killed_fit_goes_on_from_its_last_checkpoint() {
    let whole = tempdir().unwrap();
    // Long enough to be kept once on a fast machine.
    let line = format!("{FIT} --schedule paper --landmark-samples 3000 --samples 60000 --chains 2");
    Onescan::new(whole.path(), &line).succeed();
    let whole = json(&whole.path().join("fit/fit.json"));
    let place = tempdir().unwrap();
    let checkpoint = place.path().join("fit/checkpoint.bin");
    Onescan::new(place.path(), &line).kill_once(&checkpoint);
    assert!(!place.path().join("fit/fit.json").exists());
    Onescan::new(place.path(), &format!("{line} --resume")).succeed();
    let resumed = json(&place.path().join("fit/fit.json"));
    for field in ["fingerprint", "steps", "accepted", "log_likelihood", "trace", "parameters"] {
        assert_eq!(resumed[field], whole[field], "{field}");
    }
    assert!(!checkpoint.exists(), "a finished fit keeps no checkpoint");
}

#[test]
fn a_killed_sampling_goes_on_from_its_last_checkpoint() {
    let whole = tempdir().unwrap();
    let line = format!("{FIT} --size 64 --posterior 3000 --chains 2");
    Onescan::new(whole.path(), &line).succeed();
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join("fit").join(name);
    Onescan::new(place.path(), &line).kill_once(&at("checkpoint.bin"));
    assert!(!at("fit.json").exists());
    // What was kept is of those settings and of no others.
    let run = Onescan::new(place.path(), &format!("{line} --seed 9 --resume")).run();
    assert_eq!(run.code, Some(1), "{run:?}");
    assert!(run.stderr.contains("checkpoint.bin: it was saved by a fit of another"), "{run:?}");
    // The first was kept in the warm-up; more are in what comes after it.
    let mut after = Duration::from_secs(2);
    loop {
        let run = Onescan::new(place.path(), &format!("{line} --resume")).interrupt(after);
        match run.code {
            Some(0) => break,
            _ => assert!(run.stderr.contains("the same command with --resume goes on"), "{run:?}"),
        }
        after *= 2;
    }
    let [resumed, expected] =
        [at("fit.json"), whole.path().join("fit/fit.json")].map(|path| json(&path));
    assert_eq!(resumed["posterior"], expected["posterior"]);
    let states = |folder: &Path| fs::read(folder.join("fit/posterior.h5")).unwrap();
    assert!(states(place.path()) == states(whole.path()), "other states");
    assert!(!at("checkpoint.bin").exists(), "a finished fit keeps no checkpoint");
}

#[test]
fn a_fit_is_one_result_or_none() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join("fit").join(name);
    Onescan::new(place.path(), &format!("{FIT} --size 64")).succeed();
    let first = json(&at("fit.json"));
    assert!(report_is_of(&at("report.html"), &first));
    Onescan::new(place.path(), &format!("{FIT} --size 48")).succeed();
    let second = json(&at("fit.json"));
    assert_ne!(first["fingerprint"], second["fingerprint"]);
    assert!(report_is_of(&at("report.html"), &second));
    let left = fs::read_dir(place.path().join("fit")).unwrap();
    let left = left.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned());
    assert!(!left.into_iter().any(|name| name.starts_with(".onescan")), "a part is left");
}

fn report_is_of(report: &Path, fit: &serde_json::Value) -> bool {
    let fingerprint = fit["fingerprint"].as_str().unwrap();
    fs::read_to_string(report).unwrap().contains(fingerprint)
}
