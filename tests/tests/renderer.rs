//! The fast renderer draws what its naive twin draws: per-pixel shading with interpolated normals,
//! in double precision.

use onescan::demo::{random_light, template_model};
use onescan_core::basis::padded;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use onescan_core::{draw, mesh, naive};

const SIDE: usize = 256;
/// What no pixel away from silhouettes differs by.
const LIMIT: f32 = 2.0 / 255.0;

#[test]
fn pixels_are_the_naive_twins_except_on_silhouettes() {
    let built = template_model(20, &mut |_, _| ()).unwrap();
    let model = built.model.view();
    let mut rng = Rng::new(3, 0);
    for number in 0..8 {
        let mut scene = Scene::initial(SIDE as u32, SIDE as u32, 20, 20);
        for c in scene.subject.shape.iter_mut().chain(&mut scene.subject.albedo) {
            *c = rng.normal() as f32;
        }
        scene.view.pose.yaw = rng.normal_sd(0.5);
        scene.view.pose.pitch = rng.normal_sd(0.2);
        scene.view.pose.roll = rng.normal_sd(0.2);
        random_light(&mut scene, &mut rng);

        let mut fast = vec![[f32::NAN; 3]; SIDE * SIDE];
        let mut memory = vec![0; draw::draw_words(model.vertices(), SIDE, SIDE)];
        draw::draw(&model, &scene, &mut memory, &mut fast).unwrap();

        let quads = || vec![[0.0; 4]; padded(model.vertices())];
        let (mut positions, mut normals, mut albedo) = (quads(), quads(), quads());
        model.shape.instance(&scene.subject.shape, &mut positions);
        naive::vertex_normals(&model, &positions, &mut normals);
        model.albedo.instance(&scene.subject.albedo, &mut albedo);
        let mut slow = vec![[f32::NAN; 3]; SIDE * SIDE];
        let mut depth = vec![0.0; SIDE * SIDE];
        naive::draw(&model, &scene, [&positions, &normals, &albedo], &mut depth, &mut slow);

        let mut compared = 0;
        for y in 1..SIDE - 1 {
            for x in 1..SIDE - 1 {
                if silhouette(&depth, x, y) {
                    continue;
                }
                let (a, b) = (fast[y * SIDE + x], slow[y * SIDE + x]);
                compared += usize::from(!b[0].is_nan());
                assert_eq!(a[0].is_nan(), b[0].is_nan(), "scene {number}: coverage at {x}, {y}");
                let difference = (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
                assert!(!(difference > LIMIT), "scene {number}: {difference} at {x}, {y}");
            }
        }
        assert!(compared > 10_000, "scene {number} shows too little: {compared} pixels");
    }
}

/// Whether surfaces more than 3 mm apart in depth, or the end of the surface, meet next to a pixel.
fn silhouette(inverse_depth: &[f32], x: usize, y: usize) -> bool {
    let at = |x: usize, y: usize| inverse_depth[y * SIDE + x];
    let here = at(x, y);
    (y - 1..=y + 1).any(|v| {
        (x - 1..=x + 1).any(|u| {
            let there = at(u, v);
            (here == 0.0) != (there == 0.0) || here > 0.0 && (1.0 / here - 1.0 / there).abs() > 3.0
        })
    })
}

#[test]
fn stages_agree_with_their_twins() {
    let built = template_model(20, &mut |_, _| ()).unwrap();
    let model = built.model.view();
    let mut rng = Rng::new(5, 0);
    let coefficients: Vec<f32> = (0..20).map(|_| rng.normal() as f32).collect();
    let quads = || vec![[0.0; 4]; padded(model.vertices())];
    let (mut fast, mut slow) = (quads(), quads());
    model.shape.instance(&coefficients, &mut fast);
    naive::instance(&model.shape, &coefficients, &mut slow);
    assert_eq!(fast, slow, "an instance is one sum in component order");

    let positions = fast.clone();
    mesh::vertex_normals(model.triangles, &positions, &mut fast);
    naive::vertex_normals(&model, &positions, &mut slow);
    for (a, b) in fast.as_flattened().iter().zip(slow.as_flattened()) {
        assert!((a - b).abs() < 1e-5, "normals: {a} {b}");
    }
}
