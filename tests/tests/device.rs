//! The case that every target computes, computed here: by each engine, with much and with little
//! memory. `cargo xtask golden` writes its hashes, `cargo xtask golden --device` its inputs.

use onescan::demo::template_model;
use onescan::model::export::{ExportOptions, export};
use onescan::photo::picture::Picture;
use onescan::photo::tlms::{Landmark2, Tlms};
use onescan::photo::{self, Crop};
use onescan::simd;
use onescan_case::{
    HALF_SIDE, POSTERIOR_WORDS, RANK, SEARCH_WORDS, SIDE, STAGES, WORDS, fit, half_picture,
    picture, posterior, search, stages, write_chain, write_search,
};
use onescan_tests::program::fixtures;
use std::fmt::Write as _;
use std::fs;

/// How much larger than the landmarks' box the photo is.
const ENLARGE: f64 = 1.5;

fn writes(what: &str) -> bool {
    std::env::var("ONESCAN_GOLDEN").is_ok_and(|wanted| wanted == what)
}

/// Makes the inputs; the case has them compiled in, so its hashes are another run's.
#[test]
fn inputs_are_made_when_asked_for() {
    if !writes("device") {
        return;
    }
    let place = fixtures().join("device");
    let whole = template_model(199, &mut |_, _| ()).unwrap().model;
    let options =
        ExportOptions { shape_rank: RANK, albedo_rank: RANK, vertices: Some(960), bits: 16 };
    let exported = export(&whole, &options).unwrap();
    fs::create_dir_all(&place).unwrap();
    exported.model.write(&place.join("face.3dmm")).unwrap();

    let landmarks = Tlms::read(&fixtures().join("photos/astronaut.tlms"), [512; 2]).unwrap();
    let photo = photo::read(&fixtures().join("photos/astronaut.png")).unwrap();
    let size = [photo.width, photo.height];
    for (name, side) in [("photo", SIDE), ("half", HALF_SIDE)] {
        let (place, side) = (place.join(name), side as u32);
        let crop = Crop::around(&landmarks.visible_points(), size, ENLARGE, side).unwrap();
        let small = crop.cut(&photo).unwrap().resized(side, side);
        let mut ppm = format!("P6\n{side} {side}\n255\n").into_bytes();
        ppm.extend(small.bytes());
        fs::write(place.with_extension("ppm"), ppm).unwrap();
        let moved = landmarks.visible().map(|l| {
            let [x, y] = crop.to_crop([l.x, l.y].map(f64::from));
            Landmark2 { x: x as f32, y: y as f32, ..l.clone() }
        });
        let moved = Tlms { landmarks: moved.collect() };
        fs::write(place.with_extension("tlms"), moved.to_text()).unwrap();
    }
}

#[test]
fn every_engine_and_every_memory_computes_the_golden_bits() {
    if writes("device") {
        return;
    }
    let golden = fixtures().join("golden/device.txt");
    for engine in simd::all() {
        for lean in [true, false] {
            let mut memory = vec![0; if lean { WORDS.max(SEARCH_WORDS) } else { 3 * WORDS }];
            let hashes = stages(&mut memory, engine).unwrap();
            assert_eq!(hashes.len(), STAGES.len());
            let fitted = fit(&mut memory, engine, lean).unwrap();
            let mut found = String::new();
            write_chain(&mut found, &hashes, fitted.fingerprint).unwrap();
            let mode = search(&mut memory, engine).unwrap();
            write_search(&mut found, &mode).unwrap();
            let sampled = posterior(&mut vec![0; POSTERIOR_WORDS], engine).unwrap();
            writeln!(found, "posterior {sampled:016x}").unwrap();
            if writes("results") {
                fs::write(&golden, &found).unwrap();
            }
            let expected = fs::read_to_string(&golden).unwrap();
            assert_eq!(found, expected, "{}, lean: {lean}", engine.name);
            assert!(fitted.quality.pixel_rmse < 0.12, "{:?}", fitted.quality);

            let save = |name: &str, side: usize, colors: &[[f32; 3]]| {
                let shown = Picture::from_unit(side as u32, side as u32, colors).enlarged(4);
                shown.write_png(&onescan_tests::program::target().join(name)).unwrap();
            };
            let show = |colors: &[[f32; 3]]| save("device-native.png", SIDE, colors);
            picture(&mut memory, &fitted.scene, show).unwrap();
            let show = |colors: &[[f32; 3]]| save("device-search-native.png", HALF_SIDE, colors);
            half_picture(&mut memory, &mode.scene, show).unwrap();
        }
    }
}
