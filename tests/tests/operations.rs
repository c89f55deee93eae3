//! Models of models, by the command: what was learnt from samples of a model is that model again.

use onescan::mesh::ply;
use onescan::photo;
use onescan_tests::program::Onescan;
use serde_json::Value;
use std::fs;
use tempfile::tempdir;

#[test]
fn models_are_learnt_cut_out_conditioned_and_measured() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    let info = |model: &str| -> Value {
        serde_json::from_str(&run(&format!("info {model} --json"))).unwrap()
    };
    let variance = |info: &Value| info["shape"]["total_variance"].as_f64().unwrap();

    run("sample @golden/small.3dmm -n 5 -o samples");
    run("model pca samples -o pca.3dmm");
    let (small, pca) = (info("@golden/small.3dmm"), info("pca.3dmm"));
    assert_eq!((&pca["shape"]["rank"], &pca["vertices"]), (&4.into(), &small["vertices"]));

    run("model project pca.3dmm samples/sample_03.ply -o again.ply --coefficients c.json");
    let [known, again] = ["samples/sample_03.ply", "again.ply"].map(|f| ply::read(&at(f)).unwrap());
    for (a, b) in known.points.as_flattened().iter().zip(again.points.as_flattened()) {
        assert!((a - b).abs() < 0.05, "{a} became {b}");
    }
    let c: Value = serde_json::from_slice(&fs::read(at("c.json")).unwrap()).unwrap();
    assert_eq!(c["shape"].as_array().unwrap().len(), 4);

    run("model augment pca.3dmm @golden/small.3dmm -o both.3dmm");
    let both = info("both.3dmm");
    let sum = variance(&pca) + variance(&small);
    assert!((variance(&both) - sum).abs() < 1e-6 * sum);

    run("model region @golden/small.3dmm --around center.nose.tip --radius 40 -o nose.3dmm");
    let nose = info("nose.3dmm");
    assert!(nose["vertices"].as_u64() < small["vertices"].as_u64());
    assert!(nose["landmarks"]["center.nose.tip"].is_u64());

    // Another program's format comes and goes as ours does.
    run("model augment pca.3dmm @golden/small.3dmm -o both.h5");
    assert_eq!(fs::read(at("both.h5")).unwrap()[..4], *b"\x89HDF");
    run("model project both.h5 samples/sample_03.ply -o from_h5.ply");
    let far = ply::read(&at("from_h5.ply")).unwrap();
    for (a, b) in known.points.as_flattened().iter().zip(far.points.as_flattened()) {
        assert!((a - b).abs() < 0.05, "{a} became {b}");
    }

    run("model recentre @golden/small.3dmm samples/sample_00.ply -o moved.3dmm");
    run("model posterior @golden/small.3dmm --mesh samples/sample_01.ply -o known.3dmm");
    assert!(variance(&info("known.3dmm")) < variance(&small));

    run("modes known.3dmm -n 2 -o modes");
    // A row for each component, with a line of words below its pictures.
    let sheet = photo::read(&at("modes/modes.png")).unwrap();
    let [picture, words] = [256, 22];
    let rows = (sheet.height + 4) / (picture + words + 4);
    assert_eq!((sheet.width, sheet.height), (6 * 260 - 4, rows * (picture + words + 4) - 4));
    let below = sheet.cropped(0, picture, 256, words);
    assert!(below.rgb.contains(&[0; 3]) && below.rgb.contains(&[255; 3]));
    assert!(at("modes/albedo_2_plus.ply").exists());

    run("evaluate pca.3dmm both.3dmm --meshes samples --samples 10 --surface-samples 2 -o report");
    let found: Value =
        serde_json::from_slice(&fs::read(at("report/metrics.json")).unwrap()).unwrap();
    let last = found["models"][0]["metrics"]["shape"].as_array().unwrap().last().unwrap();
    assert!(last["generalization"]["mean"].as_f64().unwrap() < 0.05, "{last}");
    assert!(last["surface_specificity"]["mean"].as_f64().unwrap() > 0.1, "{last}");
    assert!(fs::read_to_string(at("report/report.html")).unwrap().contains("<svg"));
}

#[test]
fn a_plane_of_symmetry_is_an_axis_given_or_found() {
    let place = tempdir().unwrap();
    let at = |name: &str| place.path().join(name);
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    run("modes @golden/small.3dmm -n 1 -o modes");
    run("build modes/mean.ply -o axis.3dmm --rank 5");
    run("build modes/mean.ply -o plane.3dmm --rank 5 --mirror -2,0,0,0");
    assert_eq!(fs::read(at("axis.3dmm")).unwrap(), fs::read(at("plane.3dmm")).unwrap());

    // The same scan, on its side and elsewhere.
    let mut scan = ply::read(&at("modes/mean.ply")).unwrap();
    for p in &mut scan.points {
        *p = [50.0 - p[1], p[0] + 5.0, p[2]];
    }
    let mut bytes = Vec::new();
    ply::write(&mut bytes, &scan, ply::Encoding::default()).unwrap();
    fs::write(at("moved.ply"), bytes).unwrap();
    run("build moved.ply -o given.3dmm --rank 5 --up -x --mirror 0,1,0,5");
    run("build moved.ply -o found.3dmm --rank 5 --up -x --mirror find");
    let first = |model: &str| -> f64 {
        let info: Value = serde_json::from_str(&run(&format!("info {model} --json"))).unwrap();
        info["albedo"]["total_variance"].as_f64().unwrap()
    };
    let expected = first("axis.3dmm");
    for model in ["given.3dmm", "found.3dmm"] {
        let variance = first(model);
        assert!((variance / expected - 1.0).abs() < 1e-3, "{model}: {variance}, not {expected}");
    }
}

#[test]
fn an_occlusion_map_is_painted_set_and_believed() {
    let place = tempdir().unwrap();
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    // Of the mean, painted: the lower half of the face is hidden.
    run("modes @golden/small.3dmm -n 1 -o modes");
    let mut painted = ply::read(&place.path().join("modes/mean.ply")).unwrap();
    for (color, point) in painted.colors.iter_mut().zip(&painted.points) {
        *color = [if point[1] < 0.0 { 1.0 } else { 0.0 }; 3];
    }
    let mut bytes = Vec::new();
    ply::write(&mut bytes, &painted, ply::Encoding::Binary).unwrap();
    fs::write(place.path().join("painted.ply"), bytes).unwrap();
    run("model occlusion @golden/small.3dmm --map painted.ply -o veiled.3dmm");
    let info: Value = serde_json::from_str(&run("info veiled.3dmm --json")).unwrap();
    assert_eq!(info["occlusion_map"], true);

    let seen = |model: &str, out: &str| {
        run(&format!(
            "fit {model} @photos/astronaut.png --landmarks @photos/astronaut.tlms -o {out}"
        ));
        let mask = photo::read(&place.path().join(out).join("mask.png")).unwrap();
        let half = mask.rgb.len() / 2;
        let count = |part: &[[u8; 3]]| part.iter().filter(|pixel| pixel[0] > 127).count();
        [count(&mask.rgb[..half]), count(&mask.rgb[half..])]
    };
    let (plain, veiled) = (seen("@golden/small.3dmm", "plain"), seen("veiled.3dmm", "veiled"));
    assert!(veiled[1] < plain[1], "{veiled:?} {plain:?}");
    assert!(2 * veiled[0] > plain[0], "{veiled:?} {plain:?}");

    run("convert veiled.3dmm -o lost.h5");
    let info: Value = serde_json::from_str(&run("info lost.h5 --json")).unwrap();
    assert_eq!(info["occlusion_map"], false);
}
