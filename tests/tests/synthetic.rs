//! Fits to rendered faces of known truth: they explain pictures better than the mean face does, and a
//! search's shape and albedo are nearer to the truth on average.
//!
//! 20 identities the model has never seen, each at four yaw angles under random light, noise of
//! standard deviation 0.02 and landmarks off by 2 pixels. The mean face is fitted the same way
//! with pose, light and colour alone. `ONESCAN_TABLE=file` writes the
//! table of the test that is run alone.

use onescan::demo::{FIT_LANDMARKS, random_light, synthetic_photo, template, template_model};
use onescan::experiment::faces::{Identity, identities};
use onescan::fit::{Control, Ending, Fit, Job, Schedule};
use onescan::mesh::Mesh;
use onescan::model::layout;
use onescan::photo::Crop;
use onescan::render;
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use onescan_tests::truth::{distances_after_alignment, rms};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

const IDENTITIES: usize = 20;
const YAWS: [f32; 4] = [0.0, 15.0, 30.0, 45.0];

/// Errors of one fit.
#[derive(Clone, Copy, Default)]
struct Errors {
    landmarks: f64,
    pixels: f64,
    shape: f64,
    /// The same up to size.
    form: f64,
    albedo: f64,
}

/// One picture: errors of the mean face and of the fit.
#[derive(Clone, Copy, Default)]
struct Case {
    mean: Errors,
    fit: Errors,
}

/// The paper's chain trusts every pixel, which bends the shape; in 5,000 steps it does not come near
/// to its mode (docs/synthetic.md).
#[test]
fn the_papers_chain_explains_pictures_better_than_the_mean_face() {
    let cases = cases(Schedule::Paper);
    for (number, case) in cases.iter().enumerate() {
        assert!(
            case.fit.pixels < case.mean.pixels,
            "identity {} at {}°: pixel error {} of the fit, {} of the mean face",
            3 * (number / YAWS.len()),
            YAWS[number % YAWS.len()],
            case.fit.pixels,
            case.mean.pixels
        );
    }
}

/// At every angle, on average. What a search lowers leaves out the pixels that it masks; the error
/// here counts them.
#[test]
fn a_search_comes_nearer_to_the_truth_than_the_mean_face() {
    let cases = cases(Schedule::Mode);
    for (group, yaw) in YAWS.iter().enumerate() {
        let Case { mean, fit } = average(&cases, group);
        assert!(fit.pixels < mean.pixels, "{yaw}°: pixel error {} {}", fit.pixels, mean.pixels);
        assert!(fit.shape < mean.shape, "{yaw}°: shape {} is not below {}", fit.shape, mean.shape);
        assert!(
            fit.form < mean.form,
            "{yaw}°: up to size, {} is not below {}",
            fit.form,
            mean.form
        );
        assert!(
            fit.albedo < mean.albedo,
            "{yaw}°: albedo {} is not below {}",
            fit.albedo,
            mean.albedo
        );
    }
}

/// Components of shape and of albedo: a search seeks all of a model, a chain the paper's 50.
fn rank(schedule: Schedule) -> usize {
    match schedule {
        Schedule::Mode => 199,
        Schedule::Paper | Schedule::Sampler => 50,
    }
}

/// Fits every picture.
fn cases(schedule: Schedule) -> Vec<Case> {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let rank = rank(schedule);
    let built = template_model(rank, &mut |_, _| ()).unwrap();
    let model = built.model.view();
    let identities = identities(&fixtures).unwrap();
    let next = AtomicUsize::new(0);
    let cases = Mutex::new(vec![Case::default(); IDENTITIES * YAWS.len()]);
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, Into::into) {
            scope.spawn(|| {
                loop {
                    let number = next.fetch_add(1, Ordering::Relaxed);
                    if number >= IDENTITIES * YAWS.len() {
                        break;
                    }
                    // Every third of the sixty.
                    let identity = &identities[3 * (number / YAWS.len())];
                    let case = run(&model, identity, number, schedule);
                    cases.lock().unwrap()[number] = case;
                }
            });
        }
    });
    let cases = cases.into_inner().unwrap();
    let table = table(&cases);
    println!("{table}");
    if let Some(path) = std::env::var_os("ONESCAN_TABLE") {
        std::fs::write(path, &table).unwrap();
    }
    cases
}

/// Renders one picture and fits it twice.
fn run(model: &Model<'_>, identity: &Identity, number: usize, schedule: Schedule) -> Case {
    let (template, landmarks) = template().unwrap();
    let truth = Mesh {
        points: identity.points.clone(),
        colors: identity.colors.clone(),
        triangles: template.triangles,
    };
    let rigid = layout::rigid(&truth, &landmarks).unwrap();
    let mut rng = Rng::new(1000 + number as u64, 0);
    let mut scene = Scene::initial(256, 256, 0, 0);
    let side = if (number / YAWS.len()).is_multiple_of(2) { 1.0 } else { -1.0 };
    scene.view.pose.yaw = side * YAWS[number % YAWS.len()].to_radians();
    random_light(&mut scene, &mut rng);
    let (photo, landmarks) =
        synthetic_photo(&rigid.view(), &scene, 0.02, &FIT_LANDMARKS, &mut rng).unwrap();
    let fit = |rank: usize| {
        let job = Job {
            model,
            photo: &photo,
            landmarks: &landmarks,
            crop: Crop::whole([photo.width, photo.height]),
            mask: None,
            schedule,
            config: schedule.config(model, Crop::LONGER_SIDE).with(|config| {
                config.shape_rank = rank;
                config.albedo_rank = rank;
            }),
            seed: 7,
            chains: 1,
        };
        let Ending::Done(fit) = job.run(None, &Control::default()).unwrap() else {
            panic!("nobody stopped the fit");
        };
        errors(model, &fit, &truth)
    };
    Case { mean: fit(0), fit: fit(rank(schedule)) }
}

fn errors(model: &Model<'_>, fit: &Fit, truth: &Mesh) -> Errors {
    let found =
        render::instance(model, &fit.best.scene.subject.shape, &fit.best.scene.subject.albedo);
    let [shape, form] = distances_after_alignment(&found.points, &truth.points);
    Errors {
        landmarks: fit.best_quality.landmark_rmse,
        pixels: fit.best_quality.pixel_rmse,
        shape,
        form,
        albedo: rms(found.colors.as_flattened().iter().zip(truth.colors.as_flattened()), 1),
    }
}

/// Averages over one yaw group.
fn average(cases: &[Case], group: usize) -> Case {
    let of: Vec<_> = cases.iter().skip(group).step_by(YAWS.len()).collect();
    let mean = |f: &dyn Fn(&Case) -> f64| of.iter().map(|c| f(c)).sum::<f64>() / of.len() as f64;
    let errors = |pick: &dyn Fn(&Case) -> Errors| Errors {
        landmarks: mean(&|c| pick(c).landmarks),
        pixels: mean(&|c| pick(c).pixels),
        shape: mean(&|c| pick(c).shape),
        form: mean(&|c| pick(c).form),
        albedo: mean(&|c| pick(c).albedo),
    };
    Case { mean: errors(&|c| c.mean), fit: errors(&|c| c.fit) }
}

fn table(cases: &[Case]) -> String {
    let mut text = String::from(
        "| yaw | | landmarks, px | pixel RMSE | shape, mm | up to size, mm | albedo RMSE |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for (group, yaw) in YAWS.iter().enumerate() {
        let Case { mean, fit } = average(cases, group);
        for (name, e) in [("mean face", mean), ("fit", fit)] {
            let Errors { landmarks, pixels, shape, form, albedo } = e;
            writeln!(
                text,
                "| {yaw}° | {name} | {landmarks:.2} | {pixels:.4} | {shape:.2} | {form:.2} | \
                 {albedo:.4} |"
            )
            .unwrap();
        }
    }
    text
}
