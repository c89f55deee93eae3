//! The derivatives against finite differences, and the search against its own promises.

use super::instance::at;
use super::shading::Shading;
use super::unknowns::Layout;
use super::window::Window;
use super::*;
use crate::basis::{ByVertex, Costs, by_vertex_words, padded};
use crate::chain::Config;
use crate::draw;
use crate::engine::Engine;
use crate::image::Image;
use crate::least_squares::{matrix_words, system_words};
use crate::light::frontal;
use crate::likelihood::landmarks::ObservedLandmark;
use crate::math;
use crate::memory::Carver;
use crate::mesh::vertex_normals;
use crate::model::Model;
use crate::posterior::{self, Metric, Sampler, improve, improve_words};
use crate::render::rasterize::Hit;
use crate::rng::Rng;
use crate::scene::Scene;
use crate::vector::{Vec3, add, dot, scale, sub, xyz};
use core::array::from_fn;
use std::vec;
use std::vec::Vec;

const SIDE: u32 = 96;

const MODEL: &[u8] = include_bytes!("../../../fixtures/golden/small.3dmm");

/// The model's bytes, aligned.
fn aligned() -> Vec<u32> {
    MODEL.chunks(4).map(|c| u32::from_le_bytes(from_fn(|i| at(c, i)))).collect()
}

/// The model in aligned words.
fn model(words: &[u32]) -> Model<'_> {
    Model::new_checked(&bytemuck::cast_slice(words)[..MODEL.len()]).unwrap()
}

/// A face to be found: its scene, its picture with noise, and its landmarks in the picture.
pub(crate) struct Case {
    bytes: Vec<u32>,
    truth: Scene,
    pixels: Vec<[u8; 3]>,
    landmarks: Vec<(&'static str, [f32; 2])>,
    open: Option<Vec<u8>>,
    pub(crate) config: Config,
}

impl Case {
    pub(crate) fn new(seed: u64) -> Self {
        let bytes = aligned();
        let model = model(&bytes);
        let (shape_rank, albedo_rank) = (model.shape.rank(), model.albedo.rank());
        let mut rng = Rng::new(seed, 0);
        let mut truth = Scene::initial(SIDE, SIDE, shape_rank, albedo_rank);
        for c in truth.subject.shape.iter_mut().chain(&mut truth.subject.albedo) {
            *c = rng.normal_sd(0.7);
        }
        truth.view.pose.yaw = 0.15;
        truth.view.pose.pitch = -0.1;
        truth.view.light[3][0] += 0.05;
        let mut memory = vec![0; draw::draw_words(model.vertices(), SIDE as usize, SIDE as usize)];
        let mut colors = vec![[0.1, 0.35, 0.2]; (SIDE * SIDE) as usize];
        draw::draw(&model, &truth, &mut memory, &mut colors).unwrap();
        let mut byte = |c: f32| (255.0 * c + rng.normal_sd(3.0)).clamp(0.0, 255.0) as u8;
        let pixels = colors.iter().map(|c| c.map(&mut byte)).collect();
        let mut positions = vec![[0.0; 4]; padded(model.vertices())];
        model.shape.instance(&truth.subject.shape, &mut positions);
        let landmarks = model
            .landmarks()
            .map(|(name, vertex)| {
                let world = truth.view.pose.to_world(xyz(positions[vertex as usize]));
                let (u, v, _) = truth.view.camera.project(world);
                let name: &'static str = std::boxed::Box::leak(std::boxed::Box::from(name));
                (name, [u, v])
            })
            .collect();
        let config = Config::default().with(|c| {
            c.shape_rank = shape_rank;
            c.albedo_rank = albedo_rank;
            // As informative as a larger picture.
            c.pixel_patch = 8.0;
        });
        Self { bytes, truth, pixels, landmarks, open: None, config }
    }

    fn run<T>(&self, options: Options<'_>, f: impl FnOnce(&mut ModeSearch<'_, '_>) -> T) -> T {
        self.run_with(options, false, f)
    }

    fn run_with<T>(
        &self,
        options: Options<'_>,
        lean: bool,
        f: impl FnOnce(&mut ModeSearch<'_, '_>) -> T,
    ) -> T {
        self.give(options, lean, |mut search| f(&mut search))
    }

    pub(crate) fn give<T>(
        &self,
        options: Options<'_>,
        lean: bool,
        f: impl FnOnce(ModeSearch<'_, '_>) -> T,
    ) -> T {
        let model = model(&self.bytes);
        let observed: Vec<ObservedLandmark<'_>> = self
            .landmarks
            .iter()
            .map(|&(name, position)| ObservedLandmark { name, position })
            .collect();
        let image = Image { pixels: &self.pixels, width: SIDE, height: SIDE };
        let problem = Problem::new(&model, image, &observed, &self.config)
            .with_engine(Engine::PORTABLE)
            .with_open(self.open.as_deref())
            .with_lean(lean);
        let mut memory = vec![0; words(&problem, &options)];
        f(ModeSearch::new(problem, options, &mut memory).unwrap())
    }
}

/// Goes a step from a scene of one view.
fn advance(scene: &mut Scene, layout: Layout, step: &mut [f32]) {
    let parts = layout.split(step, 0).unwrap();
    parts.advance_subject(&mut scene.subject);
    parts.advance_view(&mut scene.view);
}

/// Goes to a scene.
fn go(search: &mut ModeSearch<'_, '_>, scene: &Scene) {
    search.common.subject.clone_from(&scene.subject);
    search.first.view = scene.view;
    (search.rendered, search.judged) = (false, false);
}

/// Some coefficients.
fn scatter(search: &mut ModeSearch<'_, '_>, rng: &mut Rng) {
    let mut scene = search.scene();
    for c in scene.subject.shape.iter_mut().chain(&mut scene.subject.albedo) {
        *c = rng.normal_sd(0.5);
    }
    go(search, &scene);
    search.make_judged();
}

fn cosine(a: &[f32], b: &[f32]) -> f32 {
    let sum = |x: &[f32], y: &[f32]| -> f32 { x.iter().zip(y).map(|(x, y)| x * y).sum() };
    sum(a, b) / math::sqrt(sum(a, a) * sum(b, b))
}

/// A visible pixel's surface point, what a change of its colour gains, and what its motion in the
/// window does.
struct Followed {
    hit: Hit,
    gain: Vec3,
    motion: [f32; 2],
}

/// What shade takes off a photo's weighted differences.
fn taken(common: &Common<'_, '_>, evidence: &Evidence<'_, '_>) -> Vec<f32> {
    let mut planes = [(); 5].map(|()| vec![0.0; evidence.mask().len()]);
    evidence.find_taken(common, planes.each_mut().map(|plane| &mut plane[..]));
    let [taken, ..] = planes;
    taken
}

/// Every pixel that shows the face.
fn follow(search: &ModeSearch<'_, '_>) -> Vec<Followed> {
    let ModeSearch { common, first, .. } = search;
    let taken = taken(common, first);
    let mut all = Vec::new();
    for y in first.frame.rows() {
        for x in first.frame.columns() {
            let index = y * SIDE as usize + x;
            let mask = at(first.planes.weights, index);
            let Some(hit) = first.frame.hit(x, y).filter(|_| mask >= 1e-3) else { continue };
            let gain = scale(first.cost(index, taken[index]), common.pixel_weight());
            let motion = first.differences(x, y).map(|d| -dot(gain, d));
            all.push(Followed { hit, gain, motion });
        }
    }
    all
}

/// `Σ γ·c + m·p` of the followed points, a step away: smooth, and its derivative at no step is
/// what the search calls the gradient.
fn potential(
    search: &mut ModeSearch<'_, '_>,
    start: &Scene,
    followed: &[Followed],
    direction: &[f32],
    h: f32,
) -> f64 {
    let mut step: Vec<f32> = direction.iter().map(|d| h * d).collect();
    let mut scene = start.clone();
    let common = &mut search.common;
    advance(&mut scene, common.layout, &mut step);
    common.instance.update(common.problem.model, common.problem.engine, &scene.subject);
    let shading = Shading::new(&scene.view);
    let mut sum = 0.0;
    for Followed { hit, gain, motion } in followed {
        let (corners, point) = common.point(&shading, hit).unwrap();
        sum += f64::from(dot(*gain, point.color));
        for (vertex, w) in corners.into_iter().zip(point.weights) {
            let world = scene.view.pose.to_world(xyz(at(common.instance.positions, vertex)));
            let (u, v, _) = scene.view.camera.project(world);
            sum += f64::from(w) * f64::from(motion[0]) * f64::from(u);
            sum += f64::from(w) * f64::from(motion[1]) * f64::from(v);
        }
    }
    sum
}

#[test]
fn the_gradient_is_that_of_differences_in_every_block() {
    let case = Case::new(3);
    case.run(Options::default(), |search| {
        let mut rng = Rng::new(9, 0);
        scatter(search, &mut rng);
        let start = search.scene();
        search.find_gradient();
        let gradient: Vec<f32> = search.gradient.to_vec();
        let followed = follow(search);
        assert!(followed.len() > 500);
        let layout = search.layout();
        let pose = layout.subject();
        let blocks = [
            ("rotation", pose..pose + 3, 0.01),
            ("translation", pose + 3..pose + 5, 1.0),
            ("zoom", pose + 5..pose + 6, 0.01),
            ("recede", pose + 6..pose + 7, 0.01),
            ("shape", 0..layout.shape_rank, 0.03),
            ("albedo", layout.shape_rank..pose, 0.03),
            ("light", layout.light(0), 0.01),
            ("colour", layout.color(0), 0.01),
        ];
        for (name, block, h) in blocks {
            let size: f64 =
                gradient[block.clone()].iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
            for _ in 0..3 {
                let mut direction = vec![0.0; layout.len()];
                for d in &mut direction[block.clone()] {
                    *d = rng.normal_sd(1.0);
                }
                let slope: f64 =
                    gradient.iter().zip(&direction).map(|(g, d)| f64::from(g * d)).sum();
                let mut ahead = |h: f32| potential(search, &start, &followed, &direction, h);
                let found = (ahead(h) - ahead(-h)) / (2.0 * f64::from(h));
                std::println!("{name}: {slope:.4} by reverse, {found:.4} by differences");
                assert!((slope - found).abs() < 0.01 * size + 0.002, "{name}: {slope} {found}");
            }
        }
    });
}

/// What the search calls the gradient is what a small step gains, rendered anew; looking at a
/// cheek, since no derivative knows outlines and what they hide.
#[test]
fn the_gradient_is_what_small_steps_gain() {
    let mut case = Case::new(3);
    let open: Vec<u8> = (0..SIDE * SIDE)
        .map(|i| {
            let [x, y] = [i % SIDE, i / SIDE].map(|c| c as f32 / SIDE as f32);
            let [x, y] = [x - 0.38, y - 0.55].map(|c| c * SIDE as f32);
            (255.0 * (8.0 - math::sqrt(x * x + y * y)).clamp(0.0, 1.0)) as u8
        })
        .collect();
    case.open = Some(open);
    case.run(Options::default(), |search| {
        let mut rng = Rng::new(9, 0);
        scatter(search, &mut rng);
        let start = search.scene();
        search.find_gradient();
        let gradient: Vec<f32> = search.gradient.to_vec();
        let layout = search.layout();
        let pose = layout.subject();
        // Motion's derivatives are differences of pixels, and windows are a grid.
        for (name, block, h, bound) in [
            ("rotation", pose..pose + 3, 0.01, 0.15),
            ("translation", pose + 3..pose + 5, 1.0, 0.15),
            ("zoom", pose + 5..pose + 6, 0.01, 0.15),
            ("shape", 0..layout.shape_rank, 0.05, 0.15),
            ("albedo", layout.shape_rank..pose, 0.02, 0.002),
            ("light", layout.light(0), 0.005, 0.002),
            ("colour", layout.color(0), 0.005, 0.002),
        ] {
            // Along the gradient, where there is something to gain.
            let squares: f32 = gradient[block.clone()].iter().map(|g| g * g).sum();
            let slope = math::sqrt(squares);
            let mut energy = |h: f32| {
                let along = |i: usize| if block.contains(&i) { gradient[i] } else { 0.0 };
                let mut step: Vec<f32> = (0..layout.len()).map(|i| h * along(i) / slope).collect();
                let mut scene = start.clone();
                advance(&mut scene, layout, &mut step);
                go(search, &scene);
                search.make_judged();
                search.energy.image
            };
            let found = (energy(-h) - energy(h)) / (2.0 * f64::from(h));
            std::println!("{name}: {slope:.4} by reverse, {found:.4} by rendering");
            assert!((found / f64::from(slope) - 1.0).abs() < bound, "{name}: {slope} {found}");
        }
    });
}

#[test]
fn the_rows_of_the_matrix_are_the_gradients() {
    let case = Case::new(4);
    case.run(Options::default(), |search| {
        search.make_judged();
        search.find_gradient();
        let gradient: Vec<f32> = search.gradient.to_vec();
        let n = search.layout().len();
        let ModeSearch { common, first, scratch, .. } = search;
        let taken = taken(common, first);
        let looking = (Shading::new(&first.view), Window::new(&first.view));
        let mut sum = vec![0.0_f64; n];
        let weight = common.pixel_weight();
        for y in first.frame.rows() {
            for x in first.frame.columns() {
                let index = y * SIDE as usize + x;
                let mask = at(first.planes.weights, index);
                if mask < 1e-3 {
                    continue;
                }
                first.fill_rows(common, &looking, [x, y], scratch).unwrap();
                let cost = first.cost(index, taken[index]);
                for (row, c) in scratch.rows.iter().zip(cost) {
                    for (sum, r) in sum.iter_mut().zip(&**row) {
                        *sum += f64::from(weight * c * r);
                    }
                }
            }
        }
        let size = gradient.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>().sqrt();
        for (i, (g, s)) in gradient.iter().zip(sum).enumerate() {
            assert!((f64::from(*g) - s).abs() < 1e-3 * size, "{i}: {g} {s}");
        }
    });
}

#[test]
fn a_pixels_weight_is_what_its_difference_costs() {
    let case = Case::new(3);
    case.run(Options::default(), |search| {
        search.step();
        search.make_judged();
        let width = SIDE as usize;
        let covered = |search: &ModeSearch<'_, '_>, i: usize| search.mask()[i] > 0.0;
        let pixels: Vec<usize> = (0..width * width).filter(|&i| covered(search, i)).collect();
        // At the outline, where neighbours are missing, and elsewhere.
        let edge = pixels.iter().filter(|&&i| !covered(search, i + 2) || !covered(search, i - 2));
        let probed: Vec<usize> =
            edge.step_by(7).chain(pixels.iter().step_by(97)).copied().collect();
        let (mut error, mut size) = (0.0, 0.0);
        let taken = taken(&search.common, &search.first);
        for i in probed {
            let ModeSearch { common, first, .. } = &*search;
            let expected = common.pixel_weight() * first.cost(i, taken[i])[1];
            let step = 0.01;
            let image = [step, -step].map(|by| {
                search.first.planes.photo[1][i] += by;
                search.judged = false;
                search.make_judged();
                search.first.planes.photo[1][i] -= by;
                search.energy().image
            });
            search.judged = false;
            search.make_judged();
            let found = (image[0] - image[1]) / f64::from(2.0 * step);
            error += (found - f64::from(expected)).powi(2);
            size += f64::from(expected).powi(2);
        }
        assert!(error < 1e-4 * size, "{error} {size}");
    });
}

#[test]
fn a_face_of_the_model_is_found_again() {
    let case = Case::new(5);
    let (scene, converged) = case.run(Options::default(), |search| {
        let mut last = f64::INFINITY;
        let mut level = usize::MAX;
        while let Some(iteration) = search.step() {
            assert!(iteration.after.total() <= iteration.before.total());
            if iteration.level == level {
                last = iteration.after.total();
            }
            level = iteration.level;
        }
        assert!(last.is_finite());
        (search.scene(), search.converged())
    });
    assert!(converged);
    let [shape, albedo] = [
        cosine(&scene.subject.shape, &case.truth.subject.shape),
        cosine(&scene.subject.albedo, &case.truth.subject.albedo),
    ];
    // One small picture shows little of the shape; that it goes the right way is what is asked. Of
    // the albedo, what is smooth may be shade.
    assert!(shape > 0.3 && albedo > 0.85, "{shape} {albedo}");
    assert!((scene.view.pose.yaw - case.truth.view.pose.yaw).abs() < 0.05);
}

#[test]
fn another_start_changes_the_way_and_not_the_mode() {
    let mut case = Case::new(6);
    case.config.pixel_patch = Config::default().pixel_patch;
    let modes: Vec<(Scene, f64)> = [0.0, -0.04, 0.04, 0.08]
        .map(|turn| {
            case.run(Options::default(), |search| {
                // The pixels to be covered are counted once, by the landmarks' pose.
                search.make_judged();
                search.first.view.pose.yaw += turn;
                (search.rendered, search.judged) = (false, false);
                while search.step().is_some() {}
                (search.scene(), search.energy().total())
            })
        })
        .into();
    for (scene, energy) in &modes[1..] {
        assert!((energy - modes[0].1).abs() < 1.0, "{energy} {}", modes[0].1);
        for (a, b) in scene.subject.shape.iter().zip(&modes[0].0.subject.shape) {
            assert!((a - b).abs() < 0.25, "{a} {b}");
        }
    }
}

#[test]
fn a_face_is_found_whichever_way_up_it_is() {
    let mut case = Case::new(8);
    let upright = case.run(Options::default(), |search| search.initial().pose);
    let last = SIDE as f32 - 1.0;
    for (_, [u, v]) in &mut case.landmarks {
        (*u, *v) = (last - *u, last - *v);
    }
    let turned = case.run(Options::default(), |search| search.initial().pose);
    assert!((math::sin_cos(turned.roll - upright.roll).1 + 1.0).abs() < 1e-3, "{turned:?}");
}

/// Paints ellipses about the eyes of a picture, `size` times as wide as their corners are apart, and
/// gives the mask in the middle of each.
fn masks_of_painted_eyes(mut case: Case, size: f32, color: [u8; 3]) -> [f32; 2] {
    case.config.pixel_patch = Config::default().pixel_patch;
    let middles = ["left", "right"].map(|side| {
        let corner = |which: &str| {
            let name = std::format!("{side}.eye.corner_{which}");
            case.landmarks.iter().find(|(n, _)| *n == name).unwrap().1
        };
        let [[a, b], [c, d]] = [corner("inner"), corner("outer")];
        ([0.5 * (a + c), 0.5 * (b + d)], 0.5 * math::sqrt((a - c) * (a - c) + (b - d) * (b - d)))
    });
    for (i, pixel) in case.pixels.iter_mut().enumerate() {
        let [x, y] = [i % SIDE as usize, i / SIDE as usize].map(|x| x as f32);
        let painted = middles.iter().any(|([u, v], half)| {
            let [x, y] = [(x - u) / (size * half), (y - v) / (0.6 * size * half)];
            x * x + y * y < 1.0
        });
        if painted {
            *pixel = color;
        }
    }
    case.run(Options::default(), |search| {
        while search.step().is_some() {}
        middles.map(|([u, v], _)| search.mask()[v as usize * SIDE as usize + u as usize])
    })
}

#[test]
fn eyes_may_have_any_colour_but_not_what_is_around_them() {
    let green = masks_of_painted_eyes(Case::new(5), 1.1, [30, 190, 60]);
    assert!(green.iter().all(|&mask| mask > 0.9), "{green:?}");
    let glasses = masks_of_painted_eyes(Case::new(5), 2.5, [12, 10, 10]);
    assert!(glasses.iter().all(|&mask| mask < 0.1), "{glasses:?}");
}

#[test]
fn where_the_caller_says_it_is_hidden_is_no_face() {
    let mut case = Case::new(7);
    let side = SIDE as usize;
    let mut open = vec![255; case.pixels.len()];
    for row in open.chunks_mut(side) {
        row[..side / 2].fill(0);
    }
    case.open = Some(open.clone());
    for occlusion in [true, false] {
        let options = Options { occlusion, ..Options::default() };
        case.run(options, |search| {
            while search.step().is_some() {}
            let shown = search.mask().chunks(side).map(|row| row.split_at(side / 2));
            let (left, right): (Vec<_>, Vec<_>) = shown.unzip();
            assert!(left.concat().iter().all(|m| *m == 0.0));
            let seen = right.concat().iter().filter(|m| **m > 0.9).count();
            assert!(seen > 300, "{seen}");
        });
    }
    let model = model(&case.bytes);
    let (name, position) = case.landmarks[0];
    let observed = [ObservedLandmark { name, position }];
    let image = Image { pixels: &case.pixels, width: SIDE, height: SIDE };
    let problem = Problem::new(&model, image, &observed, &case.config).with_open(Some(&open[1..]));
    let mut memory = vec![0; words(&problem, &Options::default())];
    let refused = <ModeSearch<'_, '_>>::new(problem, Options::default(), &mut memory).err();
    assert_eq!(refused, Some(ChainError::Image));
}

#[test]
fn what_hides_the_face_does_not_bend_it() {
    let mut case = Case::new(7);
    let clean = case.run(Options::default(), |search| {
        while search.step().is_some() {}
        search.scene()
    });
    // A dark bar over the forehead, as hair.
    let brows = case.landmarks.iter().filter(|(name, _)| name.contains("eyebrow"));
    let brow = brows.map(|(_, [_, v])| *v).fold(f32::INFINITY, f32::min);
    let bar = (brow as usize).saturating_sub(14)..(brow as usize).saturating_sub(5);
    for y in bar.clone() {
        for x in 0..SIDE as usize {
            case.pixels[y * SIDE as usize + x] = [20, 15, 10];
        }
    }
    let distance = |scene: &Scene| {
        let d: f32 = scene
            .subject
            .shape
            .iter()
            .zip(&clean.subject.shape)
            .map(|(a, b)| (a - b) * (a - b))
            .sum();
        math::sqrt(d)
    };
    let [robust, plain] = [true, false].map(|occlusion| {
        let options = Options { occlusion, ..Options::default() };
        case.run(options, |search| {
            while search.step().is_some() {}
            let hidden =
                bar.clone().map(|y| at(search.mask(), y * SIDE as usize + 48)).fold(0.0, f32::max);
            (distance(&search.scene()), hidden)
        })
    });
    assert!(robust.0 < 0.2 * plain.0 && robust.1 < 0.1, "{robust:?} {plain:?}");
}

#[test]
fn priors_and_landmarks_pull_as_their_energies_fall() {
    let case = Case::new(8);
    case.run(Options::default(), |search| {
        let mut rng = Rng::new(2, 0);
        let mut scene = search.scene();
        for c in scene.subject.shape.iter_mut().chain(&mut scene.subject.albedo) {
            *c = rng.normal_sd(0.8);
        }
        for l in scene.view.light.as_flattened_mut() {
            *l += rng.normal_sd(0.1);
        }
        scene.view.pose.translation = [30.0, -20.0, -900.0];
        scene.view.camera.focal_length *= 1.2;
        scene.view.color.gain = [1.03, 0.97, 1.01];
        scene.view.color.contrast = 0.9;
        scene.view.color.offset = [0.01, -0.02, 0.005];
        let layout = search.layout();
        let (n, priors) = (layout.len(), search.common.priors());
        let mut memory = vec![0.0; system_words(n)];
        let mut right = |landmarks: bool, search: &mut ModeSearch<'_, '_>| {
            let mut system =
                System::new(n, Engine::PORTABLE.normal_equations, &mut memory).unwrap();
            if landmarks {
                go(search, &scene);
                let ModeSearch { common, first, .. } = search;
                let (marks, view) = (&first.landmarks, &first.view);
                landmarks::add_equations(common, marks, view, 0, &mut system);
            } else {
                priors.add_of_subject(&scene.subject, layout, &mut system);
                priors.add_of_view(&scene.view, 0, layout, &mut system);
            }
            system.right_side().to_vec()
        };
        let energy = |scene: &Scene| {
            priors.energy_of_subject(&scene.subject) + priors.energy_of_view(&scene.view)
        };
        let found = [right(false, search), right(true, search)];
        for (name, right, h) in [("priors", &found[0], 1e-2), ("landmarks", &found[1], 1e-3)] {
            for i in 0..n {
                let mut at = |h: f32| {
                    let mut step = vec![0.0; n];
                    step[i] = h;
                    let mut scene = scene.clone();
                    advance(&mut scene, layout, &mut step);
                    if name == "priors" {
                        energy(&scene)
                    } else {
                        go(search, &scene);
                        search.first.landmark_energy(&search.common)
                    }
                };
                let slope = (at(-h) - at(h)) / (2.0 * f64::from(h));
                let right = f64::from(right[i]);
                let bound = 0.02 * right.abs() + 0.02;
                assert!((slope - right).abs() < bound, "{name} {i}: {right} {slope}");
            }
        }
        let mut expected = search.scene();
        expected.view.light = frontal();
        assert!(energy(&scene) > energy(&expected));
    });
}

#[test]
fn normals_are_those_of_the_renderer() {
    let case = Case::new(2);
    case.run(Options::default(), |search| {
        go(search, &case.truth);
        search.make_judged();
        let Common { problem: Problem { model, .. }, instance, .. } = &search.common;
        let mut normals = vec![[0.0; 4]; padded(model.vertices())];
        vertex_normals(model.triangles, instance.positions, &mut normals);
        for (v, normal) in normals.iter().enumerate().take(model.vertices()) {
            let difference = sub(xyz(*normal), xyz(at(instance.normals, v)));
            assert!(dot(difference, difference) < 1e-10, "{v}");
        }
    });
}

#[test]
fn a_basis_and_its_transpose_agree_about_products() {
    let bytes = aligned();
    let model = model(&bytes);
    let mut rng = Rng::new(4, 0);
    for basis in [&model.shape, &model.albedo] {
        let c: Vec<f32> = (0..basis.rank()).map(|_| rng.normal_sd(1.0)).collect();
        let mut cost = vec![[0.0; 4]; padded(model.vertices())];
        for cost in cost.iter_mut().take(model.vertices()) {
            *cost = [rng.normal_sd(1.0), rng.normal_sd(1.0), rng.normal_sd(1.0), 0.0];
        }
        let mut fields = [&c[..], &[]].map(|c| {
            let mut field = vec![[0.0; 4]; cost.len()];
            basis.instance(c, &mut field);
            field
        });
        let [field, mean] = &mut fields;
        let one: f64 = field
            .iter()
            .zip(mean)
            .zip(&cost)
            .map(|((x, m), y)| f64::from(dot(sub(xyz(*x), xyz(*m)), xyz(*y))))
            .sum();
        let mut costs = vec![0.0; c.len()];
        basis.transposed(&cost, &mut costs);
        let two: f64 = costs.iter().zip(&c).map(|(x, y)| f64::from(x * y)).sum();
        assert!((one - two).abs() < 1e-3 * one.abs().max(1.0), "{one} {two}");
    }
}

#[test]
fn evenness_is_the_share_of_a_components_means() {
    let bytes = aligned();
    let model = model(&bytes);
    let basis = &model.albedo;
    let entries = padded(model.vertices()) as f32;
    let evenness: Vec<f32> = (0..basis.rank()).map(|i| basis.evenness(i)).collect();
    for (component, evenness) in evenness.iter().enumerate() {
        let (mut sums, mut squares) = ([0.0; 3], 0.0);
        let mut components = vec![[0.0; 3]; basis.rank()];
        for vertex in 0..model.vertices() {
            basis.at(vertex, &mut components);
            let entry = components[component];
            sums = add(sums, entry);
            squares += dot(entry, entry);
        }
        let expected = dot(sums, sums) / (entries * squares);
        assert!((evenness - expected).abs() < 1e-4, "{component}: {evenness} {expected}");
    }
    assert!(evenness[0] > 0.5 && evenness.iter().sum::<f32>() < 3.001, "{evenness:?}");
    assert!(basis.evenness(basis.rank()) == 0.0);
}

#[test]
fn rows_of_a_basis_are_sums_of_its_entries_with_or_without_a_copy() {
    let bytes = aligned();
    let model = model(&bytes);
    let mut rng = Rng::new(6, 0);
    let (basis, rank) = (&model.shape, model.shape.rank());
    let mut memory = vec![0; by_vertex_words(model.vertices(), rank)];
    let copy =
        ByVertex::carve(&mut Carver::new(&mut memory), basis, model.vertices(), rank).unwrap();
    let costs: Vec<Costs> =
        (0..5).map(|i| (37 * i, from_fn(|_| from_fn(|_| rng.normal_sd(1.0))))).collect();
    let [with, without] = [Some(&copy), None].map(|copy| {
        let mut rows = [(); 3].map(|()| vec![0.0; rank]);
        basis.rows(copy, &costs, rows.each_mut().map(|row| &mut row[..]));
        rows
    });
    assert_eq!(with, without);
    for (f, row) in with.iter().enumerate() {
        let mut expected = vec![0.0; rank];
        let mut entries = vec![[0.0; 3]; rank];
        for (vertex, costs) in &costs {
            basis.at(*vertex, &mut entries);
            for (sum, entry) in expected.iter_mut().zip(&entries) {
                *sum += dot(costs[f], *entry);
            }
        }
        for (x, expected) in row.iter().zip(&expected) {
            assert!((x - expected).abs() < 1e-4 * expected.abs().max(1.0), "{x} {expected}");
        }
    }
}

#[test]
fn scarce_memory_changes_no_bits() {
    let case = Case::new(5);
    let [rich, lean] = [false, true].map(|lean| {
        case.run_with(Options::default(), lean, |search| {
            for _ in 0..4 {
                search.step();
            }
            search.fingerprint()
        })
    });
    assert_eq!(rich, lean);
}

/// As far as the posterior reaches: of a step in every direction at once, of one that does not turn the head,
/// and of those that leave the surface where it is.
#[test]
fn a_held_densitys_force_is_the_slope_of_its_energy() {
    let case = Case::new(4);
    case.give(Options::default(), false, |mut search| {
        while search.step().is_some() {}
        let layout = search.layout();
        let n = layout.len();
        let model = search.common.problem.model;
        let mut shown = vec![0; part_words(model)];
        let part = Part::new(&mut search, &mut shown).unwrap();
        let instance = instance_words(model.vertices(), model.triangles.len());
        let mut memory = vec![0; Held::words(&search) + instance];
        let mut carver = Carver::new(&mut memory);
        let mut held = Held::new(search, &mut carver).unwrap();
        let mut factor = vec![0.0; matrix_words(n)];
        held.factorise(&mut factor).unwrap();
        held.look_at(&part, &mut carver).unwrap();
        let metric = Metric::new(n, factor.as_chunks_mut().0).unwrap();
        let mut rng = Rng::new(6, 0);
        let mut normal = || -> Vec<f32> {
            let mut z: Vec<f32> = (0..n).map(|_| rng.normal_sd(1.0)).collect();
            metric.solve(&mut z);
            z
        };
        let mut check = |moving: &dyn Fn(usize) -> bool, most: f64| {
            let mut found = Vec::new();
            for _ in 0..30 {
                let (place, mut direction) = (normal(), normal());
                for (i, d) in direction.iter_mut().enumerate() {
                    *d = if moving(i) { *d } else { 0.0 };
                }
                let mut at = |h: f32| {
                    let mut step: Vec<f32> =
                        place.iter().zip(&direction).map(|(p, d)| p + h * d).collect();
                    held.energy(&mut step).unwrap()
                };
                let slope = (at(-0.02) - at(0.02)) / 0.04;
                at(0.0);
                let force = held.force().iter().zip(&direction);
                found.push((slope, force.map(|(f, d)| f64::from(f * d)).sum::<f64>()));
            }
            let rms = |f: &dyn Fn(&(f64, f64)) -> f64| -> f64 {
                (found.iter().map(|x| f(x).powi(2)).sum::<f64>() / found.len() as f64).sqrt()
            };
            let (size, off) = (rms(&|x| x.0), rms(&|x| x.0 - x.1));
            assert!(off < most * size, "{off} of {size}: {found:?}");
        };
        // One turn after another is nearly the turn of both.
        check(&|_| true, 0.02);
        let turn = layout.pose(0).start..layout.pose(0).start + 3;
        check(&|i| !turn.contains(&i), 0.01);
        let still = layout.shape_rank..layout.pose(0).start;
        check(&|i| still.contains(&i) || i >= layout.light(0).start, 0.002);
    });
}

/// The mode's matrix is what forces say around it, on average.
#[test]
fn a_held_densitys_matrix_is_how_its_force_changes() {
    let case = Case::new(4);
    case.give(Options::default(), false, |mut search| {
        while search.step().is_some() {}
        let n = search.layout().len();
        let mut memory = vec![0; Held::words(&search)];
        let mut held = Held::new(search, &mut Carver::new(&mut memory)).unwrap();
        let mut factor = vec![0.0; matrix_words(n)];
        held.factorise(&mut factor).unwrap();
        let metric = Metric::new(n, factor.as_chunks_mut().0).unwrap();
        let mut rng = Rng::new(7, 0);
        let mut sum = 0.0;
        for _ in 0..200 {
            let mut step: Vec<f32> = (0..n).map(|_| rng.normal_sd(0.5)).collect();
            metric.solve(&mut step);
            let mut along = |sign: f32| {
                let mut step: Vec<f32> = step.iter().map(|x| sign * x).collect();
                held.energy(&mut step).unwrap();
                let force = held.force().iter().zip(&step);
                -force.map(|(f, x)| f64::from(f * x)).sum::<f64>()
            };
            sum += 0.5 * (along(1.0) + along(-1.0));
        }
        // Of a normal density `zᵀz`, of which 1/4 is expected per unknown.
        let ratio = sum / (200.0 * 0.25 * n as f64);
        assert!((0.7..1.3).contains(&ratio), "{ratio}");
    });
}

#[test]
fn a_sampler_says_how_much_memory_it_needs() {
    let case = Case::new(4);
    let begin = |words: usize| {
        let mut found = Ok(());
        case.give(Options::default(), false, |mut search| {
            while search.step().is_some() {}
            let mut shown = vec![0; part_words(search.common.problem.model)];
            let part = Part::new(&mut search, &mut shown).unwrap();
            found = Sampler::new(search, &part, 9, 1, 0, &mut vec![0; words]).map(|_| ());
        });
        found
    };
    let Err(ChainError::Memory { needed, found: 0 }) = begin(0) else { panic!() };
    assert_eq!(begin(needed), Ok(()));
    assert_eq!(begin(needed - 1), Err(ChainError::Memory { needed, found: needed - 1 }));
}

#[test]
fn a_sampler_moves_and_repeats_itself() {
    let case = Case::new(4);
    let run = |chains: &[(u64, u32)]| -> Vec<u64> {
        let mut found = Vec::new();
        for &(seed, stream) in chains {
            case.give(Options::default(), false, |mut search| {
                while search.step().is_some() {}
                let mut shown = vec![0; part_words(search.common.problem.model)];
                let part = Part::new(&mut search, &mut shown).unwrap();
                let problem = &search.common.problem;
                let words = posterior::words(problem, &Options::default(), 200);
                let mut memory = vec![0; words];
                let mut chain =
                    Sampler::new(search, &part, 200, seed, stream, &mut memory).unwrap();
                let n = chain.unknowns();
                for _ in 0..20 {
                    chain.warm_up();
                }
                let mut places = chain.places().to_vec();
                assert!(places.len() == 400 * n || places.len() > 40 * n, "{}", places.len());
                let mut memory = vec![0.0; improve_words(n)];
                let change = improve(n, &mut places, Engine::PORTABLE, &mut memory).unwrap();
                chain.adopt(&change);
                for _ in 0..20 {
                    chain.warm_up();
                }
                for _ in 0..60 {
                    chain.step();
                }
                assert_eq!(chain.views().count(), 1);
                let (steps, accepted) = chain.tally();
                assert!(2 * accepted > steps && steps == 60, "{accepted} of {steps}");
                found.push(chain.fingerprint());
            });
        }
        found
    };
    let [first, again, stream, seed] = run(&[(1, 0), (1, 0), (1, 1), (2, 0)])[..] else { panic!() };
    assert_eq!(first, again);
    assert!(first != stream && first != seed && stream != seed);
}
