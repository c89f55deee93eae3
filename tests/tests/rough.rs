//! Fits to pictures of known truth that no renderer of ours made, with hair, gloss and cast shadow:
//! the fit is nearer to the person than the template is.
//!
//! Three of the sixty people at four yaws are in `fixtures/rough`. `cargo xtask rough DIR` has this
//! test fit all pictures of a directory, and print how well people are recognised:
//! `ONESCAN_ROUGH=DIR`.

use onescan::demo::{template, template_model};
use onescan::experiment::faces::{Identity, identities};
use onescan::fit::{Control, Job, Schedule, find_mode};
use onescan::photo::tlms::Tlms;
use onescan::photo::{self, Crop};
use onescan::render;
use onescan_core::model::Model;
use onescan_tests::truth::{distances_after_alignment, rms};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};

const YAWS: [u32; 4] = [0, 15, 30, 45];
/// Several photos of one person: by their number, the yaws.
const SEVERAL: [&[u32]; 3] = [&[0, 30], &[0, 15, 30], &[0, 15, 30, 45]];

/// How far a face is from the truth: distance up to size, mm; albedo's difference; the same
/// after one gain per channel.
#[derive(Clone, Copy)]
struct Errors([f64; 3]);

impl Errors {
    fn of(points: &[[f32; 3]], colors: &[[f32; 3]], truth: &Identity) -> Self {
        let [_, form] = distances_after_alignment(points, &truth.points);
        let difference = |colors: &[[f32; 3]]| {
            rms(colors.as_flattened().iter().zip(truth.colors.as_flattened()), 1)
        };
        let seen: Vec<[f32; 3]> = colors.iter().map(|c| c.map(|c| c.clamp(0.0, 1.0))).collect();
        let gains: [f32; 3] = std::array::from_fn(|c| {
            let sum =
                |f: &dyn Fn(usize) -> f32| (0..seen.len()).map(|v| f64::from(f(v))).sum::<f64>();
            (sum(&|v| seen[v][c] * truth.colors[v][c]) / sum(&|v| seen[v][c].powi(2))) as f32
        });
        let gained: Vec<[f32; 3]> =
            seen.iter().map(|color| std::array::from_fn(|c| gains[c] * color[c])).collect();
        Self([form, difference(&seen), difference(&gained)])
    }
}

/// Components of each half of the model, all of which a fit infers.
const RANK: usize = 199;

/// Fitted pictures of a person.
struct Fitted {
    person: usize,
    yaws: Vec<u32>,
    shape: Vec<f32>,
    albedo: Vec<f32>,
    errors: Errors,
    template: Errors,
}

#[test]
fn a_fit_to_a_rough_picture_is_nearer_than_the_template() {
    let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("../fixtures");
    let all = std::env::var_os("ONESCAN_ROUGH").map(PathBuf::from);
    let pictures = pictures(all.as_deref().unwrap_or(&fixtures.join("rough")));
    let sets = sets(&pictures);
    let fitted = fit(&sets, &identities(&fixtures).unwrap());
    if all.is_some() {
        for gallery in [&[0][..], SEVERAL[0]] {
            recognition(&fitted, gallery);
        }
    }
    let mut nearer = (0, 0);
    let mut shapes = Vec::new();
    for yaws in YAWS.iter().map(std::slice::from_ref).chain(SEVERAL) {
        let of: Vec<_> = fitted.iter().filter(|fitted| fitted.yaws == *yaws).collect();
        if of.is_empty() {
            continue;
        }
        let mean = |f: &dyn Fn(&Fitted) -> Errors| -> [f64; 3] {
            std::array::from_fn(|i| of.iter().map(|x| f(x).0[i]).sum::<f64>() / of.len() as f64)
        };
        let (fit, template) = (mean(&|x| x.errors), mean(&|x| x.template));
        println!(
            "yaw {yaws:?} n {} shape {:.2} mm (template {:.2})  albedo {:.4} (template {:.4})  \
             with gains {:.4} (template {:.4})",
            of.len(),
            fit[0],
            template[0],
            fit[1],
            template[1],
            fit[2],
            template[2]
        );
        assert!(fit[0] < template[0], "{yaws:?}°: shape {} is not below {}", fit[0], template[0]);
        assert!(fit[1] < template[1], "{yaws:?}°: albedo {} is not below {}", fit[1], template[1]);
        if yaws.len() == 1 {
            nearer.0 += of.iter().filter(|x| x.errors.0[0] < x.template.0[0]).count();
            nearer.1 += of.len();
        }
        if yaws == [0] || yaws.len() > 1 {
            shapes.push(fit[0]);
        }
    }
    assert!(4 * nearer.0 >= 3 * nearer.1, "shape is nearer in {nearer:?}");
    assert!(shapes.iter().skip(1).all(|more| *more < shapes[0]), "by photos: {shapes:?}");
}

/// Person, yaws and paths of what is fitted together: every picture by itself, then several.
fn sets(pictures: &[(usize, u32, PathBuf)]) -> Vec<(usize, Vec<u32>, Vec<&Path>)> {
    let alone = pictures.iter().map(|(person, yaw, path)| (*person, vec![*yaw], vec![&**path]));
    let mut sets: Vec<_> = alone.collect();
    for yaws in SEVERAL {
        for person in pictures.iter().filter(|(_, yaw, _)| *yaw == 0).map(|(person, ..)| *person) {
            let path = |yaw: &u32| {
                let found = pictures.iter().find(|(p, y, _)| (p, y) == (&person, yaw));
                found.map(|(.., path)| &**path)
            };
            if let Some(paths) = yaws.iter().map(path).collect() {
                sets.push((person, yaws.to_vec(), paths));
            }
        }
    }
    sets
}

/// Person, yaw and path of every picture `PERSON_YAW.jpg`.
fn pictures(directory: &Path) -> Vec<(usize, u32, PathBuf)> {
    let entries = std::fs::read_dir(directory).unwrap_or_else(|e| {
        panic!("{}: {e}; expected pictures PERSON_YAW.jpg", directory.display())
    });
    let mut pictures: Vec<_> = entries
        .filter_map(|entry| {
            let path = entry.unwrap().path();
            let (person, yaw) = path.file_stem()?.to_str()?.split_once('_')?;
            let numbers = (person.parse().ok()?, yaw.parse().ok()?);
            (path.extension()? == "jpg").then_some((numbers.0, numbers.1, path.clone()))
        })
        .collect();
    pictures.sort();
    assert!(!pictures.is_empty(), "{}: no pictures PERSON_YAW.jpg", directory.display());
    pictures
}

fn fit(sets: &[(usize, Vec<u32>, Vec<&Path>)], people: &[Identity]) -> Vec<Fitted> {
    let built = template_model(RANK, &mut |_, _| ()).unwrap();
    let model = built.model.view();
    let (template, _) = template().unwrap();
    let next = AtomicUsize::new(0);
    let all = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, Into::into) {
            scope.spawn(|| {
                while let Some((person, yaws, paths)) =
                    sets.get(next.fetch_add(1, Ordering::Relaxed))
                {
                    let (shape, albedo) = parameters(&model, paths);
                    let found = render::instance(&model, &shape, &albedo);
                    let truth = people.get(*person).unwrap_or_else(|| {
                        panic!("{paths:?}: no such person, of {}", people.len())
                    });
                    let fitted = Fitted {
                        person: *person,
                        yaws: yaws.clone(),
                        errors: Errors::of(&found.points, &found.colors, truth),
                        template: Errors::of(&template.points, &template.colors, truth),
                        shape,
                        albedo,
                    };
                    let mut all = all.lock().unwrap();
                    all.push(fitted);
                    if all.len().is_multiple_of(20) {
                        println!("{} of {} fitted", all.len(), sets.len());
                    }
                }
            });
        }
    });
    all.into_inner().unwrap()
}

/// Shape and albedo as `onescan fit` finds them.
fn parameters(model: &Model<'_>, paths: &[&Path]) -> (Vec<f32>, Vec<f32>) {
    let photos: Vec<_> = paths
        .iter()
        .map(|path| {
            let picture = photo::read(path).unwrap();
            (picture, Tlms::read(&path.with_extension("tlms")).unwrap())
        })
        .collect();
    let schedule = Schedule::Mode;
    let jobs: Vec<_> = photos
        .iter()
        .map(|(picture, landmarks)| Job {
            model,
            photo: picture,
            landmarks,
            crop: Crop::around(
                &landmarks.visible_points(),
                [picture.width, picture.height],
                Crop::ENLARGE,
                256,
            )
            .unwrap(),
            mask: None,
            schedule,
            config: schedule.config(model, Crop::LONGER_SIDE),
            seed: 0,
            chains: 1,
        })
        .collect();
    let (stop, steps) = (AtomicBool::new(false), AtomicU64::new(0));
    let control = Control { stop: &stop, steps: &steps };
    let fits = find_mode(&jobs, &control).unwrap().expect("nobody stopped the fit");
    let subject = &fits[0].best.scene.subject;
    (subject.shape.to_vec(), subject.albedo.to_vec())
}

/// Prints how often the nearest of all faces of a gallery, fitted to the photos at these yaws, is the
/// same person's, by the cosine of coefficients, and how far apart cosines of the same and of other people are, in their pooled
/// standard deviation.
fn recognition(fitted: &[Fitted], gallery: &[u32]) {
    type Vector = fn(&Fitted) -> Vec<f32>;
    let kinds: [(&str, Vector); 3] = [
        ("joint", |f| [&f.shape[..], &f.albedo].concat()),
        ("shape", |f| f.shape.clone()),
        ("albedo", |f| f.albedo.clone()),
    ];
    let cosine = |a: &[f32], b: &[f32]| {
        let dot =
            |a: &[f32], b: &[f32]| -> f64 { a.iter().zip(b).map(|(a, b)| f64::from(a * b)).sum() };
        dot(a, b) / (dot(a, a) * dot(b, b)).sqrt()
    };
    let at = |yaws: &[u32]| fitted.iter().filter(|f| f.yaws == yaws).collect::<Vec<_>>();
    for yaw in YAWS.iter().filter(|yaw| !gallery.contains(yaw)) {
        for (name, vector) in kinds {
            let (mut hits, mut same, mut other) = (0, Vec::new(), Vec::new());
            for probe in at(&[*yaw]) {
                let wanted = vector(probe);
                let cosines: Vec<_> =
                    at(gallery).iter().map(|f| (cosine(&wanted, &vector(f)), f.person)).collect();
                let nearest = cosines.iter().max_by(|a, b| a.0.total_cmp(&b.0));
                hits += usize::from(nearest.is_some_and(|(_, person)| *person == probe.person));
                for (cosine, person) in cosines {
                    if person == probe.person { same.push(cosine) } else { other.push(cosine) }
                }
            }
            let moments = |x: &[f64]| {
                let mean = x.iter().sum::<f64>() / x.len() as f64;
                (mean, x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / x.len() as f64)
            };
            let (a, b) = (moments(&same), moments(&other));
            println!(
                "gallery {gallery:?} probe {yaw:2} n {} {name:6} rank-1 {:5.1} %  d' {:.2}  cosine {:.2} / {:.2}",
                same.len(),
                100.0 * f64::from(hits as u32) / same.len() as f64,
                (a.0 - b.0) / (0.5 * (a.1 + b.1)).sqrt(),
                a.0,
                b.0
            );
        }
    }
}
