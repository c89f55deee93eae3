//! A checkpoint is read or refused; one that is read is resumed or refused.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::fit::checkpoint::Save;
use onescan::fit::{Control, Ending, Schedule};
use onescan_core::chain::{self, Chain, Problem};
use onescan_core::image::Image;
use onescan_core::likelihood::landmarks::ObservedLandmark;
use onescan_fuzz::SIDE;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// The checkpoint of a fit that was stopped at once.
fn good() -> &'static [u8] {
    static GOOD: OnceLock<Vec<u8>> = OnceLock::new();
    GOOD.get_or_init(|| {
        let control = Control { stop: &AtomicBool::new(true), steps: &AtomicU64::new(0) };
        match onescan_fuzz::job(Schedule::Paper).run(None, &control) {
            Ok(Ending::Stopped(Some(save))) => save.to_bytes().expect("it can be saved"),
            _ => panic!("it was told to stop"),
        }
    })
}

fuzz_target!(|data: &[u8]| {
    let Some(bytes) = onescan_fuzz::continued(good(), data) else { return };
    let Ok(save) = Save::parse(&bytes) else { return };
    save.to_bytes().expect("what was read can be written");

    let model = onescan_fuzz::model().view();
    let config = onescan_fuzz::job(Schedule::Paper).config;
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
