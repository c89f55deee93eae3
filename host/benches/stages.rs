//! Each stage of the pipeline, the whole step and the search's equations, beside their naive twins;
//! and a whole search.

use criterion::{Criterion, criterion_group, criterion_main};
use onescan::bench::{Stage, Stages, Workload, mode_config, step_to_image};
use onescan::simd;
use onescan_core::chain::{Chain, Config, PhaseName};
use onescan_core::lanes::LANES;
use onescan_core::naive;
use onescan_core::rng::Rng;
use onescan_core::search::{self, ModeSearch, Options};

fn stages(criterion: &mut Criterion) {
    let workload = Workload::new(&mut |_| ()).expect("built in");
    let mut memory = vec![0; Stages::words(workload.scene.view.camera.image_size)];
    let mut stages = Stages::new(&workload, &mut memory).expect("sized for the picture");
    for stage in Stage::ALL {
        let mut group = criterion.benchmark_group(stage.name());
        group.bench_function("fast", |b| b.iter(|| stages.run(stage)));
        if stages.run_naive(stage).is_some() {
            group.bench_function("naive", |b| b.iter(|| stages.run_naive(stage)));
        }
    }

    let config = Config::default().with(|config| {
        config.image_steps = u32::MAX;
    });
    let (model, landmarks) = (workload.model.view(), workload.observed());
    let problem = workload.problem(&model, &landmarks, &config);
    let mut memory = vec![0; problem.dimensions().words()];
    let mut chain = Chain::new(problem, 7, 0, &mut memory).expect("landmarks of the model");
    while chain.phase() == PhaseName::Landmarks && chain.step().is_some() {}
    let mut group = criterion.benchmark_group("step");
    group.bench_function("fast", |b| b.iter(|| step_to_image(&mut chain)));
    group.bench_function("naive", |b| {
        b.iter(|| [Stage::Render, Stage::Likelihood].map(|part| stages.run_naive(part)));
    });
}

/// Unknowns of a search with 199 components of shape and albedo each.
const UNKNOWNS: usize = 439;
/// Equations that such a search adds together.
const EQUATIONS: usize = 48;

fn equations(criterion: &mut Criterion) {
    let groups = UNKNOWNS.div_ceil(LANES);
    let mut rng = Rng::new(7, 0);
    let rows: Vec<f32> = (0..EQUATIONS * UNKNOWNS).map(|_| rng.normal_sd(1.0)).collect();
    let weights = vec![(1.0, 0.5); EQUATIONS];
    let mut batch = vec![[0.0; LANES]; groups * EQUATIONS];
    for (k, row) in rows.chunks(UNKNOWNS).enumerate() {
        for (group, numbers) in row.chunks(LANES).enumerate() {
            batch[group * EQUATIONS + k][..numbers.len()].copy_from_slice(numbers);
        }
    }
    let engine = simd::best().normal_equations;
    let mut matrix = vec![[0.0; LANES]; groups * UNKNOWNS];
    let mut vector = vec![0.0; UNKNOWNS];
    let mut plain = vec![0.0; UNKNOWNS * UNKNOWNS];
    let mut group = criterion.benchmark_group("normal equations");
    group.bench_function("fast", |b| {
        b.iter(|| (engine.add)(&batch, &weights, &mut matrix, &mut vector));
    });
    group.bench_function("naive", |b| {
        b.iter(|| naive::normal_equations(&rows, &weights, &mut plain, &mut vector));
    });
    group.finish();

    // Diagonally dominant.
    let mut random = |i: usize, j: usize| if i == j { 1e4 } else { rng.normal_sd(1.0) };
    for i in 0..UNKNOWNS {
        for j in 0..UNKNOWNS {
            let entry = random(i, j);
            plain[i * UNKNOWNS + j] = entry;
            matrix[i * groups + j / LANES][j % LANES] = entry;
        }
    }
    let mut group = criterion.benchmark_group("solve");
    group.bench_function("fast", |b| {
        let mut copy = matrix.clone();
        b.iter(|| {
            copy.copy_from_slice(&matrix);
            (engine.solve)(&mut copy, &mut vec![1.0; UNKNOWNS], &mut batch)
        });
    });
    group.bench_function("naive", |b| {
        let mut copy = plain.clone();
        b.iter(|| {
            copy.copy_from_slice(&plain);
            naive::cholesky(&mut copy, &mut vec![1.0; UNKNOWNS])
        });
    });
}

fn mode(criterion: &mut Criterion) {
    let workload = Workload::new(&mut |_| ()).expect("built in");
    let config = mode_config(Config::default().shape_rank);
    let (model, landmarks) = (workload.model.view(), workload.observed());
    let problem = workload.problem(&model, &landmarks, &config);
    let mut memory = vec![0; search::words(&problem, &Options::default())];
    let mut group = criterion.benchmark_group("search");
    group.sample_size(10);
    group.bench_function("fast", |b| {
        b.iter(|| {
            let mut search = ModeSearch::new(problem, Options::default(), &mut memory)
                .expect("landmarks of the model");
            while search.step().is_some() {}
            search.fingerprint()
        });
    });
}

criterion_group!(benches, stages, equations, mode);
criterion_main!(benches);
