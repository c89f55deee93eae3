//! Every move, with its correction, leaves a known target invariant.
//!
//! Many independent scenes are drawn exactly from a target, each makes a few
//! Metropolis–Hastings steps with one move alone, and the mean change of a set of statistics is
//! compared with zero in units of its standard error. Wrong or missing Jacobians show as drifts of
//! tens of standard errors.

use onescan_core::likelihood::ln_normal;
use onescan_core::proposal::{self, Axis, Branch, FACE, Half, Move, POSE, Surroundings, Table};
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;

struct Nothing;

impl Surroundings for Nothing {
    fn centre(&self, index: usize) -> Option<[f32; 3]> {
        Some([[40.0, 30.0, 10.0], [-40.0, 30.0, 10.0], [25.0, -40.0, 0.0], [0.0; 3]][index])
    }

    fn solve_light(&mut self, _: &mut Scene, _: u32, _: &mut Rng) -> Option<()> {
        None
    }
}

const LN_DISTANCE: (f64, f64) = (6.9, 0.4);
const LN_FOCAL: (f64, f64) = (2.0, 0.3);

/// An exact draw from the target.
fn draw(rng: &mut Rng) -> Scene {
    let mut scene = Scene::initial(256, 256, 6, 4);
    scene.view.pose.roll = rng.normal_sd(0.5);
    scene.view.pose.yaw = rng.normal_sd(0.5);
    scene.view.pose.pitch = rng.normal_sd(0.5);
    scene.view.pose.translation = [
        rng.normal_sd(100.0),
        rng.normal_sd(100.0),
        -(LN_DISTANCE.0 + LN_DISTANCE.1 * rng.normal()).exp() as f32,
    ];
    scene.view.camera.focal_length = (LN_FOCAL.0 + LN_FOCAL.1 * rng.normal()).exp() as f32;
    scene.view.camera.principal_point = [rng.normal_sd(0.5), rng.normal_sd(0.5)];
    for (i, channel) in scene.view.light.iter_mut().flatten().enumerate() {
        *channel = light_mean(i) as f32 + rng.normal_sd(0.3);
    }
    for g in &mut scene.view.color.gain {
        *g = 1.0 + rng.normal_sd(0.1);
    }
    scene.view.color.contrast = 1.0 + rng.normal_sd(0.1);
    for o in &mut scene.view.color.offset {
        *o = rng.normal_sd(0.1);
    }
    for c in scene.subject.shape.iter_mut().chain(&mut scene.subject.albedo) {
        *c = rng.normal_sd(1.0);
    }
    scene
}

fn light_mean(i: usize) -> f64 {
    if i < 3 { 0.5 } else { 0.1 }
}

fn ln_target(scene: &Scene) -> f64 {
    let n = |x: f32, mean: f64, sd: f64| ln_normal(f64::from(x), mean, sd);
    let log_normal = |x: f32, (mean, sd): (f64, f64)| {
        let ln = f64::from(x).ln();
        ln_normal(ln, mean, sd) - ln
    };
    let p = &scene.view.pose;
    let mut sum = n(p.roll, 0.0, 0.5) + n(p.yaw, 0.0, 0.5) + n(p.pitch, 0.0, 0.5);
    sum += n(p.translation[0], 0.0, 100.0) + n(p.translation[1], 0.0, 100.0);
    sum += log_normal(-p.translation[2], LN_DISTANCE);
    sum += log_normal(scene.view.camera.focal_length, LN_FOCAL);
    sum += scene.view.camera.principal_point.map(|x| n(x, 0.0, 0.5)).iter().sum::<f64>();
    for (i, &x) in scene.view.light.iter().flatten().enumerate() {
        sum += n(x, light_mean(i), 0.3);
    }
    for c in 0..3 {
        sum += n(scene.view.color.gain[c], 1.0, 0.1) + n(scene.view.color.offset[c], 0.0, 0.1);
    }
    sum += n(scene.view.color.contrast, 1.0, 0.1);
    for &c in scene.subject.shape.iter().chain(&scene.subject.albedo) {
        sum += n(c, 0.0, 1.0);
    }
    sum
}

fn statistics(scene: &Scene) -> Vec<f64> {
    let square = |x: f32| f64::from(x).powi(2);
    let mut s = vec![
        f64::from(scene.view.pose.yaw),
        square(scene.view.pose.yaw) + square(scene.view.pose.roll) + square(scene.view.pose.pitch),
        square(scene.view.pose.translation[0]) + square(scene.view.pose.translation[1]),
        f64::from(-scene.view.pose.translation[2]).ln(),
        f64::from(scene.view.camera.focal_length).ln(),
        f64::from(scene.view.camera.focal_length).ln().powi(2),
        square(scene.view.camera.principal_point[0]) + square(scene.view.camera.principal_point[1]),
        scene.view.light.iter().flatten().map(|&x| square(x)).sum(),
        scene.view.light.iter().flatten().map(|&x| f64::from(x)).sum(),
        f64::from(scene.view.light[0][0] - scene.view.light[0][2]),
        scene.view.color.gain.iter().map(|&x| square(x)).sum(),
        square(scene.view.color.contrast),
        scene.subject.shape.iter().map(|&x| square(x)).sum(),
        scene.subject.albedo.iter().map(|&x| square(x)).sum(),
        square(scene.subject.shape[0]).powi(2),
    ];
    for band in [0..1, 1..4, 4..9] {
        s.push(scene.view.light[band].iter().flatten().map(|&x| square(x)).sum());
    }
    s
}

/// The largest mean change of a statistic, in standard errors, and the share of accepted steps.
fn drift(branches: &[Branch], scenes: usize, steps: usize) -> (f64, f64) {
    let mut rng = Rng::new(2024, 0);
    let count = statistics(&draw(&mut rng)).len();
    let (mut sum, mut sum2) = (vec![0.0; count], vec![0.0; count]);
    let mut accepted = 0;
    for _ in 0..scenes {
        let mut scene = draw(&mut rng);
        let before = statistics(&scene);
        for _ in 0..steps {
            let branch = &branches[rng.below(branches.len() as u32) as usize];
            let mut proposed = scene.clone();
            let Some(ratio) = proposal::propose(branch, &mut proposed, &mut rng, &mut Nothing)
            else {
                continue;
            };
            let gain = ln_target(&proposed) - ln_target(&scene) + ratio;
            // Focal lengths and distances off the support have a NaN density: rejected.
            if rng.uniform().ln() < gain {
                scene = proposed;
                accepted += 1;
            }
        }
        for (k, (after, before)) in statistics(&scene).iter().zip(&before).enumerate() {
            sum[k] += after - before;
            sum2[k] += (after - before).powi(2);
        }
    }
    let n = scenes as f64;
    let worst =
        sum.iter().zip(&sum2).filter(|(_, s2)| **s2 > 0.0).fold(0.0_f64, |worst, (s, s2)| {
            let variance = (s2 / n - (s / n).powi(2)).max(1e-12);
            worst.max((s / n).abs() / (variance / n).sqrt())
        });
    (worst, f64::from(accepted) / (scenes * steps) as f64)
}

fn assert_invariant(name: &'static str, kind: Move, centre: Option<usize>) {
    let branch = Branch { name, kind, centre, probability: 1.0 };
    let (worst, accepted) = drift(&[branch], 20_000, 4);
    // 18 statistics, 13 moves: 4.5 standard errors happen by chance in 1 of 600 test suites, and
    // the seed is fixed.
    assert!(worst < 4.5, "{name}: drifts by {worst:.1} standard errors");
    assert!(accepted > 0.03, "{name}: only {accepted:.3} accepted, the test sees nothing");
}

#[test]
fn pose_moves_leave_their_target_invariant() {
    for axis in [Axis::Roll, Axis::Yaw, Axis::Pitch] {
        assert_invariant("rotation", Move::Rotation { axis, sd: 0.3 }, None);
    }
    assert_invariant("rotation, centred", Move::Rotation { axis: Axis::Yaw, sd: 0.3 }, Some(1));
    assert_invariant("distance", Move::Distance { sd: 500.0 }, None);
    assert_invariant("distance, centred", Move::Distance { sd: 500.0 }, Some(2));
    assert_invariant("scaling", Move::Scaling { sd: 0.4 }, None);
    assert_invariant("scaling, centred", Move::Scaling { sd: 0.4 }, Some(0));
    assert_invariant("translation", Move::Translation { sd: 80.0 }, None);
}

#[test]
fn color_and_coefficient_moves_leave_their_target_invariant() {
    let color = Move::Color { gain_sd: 0.05, contrast_sd: 0.05, offset_sd: 0.05 };
    assert_invariant("colour", color, None);
    for half in [Half::Shape, Half::Albedo] {
        assert_invariant("gaussian", Move::Gaussian { half, sd: 0.4 }, None);
        assert_invariant("single", Move::Single { half, sd: 1.0 }, None);
        assert_invariant("caricature", Move::Caricature { half, sd: 0.4 }, None);
    }
}

#[test]
fn light_moves_leave_their_target_invariant() {
    assert_invariant("spatial", Move::LightSpatial { sd: 0.1 }, None);
    assert_invariant("bands", Move::LightBands { sd: 0.2 }, None);
    assert_invariant("intensity", Move::LightIntensity { sd: 0.4 }, None);
    assert_invariant("perturbation", Move::LightPerturbation { sd: 0.1 }, None);
    assert_invariant("colour of light", Move::LightColor { sd: 0.2 }, None);
}

#[test]
fn the_whole_face_mixture_without_search_is_a_sampler() {
    let table = Table::new(&FACE, |branch| !branch.kind.steers()).unwrap();
    let (worst, _) = drift(&table.branches().collect::<Vec<_>>(), 3_000, 60);
    assert!(worst < 4.5, "drifts by {worst:.1} standard errors");
}

#[test]
fn probabilities_follow_the_tree() {
    let table = Table::new(&FACE, |_| true).unwrap();
    let share = |f: &dyn Fn(&Branch) -> bool| -> f32 {
        table.branches().filter(|b| f(b)).map(|b| b.probability).sum()
    };
    assert!((share(&|_| true) - 1.0).abs() < 1e-5);
    assert!((share(&|b| b.name == "colour") - 1.0 / 7.0).abs() < 1e-6);
    assert!((share(&|b| b.kind.half().is_some()) - 3.0 / 7.0).abs() < 1e-6);
    let solve = share(&|b| matches!(b.kind, Move::SolveLight { .. }));
    assert!((solve - 2.0 / 42.0).abs() < 1e-6);
    assert!((share(&|b| b.centre == Some(2)) - 5.0 / 21.0 / 7.0).abs() < 1e-6);
    // What does not apply leaves its weight to its siblings.
    let table = Table::new(&POSE, |b| b.centre.is_none_or(|c| c == 0)).unwrap();
    let centred: f32 = table.branches().filter(|b| b.centre.is_some()).map(|b| b.probability).sum();
    assert!((centred - 1.0 / 1.2).abs() < 1e-6);
}
