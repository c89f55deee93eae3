//! Fits of photos and of directories of them, made or read.

use crate::error::Result;
use crate::fit::landmarks::{check_sides, crop_around};
use crate::fit::{Control, Fit, Job, Schedule, find_mode};
use crate::photo::Crop;
use crate::photo::picture::Picture;
use crate::photo::tlms::Tlms;
use onescan_core::model::Model;
use std::sync::atomic::{AtomicBool, AtomicU64};

/// The fit of a photo as `onescan fit` makes it if nothing else is said.
///
/// # Errors
/// Landmarks that cannot be the model's; those of [`find_mode`].
pub fn job<'a>(model: &'a Model<'a>, photo: &'a Picture, landmarks: &'a Tlms) -> Result<Job<'a>> {
    let (schedule, side) = (Schedule::Mode, Crop::LONGER_SIDE);
    let config = schedule.config(model, side);
    let size = [photo.width, photo.height];
    check_sides(model, landmarks, size, side, config.landmark_sd)?;
    Ok(Job {
        model,
        photo,
        landmarks,
        crop: crop_around(model, landmarks, size, side, config.landmark_sd)?,
        mask: None,
        schedule,
        config,
        seed: 7,
        chains: 1,
    })
}

/// Runs a search for the mode; `None` if it was stopped.
///
/// # Errors
/// Those of [`find_mode`].
pub fn run(job: &Job<'_>, stop: &AtomicBool) -> Result<Option<Fit>> {
    let control = Control { stop, steps: &AtomicU64::new(0) };
    let found = find_mode(std::slice::from_ref(job), &control)?;
    Ok(found.and_then(|fits| fits.into_iter().next()))
}
