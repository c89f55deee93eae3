//! Objects that are no faces, by the command.

use onescan::photo;
use onescan_tests::program::Onescan;
use serde_json::Value;
use std::fs;
use tempfile::tempdir;

#[test]
fn a_fish_is_fitted_by_all_models_of_the_other() {
    let place = tempdir().unwrap();
    Onescan::new(place.path(), "experiment fish -n 1 --fixtures @ -o fish").succeed();
    let at = |name: &str| place.path().join("fish").join(name);
    let found: Value = serde_json::from_slice(&fs::read(at("objects.json")).unwrap()).unwrap();
    let models = found["models"].as_array().unwrap();
    assert_eq!(models.len(), 4);
    for model in models {
        let error = |i: usize| model["pixel_rmse"][i].as_f64().unwrap();
        assert!(error(1) < 0.5 * error(0) && error(1) < 0.12, "{model}");
    }
    assert_eq!(photo::read(&at("samples.png")).unwrap().height, 4 * 256 + 3 * 4);
    assert!(photo::read(&at("fits.png")).is_ok());
    assert!(fs::read_to_string(at("report.html")).unwrap().contains("symmetric-xyz"));
}
