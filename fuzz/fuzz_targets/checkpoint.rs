//! A checkpoint is read or refused; one that is read is resumed or refused.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::fit::checkpoint::Save;
use onescan::fit::{Control, Ending, Job, Schedule};
use onescan::photo::Crop;
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan_core::chain::{self, Chain, Config, Problem};
use onescan_core::hash::fnv64;
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64};

const SIDE: u32 = 24;
/// Magic and checksum.
const HEADER: usize = 16;

fn config() -> Config {
    Config::default().with(|config| {
        config.landmark_steps = 20;
        config.image_steps = 20;
        config.shape_rank = 3;
        config.albedo_rank = 3;
    })
}

/// The checkpoint of a fit that was stopped at once.
fn good() -> &'static [u8] {
    static GOOD: OnceLock<Vec<u8>> = OnceLock::new();
    GOOD.get_or_init(|| {
        let model = onescan_fuzz::model().view();
        let photo = Picture::filled(SIDE, SIDE, [90, 80, 70]);
        let landmarks = Tlms::parse("a 1 5 18\nb 1 18 18\nc 1 18 5\nd 1 5 5\n").expect("good");
        let crop = Crop::whole([SIDE; 2]);
        let config = config();
        let job = Job {
            model: &model,
            photo: &photo,
            landmarks: &landmarks,
            crop,
            mask: None,
            schedule: Schedule::Paper,
            config,
            seed: 7,
            chains: 1,
        };
        let control = Control { stop: &AtomicBool::new(true), steps: &AtomicU64::new(0) };
        match job.run(None, &control) {
            Ok(Ending::Stopped(Some(save))) => save.to_bytes().expect("it can be saved"),
            _ => panic!("it was told to stop"),
        }
    })
}

fuzz_target!(|data: &[u8]| {
    let Some((&kind, rest)) = data.split_first() else { return };
    // Raw bytes, or a good checkpoint with damage; the checksum is made right.
    let mut bytes = match kind % 2 {
        0 => rest.to_vec(),
        _ => onescan_fuzz::damaged(good(), rest),
    };
    if bytes.len() >= HEADER {
        bytes[..8].copy_from_slice(&good()[..8]);
        let checksum = fnv64(&bytes[HEADER..]);
        bytes[8..HEADER].copy_from_slice(&checksum.to_le_bytes());
    }
    let Ok(save) = Save::parse(&bytes) else { return };
    save.to_bytes().expect("what was read can be written");

    let model = onescan_fuzz::model().view();
    let config = config();
    let pixels = [[90, 80, 70]; (SIDE * SIDE) as usize];
    let landmarks = [("a", [5.0, 18.0]), ("b", [18.0, 18.0]), ("c", [18.0, 5.0]), ("d", [5.0; 2])]
        .map(|(name, position)| ObservedLandmark { name, position });
    let image = Image { pixels: &pixels, width: SIDE, height: SIDE };
    let problem = Problem::new(&model, image, &landmarks, &config)
        .with_schedule(chain::Schedule::of(&landmarks))
        .with_lean(true);
    let mut memory = vec![0; problem.dimensions().words()];
    for chain in save.chains.into_iter().flatten() {
        if let Ok(mut chain) = Chain::resume(problem, chain.checkpoint, &mut memory) {
            for _ in 0..5 {
                chain.step();
            }
        }
    }
});
