//! Whole chains on a small model.

mod common;

use onescan_core::chain::{Chain, Checkpoint, Config, PhaseName, Problem};
use onescan_core::draw::{draw, draw_words};
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use onescan_core::model::Model;
use onescan_core::rng::Rng;
use onescan_core::scene::Scene;

const SIDE: u32 = 48;
const PIXELS: usize = (SIDE * SIDE) as usize;

/// A mask turned and shaped at random, lit from the front, on grey.
fn photo(model: &Model<'_>) -> (Vec<[u8; 3]>, Scene) {
    let mut rng = Rng::new(1, 0);
    let mut scene = Scene::initial(SIDE, SIDE, model.shape.rank(), model.albedo.rank());
    scene.view.pose.yaw = 0.3;
    scene
        .subject
        .shape
        .iter_mut()
        .chain(&mut scene.subject.albedo)
        .for_each(|c| *c = rng.normal_sd(1.0));
    let mut memory = vec![0; draw_words(model.vertices(), SIDE as usize, SIDE as usize)];
    let mut pixels = vec![[0.4; 3]; PIXELS];
    assert!(draw(model, &scene, &mut memory, &mut pixels).is_some_and(|covered| covered > 300));
    let byte = |x: f32| (x.clamp(0.0, 1.0) * 255.0) as u8;
    (pixels.iter().map(|pixel| pixel.map(byte)).collect(), scene)
}

/// Where the truth's landmarks are.
fn landmarks<'m>(model: &Model<'m>, truth: &Scene) -> Vec<ObservedLandmark<'m>> {
    let mut positions = vec![[0.0; 4]; onescan_core::basis::padded(model.vertices())];
    model.shape.instance(&truth.subject.shape, &mut positions);
    let position = |vertex: u32| {
        let [x, y, z, _] = positions[vertex as usize];
        let (u, v, _) = truth.view.camera.project(truth.view.pose.to_world([x, y, z]));
        [u, v]
    };
    model.landmarks().map(|(name, v)| ObservedLandmark { name, position: position(v) }).collect()
}

#[test]
fn little_memory_changes_no_bit() {
    let bytes = common::mask(24, 30, 6, 5);
    let model = bytes.model();
    let (pixels, truth) = photo(&model);
    let landmarks = landmarks(&model, &truth);
    let config = Config::default().with(|config| {
        config.shape_rank = 6;
        config.albedo_rank = 5;
        config.landmark_steps = 300;
        config.image_steps = 1500;
    });
    let image = Image { pixels: &pixels, width: SIDE, height: SIDE };
    let problem = Problem::new(&model, image, &landmarks, &config);
    let fit = |problem: Problem<'_>| {
        // Whatever was in the memory before.
        let mut memory = vec![0x7fc0_dead; problem.dimensions().words()];
        let mut chain = Chain::new(problem, 3, 0, &mut memory).expect("the problem fits together");
        // A look at the quality in the middle disturbs nothing.
        for _ in 0..900 {
            assert!(chain.step().is_some());
        }
        let best = chain.best().scene.clone();
        let quality = chain.quality(&best);
        while chain.step().is_some() {}
        let result = (chain.fingerprint(), quality, chain.best().clone());
        (memory.len(), result)
    };
    let (words, result) = fit(problem);
    let (lean_words, lean_result) = fit(problem.with_lean(true));
    assert!(2 * lean_words < words, "{lean_words} words are not less than half of {words}");
    assert_eq!(lean_result, result);
    assert!(result.1.pixel_rmse < 0.1, "{}", result.1.pixel_rmse);
}

#[test]
fn a_checkpoint_that_does_not_fit_is_refused() {
    let bytes = common::mask(24, 30, 6, 5);
    let model = bytes.model();
    let (pixels, truth) = photo(&model);
    let landmarks = landmarks(&model, &truth);
    let config = |shape_rank, albedo_rank| {
        Config::default().with(|config| {
            (config.shape_rank, config.albedo_rank) = (shape_rank, albedo_rank);
            (config.landmark_steps, config.image_steps) = (50, 50);
        })
    };
    let image = Image { pixels: &pixels, width: SIDE, height: SIDE };
    let good = config(4, 3);
    let problem = Problem::new(&model, image, &landmarks, &good);
    let mut memory = vec![0; problem.dimensions().words()];
    let mut chain = Chain::new(problem, 5, 0, &mut memory).expect("the problem fits together");
    for _ in 0..80 {
        chain.step();
    }
    let saved = chain.checkpoint().clone();
    let refused = |problem: Problem<'_>, change: &dyn Fn(&mut Checkpoint)| {
        let mut saved = saved.clone();
        change(&mut saved);
        let mut memory = vec![0; problem.dimensions().words()];
        Chain::resume(problem, saved, &mut memory).is_err()
    };
    assert!(!refused(problem, &|_| ()));
    for narrow in [config(3, 3), config(4, 2)] {
        assert!(refused(Problem::new(&model, image, &landmarks, &narrow), &|_| ()));
    }
    assert!(refused(problem, &|saved| saved.best.density.prior += 1.0));
    assert!(refused(problem, &|saved| saved.best.scene.view.pose.yaw += 0.1));
    assert!(refused(problem, &|saved| {
        saved.initial.as_mut().unwrap().scene.view.camera.image_size = [9; 2];
    }));
    assert!(refused(problem, &|saved| {
        saved.initial.as_mut().unwrap().scene.subject.albedo.pop();
    }));
}

/// The phase between the pose's and the picture's, of objects.
#[test]
fn the_shape_follows_the_landmarks_before_the_picture() {
    let bytes = common::mask(24, 30, 6, 5);
    let model = bytes.model();
    let (pixels, truth) = photo(&model);
    let landmarks = landmarks(&model, &truth);
    let fit = |shape_steps: u32| {
        let config = Config::default().with(|config| {
            config.shape_rank = 6;
            config.albedo_rank = 5;
            config.landmark_steps = 600;
            config.shape_steps = shape_steps;
            config.image_steps = 10;
            config.landmark_sd = 1.0;
        });
        let image = Image { pixels: &pixels, width: SIDE, height: SIDE };
        let problem = Problem::new(&model, image, &landmarks, &config);
        let mut memory = vec![0; problem.dimensions().words()];
        let mut chain = Chain::new(problem, 5, 0, &mut memory).expect("the problem fits together");
        let mut phases = Vec::new();
        while let Some(step) = chain.step() {
            phases.push(step.phase);
        }
        let (done, all) = chain.progress();
        assert_eq!((done, u64::from(all)), (phases.len() as u32, config.steps()));
        let proposed = |phase| chain.tallies(phase).map(|(_, tally)| tally.proposed).sum::<u32>();
        assert_eq!(PhaseName::ALL.map(proposed), [600, shape_steps, 10]);
        assert!(phases.is_sorted_by_key(|phase| PhaseName::ALL.iter().position(|p| p == phase)));
        let initial = chain.checkpoint().initial.clone().expect("the picture was looked at");
        let moved = initial.scene.subject.shape.iter().any(|c| *c != 0.0);
        (moved, chain.quality(&initial.scene).landmark_rmse)
    };
    let ((posed, before), (shaped, after)) = (fit(0), fit(1500));
    assert!(!posed && shaped);
    assert!(after < before, "{after} pixels, {before} by the pose alone");
}
