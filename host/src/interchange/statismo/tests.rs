//! Models through files and back, and files of other writers.

use super::*;
use crate::interchange::{Format, lost, parse, to_bytes};
use crate::json;
use proptest::prelude::*;
use serde_json::{Value, json};
use std::path::PathBuf;

fn process(seed: u64, vertices: usize, rank: usize) -> Process {
    let number = |i: usize| {
        // Numbers that 32 bits hold, of any sign.
        let hash = (i as u64 + 1000 * seed).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        f64::from((hash >> 40) as i32 % 1000 - 500) / 64.0
    };
    let mean = (0..vertices).map(|v| [0, 1, 2].map(|k| number(3 * v + k) as f32)).collect();
    let basis = Mat::from_fn(3 * vertices, rank, |row, k| f64::from(number(row * 7 + k) as f32));
    let variances = (0..rank).map(|k| 4.0 / (k + 1) as f64).map(|v| f64::from(v as f32));
    Process::new(mean, basis, variances.collect(), 0.25)
}

fn example() -> Morphable {
    let axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let uncertainty = Uncertainty { stddevs: [0.5, 1.0, 2.0], pcvectors: axes };
    Morphable {
        shape: process(1, 6, 3),
        albedo: process(2, 6, 2),
        expression: Some(process(3, 6, 1)),
        reference: Some(process(4, 6, 0).mean),
        triangles: vec![[0, 1, 2], [3, 4, 5], [0, 5, 3]],
        landmarks: vec![
            Landmark { name: "tip".into(), vertex: 4 },
            Landmark { name: "œil".into(), vertex: 1 },
        ],
        uncertainties: [("tip".to_string(), uncertainty)].into(),
        occlusion: None,
        provenance: "format = \"statismo\"\n".into(),
    }
}

fn same_process(a: &Process, b: &Process) {
    assert_eq!(a.mean, b.mean);
    assert_eq!(a.variances, b.variances);
    assert_eq!(a.basis, b.basis);
    assert_eq!(a.noise, b.noise);
}

#[track_caller]
fn same_model(a: &Morphable, b: &Morphable) {
    same_process(&a.shape, &b.shape);
    same_process(&a.albedo, &b.albedo);
    same_process(a.expression.as_ref().unwrap(), b.expression.as_ref().unwrap());
    assert_eq!(a.reference, b.reference);
    assert_eq!(a.triangles, b.triangles);
    assert_eq!(a.landmarks, b.landmarks);
    assert_eq!(a.uncertainties, b.uncertainties);
    assert_eq!(a.provenance, b.provenance);
}

#[test]
fn what_is_written_reads_back_to_the_last_bit() {
    for format in [Format::Hdf5, Format::Hdf5Json] {
        let bytes = to_bytes(&example(), format).unwrap();
        let import = parse(format, bytes.clone()).unwrap();
        assert_eq!(import.notes, [""; 0]);
        same_model(&import.model, &example());
        assert!(to_bytes(&import.model, format).unwrap() == bytes, "{format:?}");
    }
}

#[test]
fn a_zero_expression_reads_back() {
    let model = Morphable { expression: Some(Process::zero(6)), ..example() };
    for format in [Format::Hdf5, Format::Hdf5Json] {
        let again = parse(format, to_bytes(&model, format).unwrap()).unwrap().model;
        same_process(again.expression.as_ref().unwrap(), &Process::zero(6));
    }
}

#[test]
fn a_model_without_components_is_one() {
    let rigid = Morphable {
        shape: process(1, 6, 0),
        albedo: process(2, 6, 0),
        expression: None,
        ..example()
    };
    for format in [Format::Hdf5, Format::Hdf5Json] {
        let bytes = to_bytes(&rigid, format).unwrap();
        let model = parse(format, bytes).unwrap().model;
        same_process(&model.shape, &rigid.shape);
        assert!(model.expression.is_none());
    }
}

#[test]
fn a_3dmm_of_columns_of_any_length_deforms_the_same() {
    let model = example();
    let file = model.to_model(i16::MAX).unwrap();
    let back = Morphable::of(&file.view());
    // Components are in another order there.
    let covariance = |process: &Process| {
        let q = process.scaled_basis();
        &q * q.transpose()
    };
    let (a, b) = (covariance(&model.shape), covariance(&back.shape));
    let error = (&a - &b).norm_max() / a.norm_max();
    assert!(error < 1e-3, "{error}");
    assert!((back.shape.total_variance / model.shape.held() - 1.0).abs() < 1e-12);
    let words = lost(&model, Format::ThreeDmm).join("; ");
    for part in ["noise of the shape", "noise of the albedo", "expressions (1", "reference"] {
        assert!(words.contains(part), "{words}");
    }
}

/// The example as JSON, with something changed.
fn changed(change: impl FnOnce(&mut Edit)) -> Result<Import> {
    let bytes = to_bytes(&example(), Format::Hdf5Json).unwrap();
    let mut edit = Edit(json::parse(std::str::from_utf8(&bytes).unwrap()).unwrap());
    change(&mut edit);
    parse(Format::Hdf5Json, edit.0.to_string().into_bytes())
}

struct Edit(Value);

impl Edit {
    /// The dataset at a path.
    fn at(&mut self, path: &str) -> &mut Value {
        let datasets = self.0["datasets"].as_object_mut().unwrap();
        datasets.values_mut().find(|d| d["alias"][0] == format!("/{path}")).unwrap()
    }

    fn remove(&mut self, path: &str) {
        let groups = self.0["groups"].as_object_mut().unwrap();
        let (group, name) = path.rsplit_once('/').unwrap();
        let group = groups.values_mut().find(|g| g["alias"][0] == format!("/{group}")).unwrap();
        group["links"].as_array_mut().unwrap().retain(|link| link["title"] != name);
    }

    fn set(&mut self, path: &str, shape: &[i32], value: Value) {
        let dataset = self.at(path);
        dataset["shape"] = json!({ "dims": shape });
        dataset["value"] = value;
    }
}

#[test]
fn version_0_8_has_scaled_columns() {
    let import = changed(|edit| {
        for part in ["shape", "color", "expression"] {
            edit.remove(&format!("{part}/version"));
        }
    })
    .unwrap();
    let q = import.model.shape.scaled_basis();
    let error = (&q - &example().shape.basis).norm_max();
    assert!(error < 1e-12, "the file's columns are U√λ: {error}");
}

#[test]
fn old_names_of_the_reference_are_read() {
    let import = changed(|edit| {
        for part in ["shape", "color", "expression"] {
            let transposed = |value: &Value| -> Value {
                let at = |i: usize, k: usize| value[k][i].clone();
                let n = value[0].as_array().unwrap().len();
                (0..n).map(|i| json!([at(i, 0), at(i, 1), at(i, 2)])).collect()
            };
            let mut links = Vec::new();
            for (new, old) in [("points", "vertex-coordinates"), ("cells", "triangle-list")] {
                let dataset = edit.at(&format!("{part}/representer/{new}"));
                dataset["value"] = transposed(&dataset["value"]);
                let n = dataset["value"].as_array().unwrap().len();
                dataset["shape"]["dims"] = json!([n, 3]);
                let id = format!("{part}-{new}");
                let dataset = dataset.clone();
                edit.0["datasets"][&id] = dataset;
                links.push(json!({"collection": "datasets", "id": id, "title": old}));
                edit.remove(&format!("{part}/representer/{new}"));
            }
            let id = format!("{part}-mesh");
            edit.0["groups"][&id] = json!({ "links": links, "alias": ["x"] });
            let groups = edit.0["groups"].as_object_mut().unwrap();
            let path = format!("/{part}/representer");
            let group = groups.values_mut().find(|g| g["alias"][0] == path).unwrap();
            let link = json!({"collection": "groups", "id": id, "title": "reference-mesh"});
            group["links"].as_array_mut().unwrap().push(link);
        }
    })
    .unwrap();
    same_model(&import.model, &example());
}

#[test]
fn a_unit_of_length_is_kept_to() {
    let import = changed(|edit| {
        let mut unit = edit.at("shape/model/noiseVariance").clone();
        unit["value"] = json!(0.01);
        unit["shape"] = json!({});
        edit.0["datasets"]["unit"] = unit;
        let groups = edit.0["groups"].as_object_mut().unwrap();
        let group = groups.values_mut().find(|g| g["alias"][0] == "/shape/representer").unwrap();
        let link = json!({"collection": "datasets", "id": "unit", "title": "length-unit"});
        group["links"].as_array_mut().unwrap().push(link);
    })
    .unwrap();
    let (found, centimetres) = (import.model.shape, example().shape);
    for (a, b) in found.instance(&[1.0]).iter().zip(centimetres.instance(&[1.0])) {
        assert!((a[0] - 10.0 * b[0]).abs() < 1e-3, "{a:?} {b:?}");
    }
    assert_eq!(import.model.landmarks, example().landmarks);
}

#[test]
fn landmarks_off_their_vertices_are_told() {
    let moved = |by: f64| {
        let at = example().reference()[4].map(f64::from);
        let text = json!([{"id": "tip", "coordinates": [at[0] + by, at[1], at[2]]}]);
        changed(|edit| {
            edit.at("metadata/landmarks/json")["value"] = json!(text.to_string());
        })
        .unwrap()
    };
    assert_eq!(moved(0.0).notes, [""; 0]);
    let near = moved(1e-5);
    assert_eq!(near.model.landmarks, example().landmarks[..1]);
    assert!(near.notes[0].starts_with("1 of 1 landmarks are not exactly"), "{:?}", near.notes);
    let far = moved(0.1);
    assert!(far.model.landmarks.is_empty());
    assert!(far.notes[0].contains("at no vertex: tip"), "{:?}", far.notes);
}

#[test]
fn faults_name_the_dataset() {
    type Change = fn(&mut Edit);
    let cases: [(Change, &str); 23] = [
        (|e| e.remove("shape/model/mean"), "shape/model/mean: there is no such"),
        (|e| e.remove("color/model/mean"), "a model of shape alone"),
        (
            |e| e.at("color/model/mean")["value"] = json!(vec![200.0; 18]),
            "color/model/mean: most colours are above 1",
        ),
        (|e| e.remove("shape/model/pcaBasis"), "shape/model/pcaBasis: there is no such"),
        (|e| e.remove("color/model/pcaVariance"), "color/model/pcaVariance: there is no such"),
        (|e| e.remove("shape/representer/points"), "shape/representer/points: there is no"),
        (|e| e.remove("shape/representer/cells"), "shape/representer/cells: there is no such"),
        (|e| e.set("shape/model/mean", &[3], json!([1, 2, 3])), "mean: shape [3], exp"),
        (|e| e.set("shape/model/mean", &[6, 3], json!([])), "mean: shape [6, 3], exp"),
        (|e| e.set("shape/model/pcaBasis", &[18], json!([])), "pcaBasis: shape [18]"),
        (|e| e.set("shape/model/pcaBasis", &[17, 3], json!([])), "shape [17, 3], exp"),
        (|e| e.set("shape/model/pcaVariance", &[2], json!([1, 1])), "shape [2], exp"),
        (
            |e| e.set("shape/model/pcaVariance", &[3], json!([1, -1, 1])),
            "pcaVariance: entry 1 is -1",
        ),
        (|e| e.set("color/model/noiseVariance", &[1], json!([-1])), "noiseVariance: -1"),
        (|e| e.set("color/model/noiseVariance", &[], json!(1e99)), "entry 0 is inf"),
        (|e| e.set("shape/model/noiseVariance", &[], json!(null)), "expected numbers"),
        (|e| e.set("shape/representer/points", &[6, 3], json!([])), "points: shape [6"),
        (
            |e| e.set("shape/representer/cells", &[3, 1], json!([[0], [1], [6]])),
            "cells: triangle 0",
        ),
        (
            |e| e.set("shape/representer/cells", &[3, 1], json!([[0], [-1], [1]])),
            "cells: triangle 0",
        ),
        (|e| e.set("shape/representer/cells", &[3, 0], json!([[], [], []])), "is empty"),
        (|e| e.at("expression/representer/points")["value"][0][0] = json!(77), "another reference"),
        (|e| e.at("color/representer/colorspace")["value"] = json!("HSV"), "only RGB"),
        (
            |e| e.at("metadata/landmarks/json")["value"] = json!("[{}]"),
            "metadata/landmarks/json: missing field `id`",
        ),
    ];
    for (change, part) in cases {
        let message = changed(change).unwrap_err().to_string();
        assert!(message.contains(part), "{message:?} does not say {part:?}");
        assert!(!message.contains('\n'));
    }
}

#[test]
fn numbers_that_are_none_are_refused_in_binary_too() {
    for part in ["shape", "color", "expression"] {
        let mut model = example();
        let process = match part {
            "shape" => &mut model.shape,
            "color" => &mut model.albedo,
            _ => model.expression.as_mut().unwrap(),
        };
        process.basis[(4, 0)] = f64::NAN;
        let bytes = to_bytes(&model, Format::Hdf5).unwrap();
        let message = parse(Format::Hdf5, bytes).unwrap_err().to_string();
        assert!(message.starts_with(&format!("{part}/model/pcaBasis: entry")), "{message}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]
    #[test]
    fn damaged_files_are_refused_or_read_but_never_panic(
        damage in proptest::collection::vec((0_usize..20_000, any::<u8>()), 1..6),
        length in 0.3..1.5,
    ) {
        for format in [Format::Hdf5, Format::Hdf5Json] {
            let mut bytes = to_bytes(&example(), format).unwrap();
            for (at, value) in &damage {
                let at = at % bytes.len();
                bytes[at] = *value;
            }
            bytes.truncate((bytes.len() as f64 * length) as usize);
            let _ = parse(format, bytes);
        }
    }
}

/// The engine's own files; set `ONESCAN_INTEROP` to the folder that has them.
fn engines(name: &str) -> Option<Import> {
    let folder = std::env::var_os("ONESCAN_INTEROP").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/interop"),
        Into::into,
    );
    let path = folder.join(name);
    if !path.exists() {
        eprintln!("skipped: {} is not there", path.display());
        return None;
    }
    Some(crate::interchange::read(&path).unwrap())
}

#[track_caller]
fn close(found: [f64; 3], expected: [f64; 3]) {
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < 1e-9 * (1.0 + b.abs()), "{found:?} {expected:?}");
    }
}

#[test]
fn a_file_written_in_cpp_gives_the_engines_instances() {
    let Some(Import { model, notes }) = engines("random-l4.h5") else { return };
    assert_eq!((model.shape.vertices(), model.triangles.len()), (1529, 3044));
    assert_eq!((model.shape.rank(), model.albedo.rank()), (19, 19));
    assert!(model.expression.is_none());
    assert_eq!([model.shape.noise as f32, model.albedo.noise as f32], [0.01234, 0.02345]);
    let shape = model.shape.instance(&[1.0, -0.5, 0.25]);
    close(shape[0], [-58.7142918061, 43.1910950253, 78.6974501295]);
    close(shape[1528], [55.5401871068, -21.683491286, -24.452748768]);
    let albedo = model.albedo.instance(&[1.0, -0.5, 0.25]);
    close(albedo[0], [1.0195382106, 0.2739719009, 0.0905622253]);
    eprintln!("{} landmarks; {notes:?}", model.landmarks.len());
    assert!(model.landmarks.iter().any(|l| l.name == "center.nose.tip"));
}

#[test]
fn a_file_written_in_java_gives_the_engines_instances() {
    let Some(Import { model, notes }) = engines("random-momo.h5") else { return };
    assert_eq!((model.shape.vertices(), model.triangles.len()), (25, 32));
    assert_eq!((model.shape.rank(), model.albedo.rank()), (10, 10));
    assert_eq!(model.expression.as_ref().map(Process::rank), Some(10));
    let shape = model.shape.instance(&[1.0, 0.0, 0.0, -2.0]);
    close(shape[0], [-0.6225980947, 1.4049323887, -0.1426407499]);
    assert_eq!(model.landmarks.len(), 5, "none is exact, all are near: {notes:?}");
    assert!(notes[0].starts_with("5 of 5 landmarks are not exactly"), "{notes:?}");
    // What was read is written and read again without loss.
    let again = parse(Format::Hdf5, to_bytes(&model, Format::Hdf5).unwrap()).unwrap();
    same_model(&again.model, &model);
}
