//! What continues a posterior's sampling is read or refused; one that is read is resumed or refused.
#![no_main]
use libfuzzer_sys::fuzz_target;
use onescan::fit::{Control, Schedule};
use onescan::posterior::{Request, Save, sample_kept};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock};
use std::thread;

const REQUEST: Request = Request { draws: 200, chains: 1, seed: 7 };

/// Samples a few states; what is kept then.
fn sample(resume: Option<Save>) -> Option<Vec<u8>> {
    let (stop, steps) = (AtomicBool::new(false), AtomicU64::new(0));
    let kept = Mutex::new(None);
    let keep = |save: &Save| {
        *kept.lock().expect("one thread") = Some(save.to_bytes()?);
        Ok(())
    };
    thread::scope(|scope| {
        let sampling = scope.spawn(|| {
            let control = Control { stop: &stop, steps: &steps };
            let jobs = [onescan_fuzz::job(Schedule::Mode)];
            let _ = sample_kept(&jobs, &REQUEST, resume, &control, &keep);
        });
        let first = REQUEST.steps() - u64::from(REQUEST.draws);
        while !sampling.is_finished() && steps.load(Ordering::Relaxed) < first + 3 {
            thread::yield_now();
        }
        stop.store(true, Ordering::Relaxed);
    });
    kept.into_inner().expect("one thread")
}

fuzz_target!(|data: &[u8]| {
    static GOOD: OnceLock<Vec<u8>> = OnceLock::new();
    let good = GOOD.get_or_init(|| sample(None).expect("it was told to stop"));
    let Some(bytes) = onescan_fuzz::continued(good, data) else { return };
    let Ok(save) = Save::parse(&bytes) else { return };
    save.to_bytes().expect("what was read can be written");
    sample(Some(save));
});
