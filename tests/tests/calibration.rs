//! How often the posterior's intervals hold the truth (docs/calibration.md).
//!
//! Faces of known truth, none of which the model has seen: drawn under the model's own light and noise, and
//! rough pictures that no renderer of ours made. A few by default; `cargo xtask calibration` has
//! this test sample forty of each: `ONESCAN_ROUGH=DIR`, and `ONESCAN_FACES=N` and `ONESCAN_PATCH=N` for
//! other numbers of faces, and of pixels per independent error.

use onescan::demo::{FIT_LANDMARKS, random_light, synthetic_photo, template, template_model};
use onescan::experiment::faces::{Identity, identities};
use onescan::fit::{Control, Job, Schedule};
use onescan::mesh::Mesh;
use onescan::model::layout;
use onescan::photo::Crop;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::posterior::{Request, sample};
use onescan::render;
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use onescan_tests::photos;
use onescan_tests::truth::{aligned, distances_after_alignment, rms};
use std::path::Path;

/// Components of each half of the model.
const RANK: usize = 199;
/// Shares that intervals are to hold.
const LEVELS: [f64; 2] = [0.5, 0.9];
/// Columns and rows of pixels that are wrong together, as the model has it.
const PATCH: f32 = 9.0;

/// A picture of known truth.
struct Case<'a> {
    photo: Picture,
    landmarks: Tlms,
    crop: Crop,
    truth: &'a Identity,
    /// Radians, where that is known.
    yaw: Option<f64>,
}

/// What a posterior came to: shares of what its intervals hold, and how far faces are from the truth.
#[derive(Clone, Copy, Default)]
struct Found {
    vertices: [f64; 2],
    albedo: [f64; 2],
    yaw: Option<[f64; 2]>,
    /// Up to size, mm: of the mode, of the posterior's mean, and of the template.
    shape: [f64; 3],
    /// The same of albedo.
    color: [f64; 3],
    /// Standard deviation of a vertex, mm.
    spread: f64,
}

/// Faces under the model's own light and noise: a channel is off by its standard deviation, in whole patches
/// of the picture, and 2 % at every pixel.
fn drawn(people: &[Identity], count: usize) -> Vec<Case<'_>> {
    let (template, names) = template().unwrap();
    let count = count.min(people.len());
    let every = people.len() / count;
    let case = |number: usize| {
        let truth = &people[every * number];
        let mesh = Mesh {
            points: truth.points.clone(),
            colors: truth.colors.clone(),
            triangles: template.triangles.clone(),
        };
        let rigid = layout::rigid(&mesh, &names).unwrap();
        let mut rng = Rng::new(500 + number as u64, 0);
        let mut scene = Scene::initial(256, 256, 0, 0);
        scene.view.pose.yaw = (80.0 * (rng.uniform() as f32 - 0.5)).to_radians();
        random_light(&mut scene, &mut rng);
        let (mut photo, landmarks) =
            synthetic_photo(&rigid.view(), &scene, 0.02, &FIT_LANDMARKS, &mut rng).unwrap();
        let sd = Schedule::Mode.config(&rigid.view(), Crop::LONGER_SIDE).pixel_sd;
        soil(&mut photo, sd, &mut rng);
        let crop = Crop::whole([photo.width, photo.height]);
        let yaw = Some(f64::from(scene.view.pose.yaw));
        Case { photo, landmarks, crop, truth, yaw }
    };
    (0..count).map(case).collect()
}

/// Adds errors of a patch's size: normal at the corners of a lattice, linear between.
fn soil(photo: &mut Picture, sd: f32, rng: &mut Rng) {
    // The variance between corners is 4/9 of theirs on average.
    let sd = 1.5 * sd;
    let across = photo.width as usize;
    let corners = (across as f32 / PATCH) as usize + 2;
    let lattice: Vec<[f32; 3]> =
        (0..corners * corners).map(|_| std::array::from_fn(|_| rng.normal_sd(sd))).collect();
    for (i, pixel) in photo.rgb.iter_mut().enumerate() {
        let [x, y] = [i % across, i / across].map(|x| x as f32 / PATCH);
        let at = |dx: usize, dy: usize| lattice[(y as usize + dy) * corners + x as usize + dx];
        let (u, v) = (x.fract(), y.fract());
        for (c, channel) in pixel.iter_mut().enumerate() {
            let above = at(0, 0)[c] * (1.0 - u) + at(1, 0)[c] * u;
            let below = at(0, 1)[c] * (1.0 - u) + at(1, 1)[c] * u;
            let value = f32::from(*channel) + 255.0 * (above * (1.0 - v) + below * v);
            *channel = value.clamp(0.0, 255.0).round() as u8;
        }
    }
}

/// Rough pictures from the front and at 30°, of people as far apart in the list as can be.
fn rough<'a>(directory: &Path, people: &'a [Identity], count: usize) -> Vec<Case<'a>> {
    let truth = std::fs::read(directory.join("truth.json")).ok();
    let truth: Option<serde_json::Value> = truth.map(|text| serde_json::from_slice(&text).unwrap());
    let name = |person: usize, yaw: u32| format!("{person:02}_{yaw:02}");
    let has = |name: &String| directory.join(name).with_extension("jpg").is_file();
    let all: Vec<usize> = (0..people.len()).filter(|person| has(&name(*person, 0))).collect();
    let every = (2 * all.len() / count).max(1);
    let pictures = all.iter().step_by(every).flat_map(|person| [(*person, 0), (*person, 30)]);
    let case = |(person, yaw): (usize, u32)| {
        let name = name(person, yaw);
        let path = directory.join(&name).with_extension("jpg");
        let (photo, landmarks) = photos::read(&path);
        let (size, points) = ([photo.width, photo.height], landmarks.visible_points());
        let crop = Crop::around(&points, size, Crop::ENLARGE, Crop::LONGER_SIDE).unwrap();
        let yaw = truth.as_ref().and_then(|t| t[&name]["rotation"][2][0].as_f64());
        let yaw = yaw.map(|sine| (-sine).asin());
        Case { photo, landmarks, crop, truth: &people[person], yaw }
    };
    pictures.take(count).map(case).collect()
}

/// Shares of true values that are inside the intervals of states' values.
fn held(states: &[Vec<f32>], truth: &[f32]) -> [f64; 2] {
    let mut inside = [0.0; 2];
    let mut values = vec![0.0; states.len()];
    for (i, truth) in truth.iter().enumerate() {
        for (value, state) in values.iter_mut().zip(states) {
            *value = state[i];
        }
        values.sort_by(f32::total_cmp);
        for (inside, level) in inside.iter_mut().zip(LEVELS) {
            let quantile = |q: f64| {
                let place = q * (values.len() - 1) as f64;
                let (below, part) = (values[place as usize], place.fract() as f32);
                below + part * (values[(place as usize + 1).min(values.len() - 1)] - below)
            };
            let [low, high] = [0.5 - 0.5 * level, 0.5 + 0.5 * level].map(quantile);
            *inside += f64::from(u8::from(low <= *truth && *truth <= high));
        }
    }
    inside.map(|inside| inside / truth.len() as f64)
}

/// Mean of states' values.
fn mean(states: &[Vec<f32>]) -> Vec<[f32; 3]> {
    let mut sums = vec![0.0_f64; states[0].len()];
    for state in states {
        for (sum, value) in sums.iter_mut().zip(state) {
            *sum += f64::from(*value);
        }
    }
    let all: Vec<f32> = sums.iter().map(|sum| (sum / states.len() as f64) as f32).collect();
    all.as_chunks().0.to_vec()
}

fn run(
    model: &Model<'_>,
    template: &Mesh,
    case: &Case<'_>,
    draws: u32,
    patch: Option<f32>,
) -> Found {
    let config = Schedule::Mode.config(model, Crop::LONGER_SIDE);
    let config = config.with(|config| config.pixel_patch = patch.unwrap_or(config.pixel_patch));
    let job = Job {
        model,
        photo: &case.photo,
        landmarks: &case.landmarks,
        crop: case.crop,
        mask: None,
        schedule: Schedule::Mode,
        config,
        seed: 0,
        chains: 1,
    };
    let request = Request { draws, chains: 4, seed: 1 };
    let (fits, samples) =
        sample(&[job], &request, &Control::default()).unwrap().expect("not stopped");
    let mode = &fits[0].best.scene.subject;
    let faces: Vec<Mesh> = samples
        .draws()
        .map(|draw| render::instance(model, &draw.subject.shape, &draw.subject.albedo))
        .collect();
    let flat = |values: &[[f32; 3]]| values.as_flattened().to_vec();
    let average = mean(&faces.iter().map(|face| flat(&face.points)).collect::<Vec<_>>());
    let on = |points: &[[f32; 3]]| flat(&aligned(points, &average)[1]);
    let shapes: Vec<Vec<f32>> = faces.iter().map(|face| on(&face.points)).collect();
    let colors: Vec<Vec<f32>> = faces.iter().map(|face| flat(&face.colors)).collect();
    let average_color = mean(&colors);
    let yaws: Vec<Vec<f32>> = samples.draws().map(|draw| vec![draw.views[0].pose.yaw]).collect();
    let mode = render::instance(model, &mode.shape, &mode.albedo);
    let shape = |points: &[[f32; 3]]| distances_after_alignment(points, &case.truth.points)[1];
    let color = |colors: &[[f32; 3]]| {
        rms(colors.as_flattened().iter().zip(case.truth.colors.as_flattened()), 1)
    };
    let square: f64 =
        shapes.iter().map(|face| rms(face.iter().zip(average.as_flattened()), 3).powi(2)).sum();
    Found {
        vertices: held(&shapes, &on(&case.truth.points)),
        albedo: held(&colors, case.truth.colors.as_flattened()),
        yaw: case.yaw.map(|yaw| held(&yaws, &[yaw as f32])),
        shape: [shape(&mode.points), shape(&average), shape(&template.points)],
        color: [color(&mode.colors), color(&average_color), color(&template.colors)],
        spread: (square / shapes.len() as f64).sqrt(),
    }
}

/// All of a kind, and their mean.
fn all(name: &str, cases: &[Case<'_>], draws: u32, patch: Option<f32>) -> Found {
    let built = template_model(RANK, &mut |_, _| ()).unwrap();
    let (template, _) = template().unwrap();
    let mut sum = Found::default();
    let mut known = 0.0;
    let show = |name: &str, n: f64, known: f64, found: &Found| {
        let yaw = found.yaw.map(|yaw| yaw.map(|x| 100.0 * x / known));
        let percent = |x: [f64; 2]| x.map(|x| (100.0 * x / n).round());
        println!(
            "{name} vertices {:?} albedo {:?} yaw {:.0?} shape {:.2?} albedo {:.4?} spread {:.2}",
            percent(found.vertices),
            percent(found.albedo),
            yaw.unwrap_or_default(),
            found.shape.map(|x| x / n),
            found.color.map(|x| x / n),
            found.spread / n
        );
    };
    for (number, case) in cases.iter().enumerate() {
        let found = run(&built.model.view(), &template, case, draws, patch);
        show(&format!("{name} {} of {}", number + 1, cases.len()), 1.0, 1.0, &found);
        let add = |sum: &mut [f64], found: &[f64]| {
            for (sum, x) in sum.iter_mut().zip(found) {
                *sum += x;
            }
        };
        add(&mut sum.vertices, &found.vertices);
        add(&mut sum.albedo, &found.albedo);
        add(&mut sum.shape, &found.shape);
        add(&mut sum.color, &found.color);
        sum.spread += found.spread;
        if let Some(yaw) = found.yaw {
            add(sum.yaw.get_or_insert_default(), &yaw);
            known += 1.0;
        }
    }
    let n = cases.len() as f64;
    show(&format!("{name}, all {}:", cases.len()), n, known, &sum);
    Found { vertices: sum.vertices.map(|x| x / n), shape: sum.shape.map(|x| x / n), ..sum }
}

#[test]
fn intervals_hold_the_truth() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let people = identities(&fixtures).unwrap();
    let directory = std::env::var_os("ONESCAN_ROUGH");
    let (count, draws) = if directory.is_some() { (40, 50) } else { (2, 25) };
    let count = std::env::var("ONESCAN_FACES").map_or(count, |text| text.parse().unwrap());
    let patch = std::env::var("ONESCAN_PATCH").ok().map(|text| text.parse().unwrap());
    let directory = directory.map_or(fixtures.join("rough"), Into::into);
    for (name, cases) in
        [("drawn", drawn(&people, count)), ("rough", rough(&directory, &people, count))]
    {
        let found = all(name, &cases, draws, patch);
        // Of two faces the share varies by a tenth or so.
        assert!(found.vertices[1] > 0.75, "{name}: {:?}", found.vertices);
        assert!(found.vertices[0] < 0.95, "{name}: {:?}", found.vertices);
        let [_, average, template] = found.shape;
        assert!(average < template, "{name}: {:?}", found.shape);
    }
}
