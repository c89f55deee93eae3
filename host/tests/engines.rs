//! Stages compiled for wider vectors compute the same bits.

use onescan::bench::Workload;
use onescan::simd;
use onescan_core::chain::{Chain, Config};

#[test]
fn chains_are_the_same_on_every_engine() {
    let workload = Workload::new(&mut |_| ()).unwrap();
    let (model, landmarks) = (workload.model.view(), workload.observed());
    let config = Config::default().with(|config| {
        config.landmark_steps = 300;
        config.image_steps = 400;
    });
    let mut results = Vec::new();
    for engine in simd::all() {
        let problem = workload.problem(&model, &landmarks, &config).with_engine(engine);
        let mut memory = vec![0; problem.dimensions().words()];
        let mut chain = Chain::new(problem, 5, 0, &mut memory).unwrap();
        while chain.step().is_some() {}
        results.push((engine.name, chain.fingerprint(), chain.best().clone()));
    }
    for (name, fingerprint, best) in &results {
        assert_eq!(*fingerprint, results[0].1, "{name}");
        assert!(*best == results[0].2, "{name}");
    }
}
