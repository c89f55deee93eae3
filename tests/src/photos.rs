//! Photos with landmarks beside them, and fits to them.

use onescan::fit::{Control, Fit, Job, Schedule, find_mode};
use onescan::photo::picture::Picture;
use onescan::photo::tlms::Tlms;
use onescan::photo::{self, Crop};
use onescan_core::model::Model;
use std::path::Path;

/// A photo, and the landmarks of the `.tlms` file beside it.
///
/// # Panics
/// If one of them cannot be read.
pub fn read(path: &Path) -> (Picture, Tlms) {
    let photo = photo::read(path).expect("a photo");
    let size = [photo.width, photo.height];
    let landmarks = Tlms::read(&path.with_extension("tlms"), size).expect("its landmarks");
    (photo, landmarks)
}

/// Fits to photos of one person as `onescan fit` makes them, looking around all landmarks.
///
/// # Panics
/// If the landmarks cannot be the model's.
pub fn fit(model: &Model<'_>, photos: &[(Picture, Tlms)]) -> Vec<Fit> {
    let schedule = Schedule::Mode;
    let jobs = photos.iter().map(|(photo, landmarks)| Job {
        model,
        photo,
        landmarks,
        crop: Crop::around(
            &landmarks.visible_points(),
            [photo.width, photo.height],
            Crop::ENLARGE,
            Crop::LONGER_SIDE,
        )
        .expect("landmarks in the photo"),
        mask: None,
        schedule,
        config: schedule.config(model, Crop::LONGER_SIDE),
        seed: 0,
        chains: 1,
    });
    let jobs: Vec<_> = jobs.collect();
    find_mode(&jobs, &Control::default()).expect("a fit").expect("nobody stopped it")
}
