//! Fits to rendered faces of known truth: the fit explains each picture better than the mean face,
//! and on average its shape and albedo are nearer to the truth.
//!
//! 20 identities the model has never seen, each at four yaw angles under random light, noise of
//! standard deviation 0.02 and landmarks off by 2 pixels. The mean face is fitted the same way
//! with pose, light and colour alone. `ONESCAN_TABLE=file` writes the table.

use faer::{Mat, Side};
use onescan::demo::{random_light, synthetic_photo, template, template_model};
use onescan::fit::{Control, Ending, Fit, Job};
use onescan::mesh::Mesh;
use onescan::model_file::OwnedModel;
use onescan::photo::Crop;
use onescan::render;
use onescan_core::chain::Config;
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;
use onescan_tests::identities::{Identity, identities};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

const IDENTITIES: usize = 20;
const YAWS: [f32; 4] = [0.0, 15.0, 30.0, 45.0];

/// Errors of one fit.
#[derive(Clone, Copy, Default)]
struct Errors {
    landmarks: f64,
    pixels: f64,
    shape: f64,
    albedo: f64,
}

/// One picture: errors of the mean face and of the fit.
#[derive(Clone, Copy, Default)]
struct Case {
    mean: Errors,
    fit: Errors,
}

#[test]
fn fits_come_nearer_to_the_truth_than_the_mean_face() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let built = template_model(50, &mut |_, _| ()).unwrap();
    let model = built.model.view();
    let identities = identities(&fixtures);
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
                    let case = run(&model, identity, number);
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
    for (group, yaw) in YAWS.iter().enumerate() {
        let Case { mean, fit } = average(&cases, group);
        assert!(fit.shape < mean.shape, "{yaw}°: shape {} is not below {}", fit.shape, mean.shape);
        assert!(
            fit.albedo < mean.albedo,
            "{yaw}°: albedo {} is not below {}",
            fit.albedo,
            mean.albedo
        );
    }
}

/// Renders one picture and fits it twice.
fn run(model: &Model<'_>, identity: &Identity, number: usize) -> Case {
    let (template, landmarks) = template().unwrap();
    let truth = Mesh {
        points: identity.points.clone(),
        colors: identity.colors.clone(),
        triangles: template.triangles,
    };
    let rigid = OwnedModel::rigid(&truth, &landmarks).unwrap();
    let mut rng = Rng::new(1000 + number as u64, 0);
    let mut scene = Scene::initial(256, 256, 0, 0);
    let side = if (number / YAWS.len()).is_multiple_of(2) { 1.0 } else { -1.0 };
    scene.pose.yaw = side * YAWS[number % YAWS.len()].to_radians();
    random_light(&mut scene, &mut rng);
    let (photo, landmarks) = synthetic_photo(&rigid.view(), &scene, 0.02, &mut rng).unwrap();
    let fit = |rank: usize| {
        let job = Job {
            model,
            photo: &photo,
            landmarks: &landmarks,
            crop: Crop::whole([photo.width, photo.height]),
            config: Config { shape_rank: rank, albedo_rank: rank, ..Config::default() },
            seed: 7,
            chains: 1,
        };
        let (stop, steps) = (AtomicBool::new(false), AtomicU64::new(0));
        let Ending::Done(fit) = job.run(None, &Control { stop: &stop, steps: &steps }).unwrap()
        else {
            panic!("nobody stopped the fit");
        };
        errors(model, &fit, &truth)
    };
    Case { mean: fit(0), fit: fit(50) }
}

fn errors(model: &Model<'_>, fit: &Fit, truth: &Mesh) -> Errors {
    let found = render::instance(model, &fit.best.scene.shape, &fit.best.scene.albedo);
    Errors {
        landmarks: fit.best_quality.landmark_rmse,
        pixels: fit.best_quality.pixel_rmse,
        shape: distance_after_alignment(&found.points, &truth.points),
        albedo: rms(found.colors.as_flattened().iter().zip(truth.colors.as_flattened()), 1),
    }
}

/// Root mean square over groups of `per` differences.
fn rms<'a>(pairs: impl Iterator<Item = (&'a f32, &'a f32)>, per: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (a, b) in pairs {
        sum += f64::from(a - b).powi(2);
        count += 1;
    }
    (sum / (count / per).max(1) as f64).sqrt()
}

/// Root mean square vertex distance, mm, after the best rotation and translation (Horn 1987: the
/// rotation is the leading eigenvector of a 4×4 matrix, as a quaternion).
fn distance_after_alignment(moving: &[[f32; 3]], fixed: &[[f32; 3]]) -> f64 {
    let centre = |points: &[[f32; 3]]| {
        let mut sum = [0.0; 3];
        for p in points {
            for i in 0..3 {
                sum[i] += f64::from(p[i]) / points.len() as f64;
            }
        }
        sum
    };
    let (a, b) = (centre(moving), centre(fixed));
    let mut s = [[0.0; 3]; 3];
    for (p, q) in moving.iter().zip(fixed) {
        for i in 0..3 {
            for j in 0..3 {
                s[i][j] += (f64::from(p[i]) - a[i]) * (f64::from(q[j]) - b[j]);
            }
        }
    }
    let n = [
        [s[0][0] + s[1][1] + s[2][2], s[1][2] - s[2][1], s[2][0] - s[0][2], s[0][1] - s[1][0]],
        [0.0, s[0][0] - s[1][1] - s[2][2], s[0][1] + s[1][0], s[2][0] + s[0][2]],
        [0.0, 0.0, s[1][1] - s[0][0] - s[2][2], s[1][2] + s[2][1]],
        [0.0, 0.0, 0.0, s[2][2] - s[0][0] - s[1][1]],
    ];
    let n = Mat::from_fn(4, 4, |i, j| n[i.min(j)][i.max(j)]);
    let eigen = n.self_adjoint_eigen(Side::Lower).unwrap();
    let [w, x, y, z] = [0, 1, 2, 3].map(|i| eigen.U()[(i, 3)]);
    let r = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ];
    let mut sum = 0.0;
    for (p, q) in moving.iter().zip(fixed) {
        for i in 0..3 {
            let turned: f64 = (0..3).map(|j| r[i][j] * (f64::from(p[j]) - a[j])).sum();
            sum += (turned - (f64::from(q[i]) - b[i])).powi(2);
        }
    }
    (sum / moving.len() as f64).sqrt()
}

#[test]
fn alignment_removes_a_rigid_motion_and_nothing_else() {
    let points: Vec<[f32; 3]> =
        (0..50).map(|k| [0.3, 1.7, 2.9].map(|f| 40.0 * (f * k as f32).sin())).collect();
    let pose = onescan_core::scene::Pose {
        scale: 1.0,
        translation: [3.0, -20.0, 7.0],
        roll: 0.4,
        yaw: -1.0,
        pitch: 0.2,
    };
    let moved: Vec<_> = points.iter().map(|&p| pose.to_world(p)).collect();
    assert!(distance_after_alignment(&points, &moved) < 1e-4);
    let mut bent = moved;
    bent[7][1] += 5.0;
    assert!(distance_after_alignment(&points, &bent) > 0.5);
}

/// Averages over one yaw group.
fn average(cases: &[Case], group: usize) -> Case {
    let of: Vec<_> = cases.iter().skip(group).step_by(YAWS.len()).collect();
    let mean = |f: &dyn Fn(&Case) -> f64| of.iter().map(|c| f(c)).sum::<f64>() / of.len() as f64;
    let errors = |pick: &dyn Fn(&Case) -> Errors| Errors {
        landmarks: mean(&|c| pick(c).landmarks),
        pixels: mean(&|c| pick(c).pixels),
        shape: mean(&|c| pick(c).shape),
        albedo: mean(&|c| pick(c).albedo),
    };
    Case { mean: errors(&|c| c.mean), fit: errors(&|c| c.fit) }
}

fn table(cases: &[Case]) -> String {
    let mut text = String::from(
        "| yaw | | landmarks, px | pixel RMSE | shape, mm | albedo RMSE |\n|---|---|---|---|---|---|\n",
    );
    for (group, yaw) in YAWS.iter().enumerate() {
        let Case { mean, fit } = average(cases, group);
        for (name, e) in [("mean face", mean), ("fit", fit)] {
            let Errors { landmarks, pixels, shape, albedo } = e;
            writeln!(
                text,
                "| {yaw}° | {name} | {landmarks:.2} | {pixels:.4} | {shape:.2} | {albedo:.4} |"
            )
            .unwrap();
        }
    }
    text
}
