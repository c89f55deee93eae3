//! Who is in a photo, mixtures of models, and the jobs of the experiment, with the real program.

use onescan::demo::{FIT_LANDMARKS, random_light, synthetic_photo, template};
use onescan::experiment::faces::scan_meshes;
use onescan::fit::{Control, Job, mixture};
use onescan::mesh::{Axis, Mesh};
use onescan::model::build::{BuildOptions, Method, build};
use onescan::model::decompose::Truncation;
use onescan::model::kernel::Kernels;
use onescan::model::layout;
use onescan::model_file::OwnedModel;
use onescan::photo;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::render;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use onescan_tests::coarse::coarse;
use onescan_tests::program::{Onescan, fixtures, json};
use std::fs;
use std::path::Path;
use tempfile::tempdir;

/// Copies rough pictures at an angle, and their landmarks, to a directory.
fn copy(to: &Path, yaw: &str) {
    fs::create_dir(to).unwrap();
    for person in ["05", "23", "41"] {
        for extension in ["jpg", "tlms"] {
            let name = format!("{person}_{yaw}.{extension}");
            fs::copy(fixtures().join("rough").join(&name), to.join(name)).unwrap();
        }
    }
}

#[test]
fn people_are_recognised_from_photos_and_from_fits() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    copy(&at("gallery"), "00");
    copy(&at("probes"), "15");
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    run("build @face/template.ply --landmarks @face/landmarks.json --rank 40 -o face.3dmm");
    let line = "recognise gallery probes --model face.3dmm -o who --person-until _";
    let text = run(line);
    assert!(text.ends_with('\n') && text.contains("05_15  05_00"), "{text}");
    let found = json(&at("who/ranks.json"));
    assert_eq!(found["models"][0], "face.3dmm");
    assert_eq!(found["told"]["first"]["of"], 3);
    assert_eq!(found["told"]["first"]["hits"], 3, "{text}");
    let csv = fs::read_to_string(at("who/ranks.csv")).unwrap();
    assert_eq!(csv.lines().count(), 1 + 9);
    let page = fs::read_to_string(at("who/report.html")).unwrap();
    assert!(page.contains("3 of 3 right") && page.contains("<img"));

    // What has been fitted is not fitted again.
    let fit = at("who/fits/gallery/05_00.json");
    let before = fs::metadata(&fit).unwrap().modified().unwrap();
    assert_eq!(run(line), text);
    assert_eq!(fs::metadata(&fit).unwrap().modified().unwrap(), before);
    // One that is missing is.
    fs::remove_file(&fit).unwrap();
    assert_eq!(run(line), text);
    assert!(fit.is_file());

    // Its own fits, and those of `onescan fit`, serve as well as photos.
    assert_eq!(run("recognise who/fits/gallery who/fits/probes -o again --person-until _"), text);
    run("fit face.3dmm probes/23_15.jpg --landmarks probes/23_15.tlms -o one/23_15");
    let alone = run("recognise who/fits/gallery one/23_15 -o single");
    let of = |text: &str| text.lines().find(|l| l.starts_with("23_15")).unwrap().to_owned();
    assert_eq!(of(&alone), of(&text));

    // What a terminal would obey is shown, whatever files are called.
    #[cfg(unix)]
    {
        fs::create_dir(at("named")).unwrap();
        fs::copy(&fit, at("named/05\u{1b}[31m\u{7}.json")).unwrap();
        let text = run("recognise named one/23_15 -o shown");
        assert!(text.contains("05\\u{1b}[31m\\u{7} ") && !text.contains('\u{1b}'), "{text:?}");
    }

    // Another model's do not.
    run("fit @golden/small.3dmm probes/23_15.jpg --landmarks probes/23_15.tlms -o other/23_15");
    let line = "recognise who/fits/gallery other -o never";
    let refused = Onescan::new(place.path(), line).run();
    assert_eq!(refused.code, Some(1));
    assert!(refused.stderr.contains("23_15 by small.3dmm, which is another model"), "{refused:?}");
}

#[test]
fn of_equal_models_a_mixture_keeps_the_weights() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    fs::create_dir(at("models")).unwrap();
    for name in ["models/a.3dmm", "models/b.3dmm"] {
        fs::copy(fixtures().join("golden/small.3dmm"), at(name)).unwrap();
    }
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    run("model mix models/a.3dmm models/b.3dmm --weights 1 3 -o two.toml");
    let text = fs::read_to_string(at("two.toml")).unwrap();
    assert!(text.starts_with("[[component]]\nmodel = \"models/a.3dmm\"\nweight = 1.0\n"), "{text}");

    let photo = "@photos/astronaut.png --landmarks @photos/astronaut.tlms -o fit";
    run(&format!("fit two.toml {photo}"));
    let fit = json(&at("fit/fit.json"));
    assert_eq!(fit["model"]["file"], "b.3dmm");
    assert_eq!(fit["mixture"].as_array().unwrap().len(), 2);
    let weight = fit["mixture"][0]["weight"].as_f64().unwrap();
    assert!((weight - 0.25).abs() < 1e-9, "{weight}");
    assert_eq!(fit["mixture"][1]["before"], 0.75);
    assert_eq!(fit["mixture"][0]["ln_evidence"], fit["mixture"][1]["ln_evidence"]);
    assert!(fit["command"].as_str().unwrap().starts_with("onescan fit two.toml "));
    let components = json(&at("fit/components.json"));
    assert_eq!(components["fits"][1]["fingerprint"], fit["fingerprint"]);
    assert!(fs::read_to_string(at("fit/report.html")).unwrap().contains("The mixture"));

    run(&format!("fit models/a.3dmm models/b.3dmm {photo}"));
    let fit = json(&at("fit/fit.json"));
    assert_eq!(
        (&fit["model"]["file"], &fit["mixture"][1]["weight"]),
        (&"a.3dmm".into(), &0.5.into())
    );

    // A fit of one model leaves nothing of it.
    run(&format!("fit models/a.3dmm {photo}"));
    assert!(json(&at("fit/fit.json")).get("mixture").is_none());
    assert!(!at("fit/components.json").exists());
}

/// A small model of a mesh.
fn model(mesh: &Mesh) -> OwnedModel {
    let (_, landmarks) = template().unwrap();
    let (mesh, landmarks) = coarse(mesh, &landmarks, 7.0);
    let options = BuildOptions {
        scan_name: "scan",
        kernels: Kernels::named("symmetric-full", Some(Axis::X)).unwrap(),
        method: Method::Exact(Truncation::Rank(30)),
        millimetres: 1.0,
    };
    build(&mesh, &landmarks, &options, &mut |_, _| ()).unwrap().model
}

/// A picture of a random face of the model, not far from its mean.
fn picture(model: &OwnedModel, seed: u64) -> (Picture, Tlms) {
    let mut rng = Rng::new(seed, 0);
    let model = model.view();
    let mut draw = |count| -> Vec<f32> { (0..count).map(|_| rng.normal_sd(0.4)).collect() };
    let (shape, albedo) = (draw(30), draw(30));
    let face = render::instance(&model, &shape, &albedo);
    let landmarks: Vec<_> = (model.landmarks())
        .map(|(name, vertex)| onescan::mesh::landmarks::Landmark { name: name.into(), vertex })
        .collect();
    let rigid = layout::rigid(&face, &landmarks).unwrap();
    let mut scene = Scene::initial(256, 256, 0, 0);
    random_light(&mut scene, &mut rng);
    synthetic_photo(&rigid.view(), &scene, 0.02, &FIT_LANDMARKS, &mut rng).unwrap()
}

#[test]
fn a_face_drawn_from_a_component_is_told_to_be_of_it() {
    let scans = scan_meshes(&fixtures()).unwrap();
    let models = [&template().unwrap().0, &scans[0], &scans[5]].map(model);
    let views = models.each_ref().map(|model| model.view());
    let mut told = Vec::new();
    for (own, model) in models.iter().enumerate() {
        for seed in 0..2 {
            let (photo, landmarks) = picture(model, seed);
            let jobs =
                |model| -> Vec<Job<'_>> { vec![Job::new(model, &photo, &landmarks).unwrap()] };
            let jobs: Vec<_> = views.iter().map(jobs).collect();
            let found =
                mixture::find(&jobs, &[1.0 / 3.0; 3], &Control::default()).unwrap().unwrap();
            let ln: Vec<f64> = found.fits.iter().filter_map(|f| f[0].ln_evidence()).collect();
            told.push((own, found.best, ln));
        }
    }
    assert!(told.iter().all(|(own, best, _)| own == best), "{told:?}");
}

#[test]
fn the_experiment_is_a_list_of_jobs() {
    let place = tempdir().unwrap();
    let out = "experiment recognition -o out --fixtures @";
    let jobs = |options: &str| Onescan::new(place.path(), &format!("{out} {options}")).succeed();
    let quick = jobs("--jobs --quick");
    assert_eq!(quick.lines().count(), 24);
    let first = quick.lines().next().unwrap();
    assert!(first.ends_with("--threads 1 --job clean/symmetric-full/00"), "{first}");
    assert_eq!(jobs("--jobs").lines().count(), 84);
    assert_eq!(jobs("--jobs --pictures @rough").lines().count(), 168);
    assert!(!place.path().join("out").exists());
}

#[test]
fn photos_stand_beside_what_models_make_of_them() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let photos = "experiment photos -o out --fixtures @ --rank 5 --models ten-scan-pca,scan-03";
    Onescan::new(place.path(), &format!("{photos} @rough/05_00.jpg @rough/23_45.jpg")).succeed();
    // A row of photos and a row a model, each with a line of words; two rows a model with masks.
    let words = 22;
    for (name, rows) in [("seen.png", 3), ("turned.png", 3), ("masks.png", 5)] {
        let sheet = photo::read(&at("out").join(name)).unwrap();
        let captions = 3 * words;
        assert_eq!([sheet.width, sheet.height], [2 * 256 + 4, rows * 260 - 4 + captions], "{name}");
    }
    let sheet = photo::read(&at("out/seen.png")).unwrap();
    let row = |y: u32| sheet.cropped(0, y * (256 + words + 4), 256, 256);
    let differing =
        |a: &Picture, b: &Picture| a.rgb.iter().zip(&b.rgb).filter(|(a, b)| a != b).count();
    let [photo, one, other] = [0, 1, 2].map(row);
    // The models cover the face, and not the corners.
    for model in [&one, &other] {
        assert!(
            (10_000..50_000).contains(&differing(model, &photo)),
            "{}",
            differing(model, &photo)
        );
    }
    assert!(differing(&one, &other) > 10_000);
    assert_eq!(one.cropped(0, 0, 30, 30), photo.cropped(0, 0, 30, 30));
    assert!(fs::read_to_string(at("out/report.html")).unwrap().contains("What is hidden"));

    fs::write(at("blank.png"), Picture::filled(300, 300, [90; 3]).to_png().unwrap()).unwrap();
    for (bad, says) in [
        ("blank.png", "blank.png: no face found"),
        ("nobody", "nobody: No such file"),
        ("@rough/05_00.jpg --models basel", "no model \"basel\"; there are standard-full"),
    ] {
        let run = Onescan::new(place.path(), &format!("{photos} {bad}")).run();
        assert!(run.code == Some(1) && run.stderr.contains(says), "{}", run.stderr);
    }
}
