//! Objects that are no faces, by the command.

use onescan::mesh::skin::{Colors, Skin, Texture};
use onescan::mesh::{Mesh, obj, ply};
use onescan::photo;
use onescan::photo::picture::Picture;
use onescan::scan::decimate::decimate;
use onescan_tests::program::{Onescan, fixtures};
use serde_json::Value;
use std::fs;
use std::path::Path;
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

/// An artist's fish: few vertices, and stripes in a texture. Writes fish.obj with its texture, and
/// fish.json with a landmark.
fn striped_fish(place: &Path) {
    let whole = ply::read(&fixtures().join("fish/template.ply")).unwrap();
    let triangles = decimate(&whole, &[], 800);
    let mut used: Vec<u32> = triangles.as_flattened().to_vec();
    used.sort_unstable();
    used.dedup();
    let points: Vec<_> = used.iter().map(|v| whole.points[*v as usize]).collect();
    let number = |v: u32| used.binary_search(&v).unwrap() as u32;
    let triangles = triangles.iter().map(|t| t.map(number)).collect();
    // From the side, as far as it is long.
    let uvs = points.iter().map(|p| [p[2] / 400.0 + 0.5, 0.5 - p[1] / 400.0]).collect();
    let stripes = Picture::from_fn(512, 512, |x, _| match x / 16 % 2 {
        0 => [240, 120, 20],
        _ => [245, 245, 245],
    });
    let colors = vec![[0.5; 3]; points.len()];
    let nose = (0..points.len()).max_by(|a, b| points[*a][2].total_cmp(&points[*b][2])).unwrap();
    let mesh = Mesh { points, colors, triangles };
    let skin = Skin { colors: Colors::Texture(Texture::new(uvs, stripes).unwrap()), lit: true };
    for (name, bytes) in obj::files(&mesh, &skin, "fish") {
        fs::write(place.join(name), bytes).unwrap();
    }
    fs::write(place.join("fish.json"), format!(r#"[{{"id": "nose", "vertex": {nose}}}]"#)).unwrap();
}

/// How far the blue of a mesh's vertices is from that of the stripes, of 1, root mean square.
fn off(mesh: &Mesh) -> f64 {
    let errors = mesh.points.iter().zip(&mesh.colors).map(|(p, color)| {
        let x = (p[2] / 400.0 + 0.5) * 32.0;
        let right = if (x as u32).is_multiple_of(2) { 20.0 } else { 245.0 } / 255.0;
        f64::from(color[2] - right).powi(2)
    });
    (errors.sum::<f64>() / mesh.points.len() as f64).sqrt()
}

#[test]
fn an_artists_fish_keeps_its_stripes_and_is_cut_and_scaled() {
    let place = tempdir().unwrap();
    striped_fish(place.path());
    let run = |line: &str| Onescan::new(place.path(), line).succeed();
    let mended = |line: &str| {
        run(&format!("inspect fish.obj {line} --mend out.ply"));
        ply::read(&place.path().join("out.ply")).unwrap()
    };
    let coarse = mended("");
    assert!(coarse.points.len() < 1000);
    let fine = mended("--subdivide 3");
    assert!(fine.points.len() > 40 * coarse.points.len());
    assert!(off(&fine) < 0.2, "{}", off(&fine));
    let by_length = mended("--edge 4");
    assert!(off(&by_length) < 0.25, "{}", off(&by_length));

    let long = mended("--size 1000");
    let length = |mesh: &Mesh| {
        let side = |i: usize| {
            let all = || mesh.points.iter().map(|p| p[i]);
            all().fold(f32::MIN, f32::max) - all().fold(f32::MAX, f32::min)
        };
        side(0).max(side(1)).max(side(2))
    };
    assert!((length(&long) - 1000.0).abs() < 0.01, "{}", length(&long));
    let head = mended("--landmarks fish.json --crop nose,80");
    assert!(length(&head) < 160.0 && head.points.len() > 20);

    let build = "build fish.obj --subdivide 1 --rank 4 --landmarks fish.json";
    run(&format!("{build} -o fish.3dmm"));
    assert!(run("info fish.3dmm").contains("nose"));
    run(&format!("{build} -o head.3dmm --crop nose,120 --fill-holes"));
    let refused = Onescan::new(place.path(), &format!("{build} -o x.3dmm --crop tail,9")).run();
    assert_eq!(refused.code, Some(1));
    assert!(refused.stderr.contains("no landmark \"tail\"; there are nose"), "{}", refused.stderr);
}
