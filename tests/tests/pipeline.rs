//! Scan to model to fit with the real program, and the promise that the same input gives the
//! same bits.

use onescan::mesh::ply;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::photo::{self, Crop};
use onescan_tests::program::{Onescan, fingerprint, fixtures, json};
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::{TempDir, tempdir};

const ASTRONAUT: &str = "@photos/astronaut.png --landmarks @photos/astronaut.tlms";
/// A short chain.
const SHORT: &str = "--schedule paper --landmark-samples 300 --samples 300";

/// Fits the golden model to the astronaut.
fn fit(directory: &Path, name: &str, arguments: &str) -> Value {
    let line = format!("fit @golden/small.3dmm {ASTRONAUT} -o {name} {arguments}");
    Onescan::new(directory, &line).succeed();
    json(&directory.join(name).join("fit.json"))
}

#[test]
fn a_mesh_is_inspected_and_mended_and_any_format_gives_the_same_model() {
    let place = tempdir().unwrap();
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    let found: Value =
        serde_json::from_str(&run("inspect @face/template.ply --json --mend same.ply")).unwrap();
    assert_eq!(found["findings"]["triangles"], 16374);
    assert_eq!(found["faults"], Value::Array(Vec::new()));
    let mesh = ply::read(&place.path().join("same.ply")).unwrap();
    assert_eq!(mesh, ply::read(&fixtures().join("face/template.ply")).unwrap());

    // The same face in centimetres, with z up, as OBJ.
    let mut obj = String::new();
    for ([x, y, z], [r, g, b]) in mesh.points.iter().zip(&mesh.colors) {
        writeln!(obj, "v {} {} {} {r} {g} {b}", x / 10.0, -z / 10.0, y / 10.0).unwrap();
    }
    for t in &mesh.triangles {
        let [a, b, c] = t.map(|v| v + 1);
        writeln!(obj, "f {a} {b} {c}").unwrap();
    }
    fs::write(place.path().join("face.obj"), obj).unwrap();
    run("inspect face.obj --up z --unit cm --mend turned.ply");
    let turned = ply::read(&place.path().join("turned.ply")).unwrap();
    assert_eq!((&turned.colors, &turned.triangles), (&mesh.colors, &mesh.triangles));
    for (a, b) in turned.points.as_flattened().iter().zip(mesh.points.as_flattened()) {
        assert!((a - b).abs() < 1e-4, "{a} {b}");
    }
    let landmarks = "--landmarks @face/landmarks.json --rank 3";
    run(&format!("build face.obj --up z --unit 10 {landmarks} -o turned.3dmm"));
    let info: Value = serde_json::from_str(&run("info turned.3dmm --json")).unwrap();
    assert_eq!(info["landmarks"].as_object().unwrap().len(), 42);
}

#[test]
fn a_scan_becomes_a_model_and_the_model_explains_a_photo() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let run = |line: &str| Onescan::new(place.path(), line).succeed();

    let build = "build @face/template.ply --landmarks @face/landmarks.json --rank 10 -o";
    run(&format!("{build} face.3dmm"));
    run(&format!("{build} again.3dmm"));
    assert!(fs::read(at("face.3dmm")).unwrap() == fs::read(at("again.3dmm")).unwrap());

    let info: Value = serde_json::from_str(&run("info face.3dmm --json")).unwrap();
    assert_eq!(info["vertices"], 8291);
    assert_eq!(info["triangles"], 16374);
    for half in ["shape", "albedo"] {
        assert_eq!(info[half]["rank"], 10);
        let captured = info[half]["captured"].as_f64().unwrap();
        assert!(captured > 0.1 && captured < 1.0, "{half}: {captured}");
    }
    assert_eq!(info["landmarks"].as_object().unwrap().len(), 42);

    run("sample face.3dmm -n 3 -o samples");
    for number in 0..3 {
        let sample = ply::read(&at(&format!("samples/sample_{number:02}.ply"))).unwrap();
        assert_eq!((sample.points.len(), sample.triangles.len()), (8291, 16374));
    }
    assert!(photo::read(&at("samples/samples.png")).is_ok());

    run("render face.3dmm --size 320x200 --yaw 30 -o mean.png");
    let mean = photo::read(&at("mean.png")).unwrap();
    assert_eq!((mean.width, mean.height), (320, 200));
    assert!(mean.rgb.iter().any(|pixel| *pixel != mean.rgb[0]), "nothing was drawn");

    run(&format!("fit face.3dmm {ASTRONAUT} {SHORT} -o fit"));
    let fit = json(&at("fit/fit.json"));
    keeps_its_contract(&fit);
    let mesh = ply::read(&at("fit/mesh.ply")).unwrap();
    assert_eq!((mesh.points.len(), mesh.triangles.len()), (8291, 16374));
    let glb = gltf::Gltf::from_slice(&fs::read(at("fit/mesh.glb")).unwrap()).unwrap();
    assert_eq!(glb.meshes().count(), 1);
    assert!(photo::read(&at("fit/overlay.png")).is_ok());
    is_self_contained(&fs::read_to_string(at("fit/report.html")).unwrap());

    run("render face.3dmm --fit fit/fit.json -o fitted.png");
    let fitted = photo::read(&at("fitted.png")).unwrap();
    assert_eq!((fitted.width, fitted.height), (512, 512), "the photo's size");
    run("render face.3dmm --rps fit/fit.rps --size 512x512 -o engine.png");
    let engine = photo::read(&at("engine.png")).unwrap();
    let far = |(a, b): (&u8, &u8)| a.abs_diff(*b) > 2;
    let differing = fitted.bytes().iter().zip(engine.bytes()).filter(|&pair| far(pair)).count();
    assert!(differing < fitted.bytes().len() / 1000, "fit.rps shows another face: {differing}");
}

/// What scripts rely on, and what a fit must achieve at the very least.
fn keeps_its_contract(fit: &Value) {
    let number = |path: &str| {
        fit.pointer(path).and_then(Value::as_f64).unwrap_or_else(|| panic!("no number {path}"))
    };
    assert_eq!(fit["seed"], 7);
    assert_eq!(fit["steps"], 600);
    assert_eq!(fingerprint(fit).len(), 16);
    assert!(number("/steps_per_second") > 0.0);
    let accepted = number("/accepted");
    assert!(accepted > 0.0 && accepted < 600.0, "{accepted} accepted");
    assert!(number("/log_likelihood/best") > number("/log_likelihood/initial"));
    assert!(number("/pixel_rmse/best") < number("/pixel_rmse/initial"));
    assert!(number("/pixel_rmse/best") > 0.0 && number("/pixel_rmse/initial") < 1.0);
    assert!(number("/landmark_rmse_px") > 0.0 && number("/landmark_rmse_px") < 30.0);
    for half in ["shape", "albedo"] {
        let coefficients = fit["parameters"][half].as_array().unwrap();
        assert_eq!(coefficients.len(), 10);
    }
}

/// A report opens anywhere: every picture, style and script is within it.
fn is_self_contained(html: &str) {
    assert!(html.contains("<html") && html.trim_end().ends_with("</html>"));
    assert!(html.contains("data:image/png;base64,") || html.contains("data:image/jpeg;base64,"));
    for (attribute, allowed) in
        [("src=", &["data:"][..]), ("href=", &["#", "data:"]), ("url(", &["data:", "#"])]
    {
        for (at, _) in html.match_indices(attribute) {
            let target = html[at + attribute.len()..].trim_start_matches(['"', '\'']);
            // A link may lead to a file beside the page; what the page shows is within it.
            let link = target.split(['"', '\'', '>']).next().unwrap_or_default();
            let beside = attribute == "href=" && !link.contains(':') && !link.starts_with('/');
            let inside = beside || allowed.iter().any(|start| target.starts_with(start));
            let shown: String = target.chars().take(60).collect();
            assert!(inside, "{attribute}{shown} leads outside");
        }
    }
    for load in ["@import", "<link", "<iframe", "fetch(", "srcset="] {
        assert!(!html.contains(load), "{load}");
    }
}

/// The command of a fit of fixtures, which are where they were said to be.
fn command(files: &[&str], marks: &str) -> String {
    let at = |name: &str| fixtures().join(name).display().to_string();
    let files = files.iter().map(|name| at(name)).collect::<Vec<_>>().join(" ");
    format!("onescan fit {files} --landmarks {} -o fit", at(marks))
}

#[test]
fn a_fit_searches_for_the_mode_with_all_components() {
    let place = tempdir().unwrap();
    let found = fit(place.path(), "fit", "");
    let number = |path: &str| found.pointer(path).and_then(Value::as_f64).unwrap();
    for half in ["shape", "albedo"] {
        let coefficients = found["parameters"][half].as_array().unwrap();
        assert_eq!(coefficients.len(), 20, "the whole model's");
    }
    assert_eq!(found["steps"], found["mode"]["iterations"]);
    assert_eq!([&found["landmark_samples"], &found["samples"]], [0, 0]);
    assert!(number("/pixel_rmse/best") < number("/pixel_rmse/initial"));
    assert_eq!(
        found["command"],
        command(&["golden/small.3dmm", "photos/astronaut.png"], "photos/astronaut.tlms")
    );
    for name in ["mask.png", "behind.png", "overlay.png"] {
        assert!(photo::read(&place.path().join("fit").join(name)).is_ok(), "{name}");
    }
    let fewer = fit(place.path(), "fewer", "--shape-rank 5 --albedo-rank 0");
    assert_eq!(fewer["parameters"]["shape"].as_array().unwrap().len(), 5);
    assert_eq!(fewer["parameters"]["albedo"].as_array().unwrap().len(), 0);
    let command = fewer["command"].as_str().unwrap();
    assert!(command.ends_with("-o fit --shape-rank 5 --albedo-rank 0"), "{command}");
}

#[test]
fn what_a_mask_hides_is_no_face() {
    let place = tempdir().unwrap();
    let marks = Tlms::read(&fixtures().join("photos/astronaut.tlms"), [512; 2]).unwrap();
    let lips = marks.landmarks.iter().filter(|l| l.id.contains("lips"));
    let lips: Vec<[u32; 2]> = lips.map(|l| [l.x as u32, l.y as u32]).collect();
    let near = |x: u32, y: u32| lips.iter().any(|&[u, v]| u.abs_diff(x) < 9 && v.abs_diff(y) < 9);
    let mask = Picture::from_fn(512, 512, |x, y| if near(x, y) { [0; 3] } else { [255; 3] });
    mask.write_png(&place.path().join("hidden.png")).unwrap();
    let found = fit(place.path(), "fit", "--mask hidden.png");
    let command = found["command"].as_str().unwrap();
    assert!(command.ends_with("-o fit --mask hidden.png"), "{command}");
    let shown = photo::read(&place.path().join("fit/mask.png")).unwrap();
    let crop: Crop = serde_json::from_value(found["image"]["crop"].clone()).unwrap();
    let scale = f64::from(shown.width) / f64::from(crop.size[0]);
    for [x, y] in lips {
        let at = [x, y].map(f64::from);
        let [x, y] = [0, 1].map(|i| ((at[i] - f64::from(crop.origin[i]) + 0.5) * scale) as u32);
        assert_eq!(shown.pixel(x, y), Some([0; 3]), "{at:?}");
    }
    let seen = shown.rgb.iter().filter(|pixel| pixel[0] > 200).count();
    assert!(seen > shown.rgb.len() / 30, "{seen}");
}

#[test]
fn a_wrong_landmark_is_named_and_does_little() {
    let place = tempdir().unwrap();
    let text = fs::read_to_string(fixtures().join("photos/astronaut.tlms")).unwrap();
    let line = text.lines().find(|line| line.starts_with("center.nose.tip ")).unwrap();
    let wrong = text.replace(line, "center.nose.tip 1 450 480");
    fs::write(place.path().join("wrong.tlms"), wrong).unwrap();
    let line = "fit @golden/small.3dmm @photos/astronaut.png --landmarks wrong.tlms -o wrong";
    Onescan::new(place.path(), line).succeed();
    let wrong = json(&place.path().join("wrong/fit.json"));
    let right = fit(place.path(), "right", "");
    let far = |fit: &Value| -> Vec<String> {
        let landmarks = fit["landmarks"].as_array().unwrap();
        let far = landmarks.iter().filter(|l| l["far"] == true);
        far.map(|l| l["name"].as_str().unwrap().into()).collect()
    };
    assert_eq!((far(&wrong), far(&right)), (vec!["center.nose.tip".into()], vec![]));
    let warned = wrong["warnings"][0].as_str().unwrap();
    assert!(warned.starts_with("landmark center.nose.tip is "), "{warned}");
    assert_eq!(right["warnings"].as_array().unwrap().len(), 0);
    let yaw = |fit: &Value| fit["parameters"]["pose"]["yaw"].as_f64().unwrap();
    assert!((yaw(&wrong) - yaw(&right)).abs() < 0.1, "{} {}", yaw(&wrong), yaw(&right));
    let report = fs::read_to_string(place.path().join("wrong/report.html")).unwrap();
    assert!(report.contains("center.nose.tip is "));
    assert!(photo::read(&place.path().join("wrong/landmarks.png")).is_ok());
}

/// What a pixel and a landmark say is in proportion to the picture.
#[test]
fn a_larger_picture_gives_the_same_face() {
    let place = tempdir().unwrap();
    let shape = |name: &str, arguments: &str| -> Vec<f64> {
        let fit = fit(place.path(), name, arguments);
        let shape = fit["parameters"]["shape"].as_array().unwrap();
        shape.iter().map(|x| x.as_f64().unwrap()).collect()
    };
    let (small, large) = (shape("small", ""), shape("large", "--size 768"));
    let dot = |a: &[f64], b: &[f64]| -> f64 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
    let cosine = dot(&small, &large) / (dot(&small, &small) * dot(&large, &large)).sqrt();
    assert!(cosine > 0.8, "{cosine}: {small:?} {large:?}");
}

#[test]
fn a_wall_is_no_face() {
    let place = tempdir().unwrap();
    let mut marks = Tlms::read(&fixtures().join("photos/astronaut.tlms"), [512; 2]).unwrap();
    for l in &mut marks.landmarks {
        // Of the photo at a third of its size: beside the face.
        (l.x, l.y) = (l.x / 3.0, l.y / 3.0);
    }
    fs::write(place.path().join("third.tlms"), marks.to_text()).unwrap();
    let line = "fit @golden/small.3dmm @photos/astronaut.png --landmarks third.tlms -o wall";
    Onescan::new(place.path(), line).succeed();
    let warnings = json(&place.path().join("wall/fit.json"))["warnings"].to_string();
    assert!(warnings.contains("nearly plain"), "{warnings}");
}

/// A chain has no mask, and leaves none of a search before it.
#[test]
fn pictures_of_an_earlier_fit_are_not_left() {
    let place = tempdir().unwrap();
    let mask = place.path().join("fit/mask.png");
    fit(place.path(), "fit", "--size 64");
    assert!(mask.exists());
    let other = place.path().join("fit/checkpoint.bin");
    fs::write(&other, "of an interrupted fit").unwrap();
    fit(place.path(), "fit", "--schedule paper --landmark-samples 20 --samples 20");
    assert!(other.exists(), "a checkpoint that was not gone on from is lost");
    assert!(!mask.exists() && place.path().join("fit/overlay.png").exists());
}

#[test]
fn a_photo_upside_down_is_a_photo() {
    let place = tempdir().unwrap();
    let mut photo = photo::read(&fixtures().join("photos/astronaut.png")).unwrap();
    photo.rgb.reverse();
    photo.write_png(&place.path().join("down.png")).unwrap();
    let mut marks = Tlms::read(&fixtures().join("photos/astronaut.tlms"), [512; 2]).unwrap();
    for l in &mut marks.landmarks {
        (l.x, l.y) = (511.0 - l.x, 511.0 - l.y);
    }
    fs::write(place.path().join("down.tlms"), marks.to_text()).unwrap();
    let line = "fit @golden/small.3dmm down.png --landmarks down.tlms -o down";
    Onescan::new(place.path(), line).succeed();
    let (down, up) = (json(&place.path().join("down/fit.json")), fit(place.path(), "up", ""));
    let error = |fit: &Value| fit["pixel_rmse"]["best"].as_f64().unwrap();
    assert!(error(&down) < 1.2 * error(&up), "{} {}", error(&down), error(&up));
    assert_eq!(down["warnings"].as_array().unwrap().len(), 0);
}

#[test]
fn several_photos_give_one_face() {
    let place = tempdir().unwrap();
    let photos = "@rough/05_00.jpg @rough/05_30.jpg";
    let marks = "--landmarks @rough/05_00.tlms @rough/05_30.tlms";
    let run = |arguments: &str| {
        Onescan::new(place.path(), &format!("fit @golden/small.3dmm {arguments}"))
    };
    run(&format!("{photos} {marks} -o both")).succeed();
    let path = place.path().join("both");
    let all = json(&path.join("summary.json"));
    let [front, side] = [0, 1].map(|i| &all["fits"][i]);
    for shared in ["shape", "albedo"] {
        assert_eq!(front["parameters"][shared], side["parameters"][shared]);
    }
    let yaw = |fit: &Value| fit["parameters"]["pose"]["yaw"].as_f64().unwrap().to_degrees().abs();
    assert!(yaw(front) < 8.0 && (22.0..38.0).contains(&yaw(side)), "{} {}", yaw(front), yaw(side));
    assert_eq!(front["others"][0], "05_30.jpg");
    for file in ["report.html", "mesh.glb", "05_00/fit.json", "05_30/behind.png"] {
        assert!(path.join(file).is_file(), "{file}");
    }
    let mesh = |of: &str| fs::read(path.join(of)).unwrap();
    assert_eq!(mesh("mesh.ply"), mesh("05_30/mesh.ply"));
    // The photos may come last.
    run(&format!("{marks} {photos} -o again")).succeed();
    let again = json(&place.path().join("again/summary.json"));
    assert_eq!(fingerprint(&again["fits"][0]), fingerprint(front));
    // A landmark file per photo.
    let refused = run(&format!("{photos} --landmarks @rough/05_00.tlms -o no")).run();
    let error = "2 photo(s) and 1 --landmarks file(s)";
    assert!(refused.stderr.contains(error), "{}", refused.stderr);
}

#[test]
fn a_posterior_is_sampled_and_told() {
    let place = tempdir().unwrap();
    let run = |output: &str, arguments: &str| {
        let photo = "@rough/05_00.jpg --landmarks @rough/05_00.tlms";
        let line = format!("fit @golden/small.3dmm {photo} --size 96 -o {output} {arguments}");
        Onescan::new(place.path(), &line)
    };
    let path = |file: &str| place.path().join("out").join(file);
    run("out", "--posterior 100 --chains 2 --seed 3").succeed();
    let fit = json(&path("fit.json"));
    let found = &fit["posterior"];
    assert_eq!((&found["chains"], &found["draws"]), (&2.into(), &100.into()));
    let command = fit["command"].as_str().unwrap();
    assert!(command.ends_with("--posterior 100 --chains 2 --seed 3"), "{command}");
    let parameters = found["parameters"].as_array().unwrap();
    let mode = |name: &str| {
        let path =
            format!("/parameters/{}", name.replace('[', "/").replace(']', "").replace('.', "/"));
        fit.pointer(&path).unwrap().as_f64().unwrap()
    };
    let number = |of: &Value, name: &str| of[name].as_f64().unwrap();
    for p in parameters {
        let [mean, sd, low, high] = ["mean", "sd", "low", "high"].map(|name| number(p, name));
        assert!(low < mean && mean < high && sd > 0.0, "{p}");
        let name = p["name"].as_str().unwrap();
        let is_angle = ["pose.yaw", "pose.pitch", "pose.roll"].contains(&name);
        let mode = if is_angle { mode(name).to_degrees() } else { mode(name) };
        assert!((mode - mean).abs() < 6.0 * sd, "{name}: {mode} at the mode, {p}");
    }
    // Laplace's approximation is of that order.
    let shape = |i: usize| {
        let sampled = parameters.iter().find(|p| p["name"] == format!("shape[{i}]")).unwrap();
        number(sampled, "sd") / fit["laplace"]["shape"][i].as_f64().unwrap()
    };
    let mean = (0..10).map(shape).sum::<f64>() / 10.0;
    assert!((0.7..1.8).contains(&mean), "{mean}");
    let files = ["posterior.h5", "mean.glb", "mean.ply", "uncertainty.glb", "uncertainty.ply"];
    for file in files.into_iter().chain(["uncertainty.png"]) {
        assert!(path(file).is_file(), "{file}");
    }
    assert!(fs::read_to_string(path("report.html")).unwrap().contains("How sure that is"));
    run("again", "--posterior 100 --chains 2 --seed 3").succeed();
    let again = json(&place.path().join("again/fit.json"));
    assert_eq!(again["posterior"], *found);
    // Without, nothing of it is left.
    run("out", "").succeed();
    assert!(json(&path("fit.json")).get("posterior").is_none());
    assert!(!path("posterior.h5").exists() && !path("uncertainty.png").exists());
    for (arguments, error) in [
        ("--posterior 100 --schedule paper", "leave --schedule out"),
        ("--posterior 3", "3 is not in 100..=100000"),
        ("--chains 2", "--chains is for chains"),
    ] {
        let refused = run("no", arguments).run();
        assert!(refused.stderr.contains(error), "{}", refused.stderr);
    }
}

#[test]
fn a_chain_says_how_to_repeat_it() {
    let place = tempdir().unwrap();
    let steps = "--landmark-samples 20 --samples 30";
    for schedule in ["paper", "sampler"] {
        let arguments = format!("--schedule {schedule} {steps} --shape-rank 3");
        let command = fit(place.path(), "fit", &arguments)["command"].to_string();
        let expected = format!("--schedule {schedule} --samples 30 --landmark-samples 20 --shape");
        assert!(command.contains(&expected), "{command}");
    }
}

#[test]
fn a_model_goes_through_other_programs_formats() {
    let place = tempdir().unwrap();
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    let info = |name: &str| -> Value {
        serde_json::from_str(&run(&format!("info {name} --json"))).unwrap()
    };
    let build = "build @face/template.ply --landmarks @face/landmarks.json --rank 6 -o";
    for name in ["face.3dmm", "face.h5", "face.h5.json"] {
        run(&format!("{build} {name}"));
    }
    let (ours, binary, json) = (info("face.3dmm"), info("face.h5"), info("face.h5.json"));
    assert_eq!(binary["checksum"], json["checksum"], "both hold the same numbers");
    for field in ["vertices", "triangles", "landmarks"] {
        assert_eq!(ours[field], binary[field], "{field}");
    }
    for half in ["shape", "albedo"] {
        assert_eq!(ours[half]["variance"], binary[half]["variance"], "{half}");
    }
    run("convert face.h5 -o again.3dmm");
    run("convert face.h5.json -o again.h5");
    assert_eq!(info("again.3dmm")["checksum"], binary["checksum"]);
    let bytes = |name: &str| fs::read(place.path().join(name)).unwrap();
    assert!(bytes("again.h5") == bytes("face.h5"), "nothing was lost on the way");
    run("render face.3dmm --size 120x120 -o ours.png");
    run("render face.h5 --size 120x120 -o theirs.png");
    let picture = |name: &str| photo::read(&place.path().join(name)).unwrap();
    assert_eq!(picture("ours.png").rgb, picture("theirs.png").rgb, "the mean is the same");
}

#[test]
fn the_seed_decides() {
    let place = tempdir().unwrap();
    let fit = |name: &str, seed| fit(place.path(), name, &format!("{SHORT} --seed {seed}"));
    let (first, second, other) = (fit("a", 1), fit("b", 1), fit("c", 2));
    assert_eq!(fingerprint(&first), fingerprint(&second));
    assert_ne!(fingerprint(&first), fingerprint(&other));
    for file in ["fit.rps", "mesh.ply", "mesh.glb", "overlay.png"] {
        let bytes = |name: &str| fs::read(place.path().join(name).join(file)).unwrap();
        assert!(bytes("a") == bytes("b"), "{file} differs between equal fits");
    }
}

#[test]
fn threads_change_nothing() {
    let place = tempdir().unwrap();
    let fits = ["1", "2"].map(|threads| {
        let line = format!("fit @golden/small.3dmm {ASTRONAUT} {SHORT} --chains 3 -o {threads}");
        Onescan::new(place.path(), &line).env("RAYON_NUM_THREADS", threads).succeed();
        json(&place.path().join(threads).join("fit.json"))
    });
    for field in ["fingerprint", "accepted", "log_likelihood", "pixel_rmse", "parameters"] {
        assert_eq!(fits[0][field], fits[1][field], "{field}");
    }
}

#[test]
fn models_are_the_same_bytes_at_any_number_of_threads() {
    let place = tempdir().unwrap();
    let models = ["1", "2"].map(|threads| {
        let line = format!("build @face/template.ply --rank 6 -o {threads}.3dmm");
        Onescan::new(place.path(), &line).env("RAYON_NUM_THREADS", threads).succeed();
        fs::read(place.path().join(format!("{threads}.3dmm"))).unwrap()
    });
    assert!(models[0] == models[1]);
}

/// A fit of some seconds, interrupted in a place of its own.
struct Interrupted {
    place: TempDir,
    line: String,
}

impl Interrupted {
    fn checkpoint(&self) -> PathBuf {
        self.place.path().join("fit/checkpoint.bin")
    }

    /// Runs it until Ctrl-C. Sooner and sooner, if the fit was finished before.
    fn press_ctrl_c(&self, mut after: Duration, resume: &str) {
        loop {
            let run = Onescan::new(self.place.path(), &format!("{} {resume}", self.line))
                .interrupt(after);
            if run.code == Some(1) {
                assert!(run.stderr.contains("fit/checkpoint.bin: "), "{}", run.stderr);
                assert!(run.stderr.contains("--resume"), "{}", run.stderr);
                break;
            }
            assert_ne!(after, Duration::ZERO, "cannot be interrupted: {run:?}");
            fs::remove_dir_all(self.place.path().join("fit")).unwrap_or_default();
            after = if after.as_millis() < 10 { Duration::ZERO } else { after / 2 };
        }
    }
}

#[test]
fn an_interrupted_fit_goes_on_as_if_nothing_had_been() {
    let steps = "--schedule paper --landmark-samples 2000 --samples 6000 --chains 2";
    let whole_place = tempdir().unwrap();
    let start = Instant::now();
    let whole = fit(whole_place.path(), "fit", steps);
    let time = start.elapsed();

    let line = format!("fit @golden/small.3dmm {ASTRONAUT} -o fit {steps}");
    let fit = Interrupted { place: tempdir().unwrap(), line };
    fit.press_ctrl_c(time / 2, "");
    let left: Vec<_> = fs::read_dir(fit.place.path().join("fit")).unwrap().collect();
    assert_eq!(left.len(), 1, "only the checkpoint is written: {left:?}");

    let line = format!("{} --resume", fit.line);
    Onescan::new(fit.place.path(), &line).succeed();
    let resumed = json(&fit.place.path().join("fit/fit.json"));
    for field in ["fingerprint", "steps", "accepted", "log_likelihood", "trace", "parameters"] {
        assert_eq!(resumed[field], whole[field], "{field}");
    }
    assert!(!fit.checkpoint().exists(), "a finished fit keeps no checkpoint");
}

#[test]
fn models_and_meshes_are_drawn_from_any_side_with_smooth_outlines() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    let drawn = |line: &str| {
        run(&format!("{line} -o a.png"));
        photo::read(&at("a.png")).unwrap()
    };
    let model = drawn("render @golden/small.3dmm --size 120");
    assert_eq!((model.width, model.height), (120, 120));
    let mesh = drawn("render @face/template.ply --size 120x90 --yaw 40");
    assert_eq!((mesh.width, mesh.height), (120, 90));
    assert_ne!(drawn("render @face/template.ply --size 120x90"), mesh);
    // Where the outline crosses a row, the ground shows through in part.
    let brightness = |x: u32, y: u32| -> u32 {
        mesh.pixel(x, y).unwrap_or_default().iter().map(|c| u32::from(*c)).sum()
    };
    let edge = |y: u32| (0..119).find(|x| brightness(*x, y) < 3 * 255).map(|x| (x, y));
    let rows: Vec<_> = (0..90).filter_map(edge).collect();
    let soft = rows.iter().filter(|(x, y)| brightness(*x, *y) > brightness(x + 1, *y) + 60);
    assert!(2 * soft.count() > rows.len(), "of {} rows", rows.len());

    run("inspect @face/template.ply --picture sides.png");
    let sides = photo::read(&at("sides.png")).unwrap();
    assert_eq!(sides.width, 4 * 384 + 3 * 4);
    run("sample @golden/small.3dmm -n 2 --size 64 --yaw -30 -o samples");
    assert_eq!(photo::read(&at("samples/samples.png")).unwrap().width, 2 * 64 + 4);
    let refused =
        Onescan::new(place.path(), "render @face/template.ply --fit f.json -o a.png").run();
    assert!(refused.stderr.contains("a mesh has none"), "{}", refused.stderr);
}
