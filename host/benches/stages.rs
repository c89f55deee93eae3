//! Each stage of the pipeline and the whole step, beside their naive twins.

use criterion::{Criterion, criterion_group, criterion_main};
use onescan::bench::{Stage, Stages, Workload, step_to_image};
use onescan_core::chain::{self, Chain, Config};

fn stages(criterion: &mut Criterion) {
    let workload = Workload::new(&mut |_| ()).expect("built in");
    let mut memory = vec![0; Stages::words(workload.scene.camera.image_size)];
    let mut stages = Stages::new(&workload, &mut memory).expect("sized for the picture");
    for stage in Stage::ALL {
        let mut group = criterion.benchmark_group(stage.name());
        group.bench_function("fast", |b| b.iter(|| stages.run(stage)));
        if stages.run_naive(stage).is_some() {
            group.bench_function("naive", |b| b.iter(|| stages.run_naive(stage)));
        }
    }

    let config = Config::default().with(|config| {
        config.samples = u32::MAX;
    });
    let (model, landmarks) = (workload.model.view(), workload.observations());
    let problem = workload.problem(&model, &landmarks, &config);
    let mut memory = vec![0; problem.dimensions().words()];
    let mut chain = Chain::new(problem, 7, 0, &mut memory).expect("landmarks of the model");
    while chain.stage() == chain::Stage::Landmarks && chain.step().is_some() {}
    let mut group = criterion.benchmark_group("step");
    group.bench_function("fast", |b| b.iter(|| step_to_image(&mut chain)));
    group.bench_function("naive", |b| {
        b.iter(|| [Stage::Render, Stage::Likelihood].map(|part| stages.run_naive(part)));
    });
}

criterion_group!(benches, stages);
criterion_main!(benches);
