//! Every optimised stage of the rendering agrees with its slow twin, and the rasterizer with
//! pictures drawn by hand and with exact arithmetic.

mod common;

use common::{ModelBytes, mask};
use onescan_core::basis::padded;
use onescan_core::draw::{draw, draw_words};
use onescan_core::lanes::planes_words;
use onescan_core::likelihood::background::HISTOGRAM_LEN;
use onescan_core::likelihood::pixels::{
    Coverage, Known, Rasterized, Target, interpolate, residual, target_words,
};
use onescan_core::memory::Carver;
use onescan_core::mesh::vertex_normals;
use onescan_core::model::{Model, Triangles};
use onescan_core::naive;
use onescan_core::render::LANES;
use onescan_core::render::project::project;
use onescan_core::render::rasterize::{Frame, frame_words, rasterize};
use onescan_core::render::shade::{Shader, join};
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;

/// Side of the test pictures: the mask's triangles cover one or two pixels.
const SIDE: usize = 128;
const SCENES: u64 = 12;
const SD: f32 = 0.05;

fn small_mask() -> ModelBytes {
    mask(61, 75, 6, 5)
}

/// A mask somewhere in the picture, turned, lit and coloured at random.
fn random_scene(rng: &mut Rng) -> Scene {
    let mut scene = Scene::initial(SIDE as u32, SIDE as u32, 6, 5);
    scene.view.pose.yaw = rng.normal_sd(0.4);
    scene.view.pose.pitch = rng.normal_sd(0.3);
    scene.view.pose.roll = rng.normal_sd(0.3);
    scene.view.pose.scale = 1.0 + rng.normal_sd(0.05);
    scene.view.pose.translation[0] = rng.normal_sd(15.0);
    scene.view.pose.translation[1] = rng.normal_sd(15.0);
    scene.view.camera.focal_length = 6.5 + rng.normal_sd(0.5);
    scene.view.camera.principal_point = [rng.normal_sd(0.05), rng.normal_sd(0.05)];
    for number in scene.view.light.iter_mut().flatten() {
        *number += rng.normal_sd(0.05);
    }
    for channel in 0..3 {
        scene.view.color.gain[channel] += rng.normal_sd(0.1);
        scene.view.color.offset[channel] += rng.normal_sd(0.02);
    }
    scene.view.color.contrast += rng.normal_sd(0.1);
    for c in scene.subject.shape.iter_mut().chain(&mut scene.subject.albedo) {
        *c = rng.normal_sd(1.0);
    }
    scene
}

/// An instance per vertex, by the optimised stages.
struct Instance {
    positions: Vec<[f32; 4]>,
    normals: Vec<[f32; 4]>,
    albedo: Vec<[f32; 4]>,
}

impl Instance {
    fn new(model: &Model<'_>, scene: &Scene) -> Self {
        let quads = || vec![[0.0; 4]; padded(model.vertices())];
        let (mut positions, mut normals, mut albedo) = (quads(), quads(), quads());
        model.shape.instance(&scene.subject.shape, &mut positions);
        model.albedo.instance(&scene.subject.albedo, &mut albedo);
        vertex_normals(model.triangles, &positions, &mut normals);
        Self { positions, normals, albedo }
    }
}

fn xyz([x, y, z, _]: [f32; 4]) -> [f32; 3] {
    [x, y, z]
}

/// Runs a test on a few random scenes.
fn on_random_scenes(mut test: impl FnMut(&Model<'_>, &Scene, &Instance)) {
    let bytes = small_mask();
    let model = bytes.model();
    for seed in 0..SCENES {
        let scene = random_scene(&mut Rng::new(seed, 0));
        test(&model, &scene, &Instance::new(&model, &scene));
    }
}

#[test]
fn instance_is_the_twins_to_the_bit() {
    let bytes = small_mask();
    let model = bytes.model();
    let mut rng = Rng::new(1, 0);
    for count in [0, 1, 3, 6, 9] {
        let coefficients: Vec<f32> = (0..count).map(|_| rng.normal_sd(1.0)).collect();
        let mut fast = vec![[0.0; 4]; padded(model.vertices())];
        let mut slow = fast.clone();
        model.shape.instance(&coefficients, &mut fast);
        naive::instance(&model.shape, &coefficients, &mut slow);
        let bits = |vertices: &[[f32; 4]]| {
            vertices.as_flattened().iter().map(|x| x.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(bits(&fast), bits(&slow), "{count}");
    }
}

#[test]
fn normals_are_the_twins() {
    on_random_scenes(|model, _, instance| {
        let mut slow = vec![[0.0; 4]; instance.normals.len()];
        naive::vertex_normals(model, &instance.positions, &mut slow);
        for (v, (a, b)) in instance.normals.iter().zip(&slow).enumerate() {
            assert!((0..3).all(|i| (a[i] - b[i]).abs() < 2e-6), "{v}: {a:?} is not {b:?}");
        }
    });
}

#[test]
fn window_is_the_twins_on_a_grid() {
    on_random_scenes(|model, scene, instance| {
        let mut fast = vec![[0.0; 4]; padded(model.vertices())];
        let mut slow = fast.clone();
        project(&scene.view, &instance.positions, &mut fast);
        naive::project(&scene.view, &instance.positions, &mut slow);
        for (a, b) in fast.iter().zip(&slow).take(model.vertices()) {
            // Half a step of the grid, and the rounding of coordinates up to 128.
            assert!((a[0] - b[0]).abs() < 1.0 / 512.0 + 1e-4, "{a:?} is not {b:?}");
            assert!((a[1] - b[1]).abs() < 1.0 / 512.0 + 1e-4, "{a:?} is not {b:?}");
            assert!((a[2] / b[2] - 1.0).abs() < 1e-6, "{a:?} is not {b:?}");
            assert!((256.0 * a[0]).fract() == 0.0 && (256.0 * a[1]).fract() == 0.0, "{a:?}");
        }
    });
}

#[test]
fn a_vertex_before_the_near_plane_has_no_place_in_the_window() {
    let bytes = small_mask();
    let model = bytes.model();
    let mut scene = Scene::initial(64, 64, 0, 0);
    // The middle of the mask is 100 mm before its origin, and behind the camera.
    scene.view.pose.translation[2] = -60.0;
    let instance = Instance::new(&model, &scene);
    let mut window = vec![[0.0; 4]; padded(model.vertices())];
    project(&scene.view, &instance.positions, &mut window);
    let mut before = 0;
    for (v, corner) in window.iter().enumerate().take(model.vertices()) {
        let distance = -scene.view.pose.to_world(xyz(instance.positions[v]))[2];
        let hidden = corner[0].is_nan() && corner[1].is_nan();
        assert_eq!(hidden, !(distance > scene.view.camera.near), "{distance}");
        before += usize::from(hidden);
    }
    assert!(before > 0 && before < model.vertices());
}

#[test]
fn colours_are_the_twins() {
    on_random_scenes(|_, scene, instance| {
        let shader = Shader::new(&scene.view);
        for (&normal, &albedo) in instance.normals.iter().zip(&instance.albedo) {
            let a = shader.color(xyz(normal), xyz(albedo));
            let b = naive::color(&scene.view, xyz(normal), xyz(albedo));
            assert!((0..3).all(|i| (a[i] - b[i]).abs() < 3e-6), "{a:?} is not {b:?}");
        }
    });
}

/// The picture of a scene, NaN where the model is not.
fn picture(model: &Model<'_>, scene: &Scene) -> Vec<[f32; 3]> {
    let mut memory = vec![0; draw_words(model.vertices(), SIDE, SIDE)];
    let mut pixels = vec![[f32::NAN; 3]; SIDE * SIDE];
    let covered = draw(model, scene, &mut memory, &mut pixels);
    assert_eq!(covered, Some(pixels.iter().filter(|p| !p[0].is_nan()).count()));
    pixels
}

#[test]
fn colours_are_within_two_steps_of_shading_every_pixel_but_at_silhouettes() {
    on_random_scenes(|model, scene, instance| {
        let fast = picture(model, scene);
        let mut slow = vec![[f32::NAN; 3]; SIDE * SIDE];
        let mut depth = vec![0.0; SIDE * SIDE];
        let vertices = [&instance.positions[..], &instance.normals, &instance.albedo];
        naive::draw(model, scene, vertices, &mut depth, &mut slow);

        // At a silhouette a neighbour is not covered, or the surface there is another one: more
        // than 1 % (10 mm) nearer or farther.
        let silhouette = |x: usize, y: usize| {
            let here = depth[y * SIDE + x];
            let around = |i: usize| i.saturating_sub(1)..(i + 2).min(SIDE);
            around(y).any(|y| around(x).any(|x| !((depth[y * SIDE + x] / here - 1.0).abs() < 0.01)))
        };
        let (mut covered, mut compared) = (0, 0);
        for y in 0..SIDE {
            for x in 0..SIDE {
                let (a, b) = (fast[y * SIDE + x], slow[y * SIDE + x]);
                covered += usize::from(!b[0].is_nan());
                if depth[y * SIDE + x] > 0.0 && !silhouette(x, y) {
                    compared += 1;
                    let near = (0..3).all(|c| (a[c] - b[c]).abs() < 2.0 / 255.0);
                    assert!(near, "({x}, {y}): {a:?} is not {b:?}");
                }
            }
        }
        assert!(covered > SIDE * SIDE / 10, "{covered}");
        assert!(compared > covered * 3 / 4, "{compared} of {covered}");
    });
}

/// Noise on a picture, grey where the model is not.
fn photo(pixels: &[[f32; 3]], rng: &mut Rng) -> Vec<[u8; 3]> {
    let mut byte = |x: f32| {
        let x = if x.is_nan() { 0.5 } else { x };
        ((x + rng.normal_sd(0.03)).clamp(0.0, 1.0) * 255.0 + 0.5) as u8
    };
    pixels.iter().map(|pixel| pixel.map(&mut byte)).collect()
}

#[test]
fn image_likelihood_is_the_twins_and_a_floor_changes_no_decision() {
    on_random_scenes(|model, scene, instance| {
        let pixels = picture(model, scene);
        let photo = photo(&pixels, &mut Rng::new(5, 0));
        let covered: Vec<f32> =
            pixels.iter().map(|p| if p[0].is_nan() { 0.0 } else { 1.0 }).collect();
        let mut histogram = vec![0; HISTOGRAM_LEN];
        let slow = naive::ln_likelihood(&covered, &pixels, &photo, &mut histogram, f64::from(SD));

        let words = target_words(SIDE, SIDE)
            + (frame_words(SIDE, SIDE) + 2 * planes_words(SIDE, SIDE)).max(HISTOGRAM_LEN);
        let mut memory = vec![0; words];
        let mut carver = Carver::new(&mut memory);
        let target = Target::carve(&mut carver, &photo, SIDE).expect("enough memory");
        let mut frame = Frame::carve(&mut carver, SIDE, SIDE).expect("enough memory");
        let normals = carver.planes(SIDE, SIDE).expect("enough memory");
        let albedo = carver.planes(SIDE, SIDE).expect("enough memory");
        let mut window = vec![[0.0; 4]; padded(model.vertices())];
        project(&scene.view, &instance.positions, &mut window);
        rasterize(model.triangles, &window, &mut frame);
        let coverage = Coverage::of(&frame, &target);
        let mut vertices = vec![[0.0; 8]; padded(model.vertices())];
        join(instance.normals.iter().copied(), instance.albedo.iter().copied(), &mut vertices);
        let rasterized =
            Rasterized { frame: &frame, triangles: model.triangles, vertices: &vertices };
        let shader = Shader::new(&scene.view);
        let differ = |known, limit| residual(&rasterized, known, &shader, &target, limit);
        let whole = differ(Known::default(), f64::INFINITY).expect("nothing is above ∞");
        let fast = coverage.ln_likelihood(whole, SD);
        assert_eq!(coverage.pixels, covered.iter().filter(|&&c| c > 0.0).count());
        assert!((fast - slow).abs() < 1e-5 * slow.abs().max(1e4), "{fast} is not {slow}");

        interpolate(&rasterized, Some(normals), albedo);
        let mut again = vec![[[f32::NAN; LANES]; 3]; albedo.len()];
        interpolate(&rasterized, None, &mut again);
        let (normals, albedo) = (Some(&*normals), Some(&*albedo));
        let everything = Known { normals, albedo };
        for known in [
            Known { albedo: None, ..everything },
            everything,
            Known { normals, albedo: Some(&again) },
        ] {
            assert_eq!(differ(known, f64::INFINITY), Some(whole));
        }
        for step in [-1e5, -1e3, -1.0, -1e-3, 1e-3, 1.0, 1e3, 1e5] {
            let limit = coverage.limit(fast + step, SD);
            assert_eq!(differ(everything, limit), (step < 0.0).then_some(whole), "{step}");
        }
    });
}

#[test]
fn nothing_in_sight_has_no_likelihood() {
    let mut memory = vec![0; target_words(8, 8) + frame_words(8, 8) + HISTOGRAM_LEN];
    let mut carver = Carver::new(&mut memory);
    let target = Target::carve(&mut carver, &[[9; 3]; 64], 8).expect("enough memory");
    let frame = Frame::carve(&mut carver, 8, 8).expect("enough memory");
    let coverage = Coverage::of(&frame, &target);
    assert_eq!(coverage.pixels, 0);
    assert_eq!(coverage.ln_likelihood(0.0, SD), f64::NEG_INFINITY);
}

/// Which triangle is visible at every pixel of a `width × height` picture.
fn visible(
    triangles: &[[u16; 3]],
    window: &[[f32; 4]],
    [width, height]: [usize; 2],
) -> Vec<Option<usize>> {
    let mut memory = vec![0; frame_words(width, height)];
    let mut frame = Frame::carve(&mut Carver::new(&mut memory), width, height).expect("memory");
    rasterize(Triangles::U16(triangles), window, &mut frame);
    (0..width * height)
        .map(|pixel| {
            let hit = frame.hit(pixel % width, pixel / width)?;
            // Weights are linear functions of the place, extrapolated from a corner's pixel: of a
            // needle of a triangle they are less exact.
            let ([w1, w2], error) = (hit.weights, 1e-3);
            let inside = w1 >= -error && w2 >= -error && w1 + w2 <= 1.0 + error;
            assert!(inside, "{:?} in {triangles:?} {window:?}", hit.weights);
            Some(hit.triangle)
        })
        .collect()
}

/// Draws triangles given by `[x, y]` or, all at distance one, by their corners' numbers: a picture
/// of their numbers, a dot where there is none.
fn sketch(corners: &[[f32; 2]], triangles: &[[u16; 3]], size: [usize; 2]) -> Vec<String> {
    let window: Vec<[f32; 4]> = corners.iter().map(|&[x, y]| [x, y, 1.0, 0.0]).collect();
    let digit = |t: &Option<usize>| t.map_or('.', |t| char::from(b'0' + t as u8));
    visible(triangles, &window, size)
        .chunks(size[0])
        .map(|row| row.iter().map(digit).collect())
        .collect()
}

#[test]
fn a_triangle_covers_the_pixels_on_its_edges() {
    let corners = [[0.0, 0.0], [0.0, 3.0], [3.0, 0.0]];
    assert_eq!(
        sketch(&corners, &[[0, 1, 2]], [5, 5]),
        ["0000.", "000..", "00...", "0....", "....."]
    );
    // The same from the other side: a back face.
    assert_eq!(sketch(&corners, &[[0, 2, 1]], [5, 2]), [".....", "....."]);
}

#[test]
fn a_large_triangle_covers_the_pixels_on_its_edges() {
    let corners = [[1.0, 0.0], [1.0, 5.0], [6.0, 5.0]];
    let expected = [".0......", ".00.....", ".000....", ".0000...", ".00000..", ".000000."];
    assert_eq!(sketch(&corners, &[[0, 1, 2]], [8, 6]), expected);
}

#[test]
fn a_common_edge_goes_to_the_first_drawn_and_leaves_no_crack() {
    let corners = [[0.0, 0.0], [0.0, 3.0], [3.0, 0.0], [3.0, 3.0]];
    let square = [[0, 1, 2], [2, 1, 3]];
    assert_eq!(sketch(&corners, &square, [4, 4]), ["0000", "0001", "0011", "0111"]);
    // Large ones alike.
    let corners = corners.map(|corner| corner.map(|x| 2.0 * x));
    let expected = ["0000000", "0000001", "0000011", "0000111", "0001111", "0011111", "0111111"];
    assert_eq!(sketch(&corners, &square, [7, 7]), expected);
}

#[test]
fn a_triangle_between_pixels_covers_none() {
    let corners = [[1.25, 1.25], [1.25, 1.75], [1.75, 1.25]];
    assert_eq!(sketch(&corners, &[[0, 1, 2]], [3, 3]), ["...", "...", "..."]);
}

#[test]
fn triangles_that_leave_the_picture_are_cut() {
    let corners = [[-2.0, -2.0], [-2.0, 3.0], [3.0, -2.0], [9.0, 9.0]];
    assert_eq!(sketch(&corners, &[[0, 1, 2], [2, 1, 3]], [4, 3]), ["0011", "0111", "1111"]);
    // As large as window coordinates get on their grid.
    let corners = [[-16000.0, -16000.0], [-16000.0, 16000.0], [16000.0, -16000.0]];
    assert_eq!(sketch(&corners, &[[0, 1, 2]], [3, 2]), ["0..", "..."]);
}

#[test]
fn triangles_without_area_or_without_place_are_skipped() {
    let nan = f32::NAN;
    let corners = [[0.0, 0.0], [0.0, 3.0], [3.0, 0.0], [nan, nan], [nan, 1.0]];
    let triangles =
        [[0, 0, 0], [0, 1, 1], [0, 1, 0], [3, 1, 2], [0, 3, 2], [0, 1, 3], [3, 3, 3], [0, 4, 2]];
    assert_eq!(sketch(&corners, &triangles, [3, 3]), ["...", "...", "..."]);
    // Three corners in a line.
    let corners = [[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]];
    assert_eq!(sketch(&corners, &[[0, 1, 2], [2, 1, 0]], [3, 3]), ["...", "...", "..."]);
}

#[test]
fn no_number_makes_the_rasterizer_panic() {
    let numbers =
        [0.0, -0.0, 1.5, -7.0, 300.0, 16384.0, 1e9, -1e9, 1e38, f32::INFINITY, -f32::INFINITY];
    let numbers = numbers.into_iter().chain([f32::NAN, f32::MIN_POSITIVE, 1e-40]);
    let numbers: Vec<f32> = numbers.collect();
    let mut rng = Rng::new(3, 0);
    let mut any = || numbers[rng.below(numbers.len() as u32) as usize];
    let mut memory = vec![0; frame_words(5, 4)];
    let mut frame = Frame::carve(&mut Carver::new(&mut memory), 5, 4).expect("memory");
    for _ in 0..3000 {
        let window: [[f32; 4]; 3] = core::array::from_fn(|_| [any(), any(), any(), 0.0]);
        rasterize(Triangles::U32(&[[0, 1, 2], [2, 1, 0]]), &window, &mut frame);
        assert!(frame.rows().len() <= 4 && frame.columns().len() <= 5);
    }
    // Pictures without pixels.
    for size in [[0, 0], [0, 3], [3, 0]] {
        assert!(visible(&[[0, 1, 2]], &[[1.0, 1.0, 1.0, 0.0]; 3], size).is_empty());
    }
}

#[test]
fn the_nearest_wins_in_whatever_order() {
    let corner = |x: f32, y: f32, distance: f32| [x, y, 1.0 / distance, 0.0];
    // A wall, and before it a screen that is slanted through another wall.
    let window = [
        corner(0.0, 0.0, 10.0),
        corner(0.0, 9.0, 10.0),
        corner(9.0, 0.0, 10.0),
        corner(0.0, 0.0, 5.0),
        corner(0.0, 9.0, 5.0),
        corner(9.0, 0.0, 40.0),
    ];
    let front = visible(&[[0, 1, 2], [3, 4, 5]], &window, [10, 10]);
    let back = visible(&[[3, 4, 5], [0, 1, 2]], &window, [10, 10]);
    let swapped: Vec<_> = back.iter().map(|t| t.map(|t| 1 - t)).collect();
    assert_eq!(front, swapped);
    // 1/d is linear in the window: from 1/5 to 1/40 it passes 1/10 after 4/7 of the way.
    assert_eq!(front[..10].iter().filter(|&&t| t == Some(1)).count(), 6);
}

#[test]
fn a_new_picture_forgets_the_old_one() {
    let mut memory = vec![0; frame_words(6, 6)];
    let mut frame = Frame::carve(&mut Carver::new(&mut memory), 6, 6).expect("memory");
    let at = |x: f32, y: f32| [[x, y, 1.0, 0.0], [x, y + 2.0, 1.0, 0.0], [x + 2.0, y, 1.0, 0.0]];
    for (x, y) in [(0.0, 0.0), (3.0, 3.0), (1.0, 2.0), (9.0, 9.0), (0.0, 0.0)] {
        rasterize(Triangles::U16(&[[0, 1, 2]]), &at(x, y), &mut frame);
        let hits = (0..36).filter_map(|pixel| frame.hit(pixel % 6, pixel / 6));
        assert_eq!(hits.count(), if x < 6.0 { 6 } else { 0 });
    }
}

/// A random number on the window's grid.
fn on_grid(rng: &mut Rng, low: i32, high: i32) -> i64 {
    i64::from(256 * low) + i64::from(rng.below(256 * (high - low) as u32))
}

#[test]
fn coverage_is_what_exact_arithmetic_says() {
    const PICTURE: [usize; 2] = [23, 19];
    let mut rng = Rng::new(11, 0);
    for round in 0..6000 {
        // From less than a pixel to several pictures.
        let reach = [1, 2, 3, 5, 12, 60][round % 6];
        let centre = [on_grid(&mut rng, -2, 25), on_grid(&mut rng, -2, 21)];
        let corners: [[i64; 2]; 3] =
            core::array::from_fn(|_| centre.map(|c| c + on_grid(&mut rng, -reach, reach)));
        let window = corners.map(|[x, y]| [x as f32 / 256.0, y as f32 / 256.0, 0.001, 0.0]);
        let found = visible(&[[0, 1, 2]], &window, PICTURE);
        for (pixel, found) in found.iter().enumerate() {
            let [x, y] =
                [pixel % PICTURE[0], pixel / PICTURE[0]].map(|i| 256 * i64::from(i as u32));
            let edge = |a: [i64; 2], b: [i64; 2]| (a[1] - y) * (b[0] - x) - (a[0] - x) * (b[1] - y);
            let [p, q, r] = corners;
            let e = [edge(q, r), edge(r, p), edge(p, q)];
            let inside = e.iter().all(|&e| e >= 0) && e.iter().sum::<i64>() > 0;
            assert_eq!(found.is_some(), inside, "{corners:?} at ({x}, {y})");
        }
    }
}

#[test]
fn a_crumpled_sheet_has_no_holes() {
    // Points every 2.5 pixels, shifted so little that no triangle turns its back.
    const POINTS: usize = 24;
    let mut rng = Rng::new(12, 0);
    let mut jitter = |i: usize| 2.5 * i as f32 + (rng.below(300) as f32 - 150.0) / 256.0;
    let window: Vec<[f32; 4]> = (0..POINTS * POINTS)
        .map(|v| [jitter(v % POINTS), jitter(v / POINTS), 0.001, 0.0])
        .collect();
    let triangles: Vec<[u16; 3]> = (0..POINTS - 1)
        .flat_map(|j| (0..POINTS - 1).map(move |i| (j * POINTS + i) as u16))
        .flat_map(|v| {
            let below = v + POINTS as u16;
            [[v, below, v + 1], [v + 1, below, below + 1]]
        })
        .collect();
    let found = visible(&triangles, &window, [56, 56]);
    for (pixel, found) in found.iter().enumerate() {
        let (x, y) = (pixel % 56, pixel / 56);
        assert!(x < 2 || y < 2 || found.is_some(), "({x}, {y})");
    }
}
