//! Fits to pictures of known truth that no renderer of ours made, with hair, gloss and cast shadow:
//! the fit is nearer to the person than the template is.
//!
//! Three of the sixty people at four yaws are in `fixtures/rough`. `cargo xtask rough DIR` has this
//! test fit all pictures of a directory, and print how well people are recognised:
//! `ONESCAN_ROUGH=DIR`.

use onescan::demo::{template, template_model};
use onescan::experiment::faces::{Identity, identities};
use onescan::experiment::recognition::{self, Rough};
use onescan::recognition::scores::{Face, Score};
use onescan::recognition::statistics::{Trial, first, means, sensitivity};
use onescan::render;
use onescan_core::model::Model;
use onescan_tests::photos;
use onescan_tests::truth::{distances_after_alignment, rms};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

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
    face: Face,
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
            tell_apart(&fitted, gallery);
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
    let all = recognition::pictures(directory).unwrap().into_iter();
    all.map(|Rough { person, yaw, path }| (person as usize, yaw, path)).collect()
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
                        face: Face { shape, albedo, ln_evidence: 0.0 },
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
    let photos: Vec<_> = paths.iter().map(|path| photos::read(path)).collect();
    let fits = photos::fit(model, &photos);
    let subject = &fits[0].best.scene.subject;
    (subject.shape.to_vec(), subject.albedo.to_vec())
}

/// Prints how well people are told from a gallery of faces fitted to the photos at these yaws.
fn tell_apart(fitted: &[Fitted], gallery: &[u32]) {
    let at = |yaws: &[u32]| fitted.iter().filter(|f| f.yaws == yaws).collect::<Vec<_>>();
    let known = at(gallery);
    for yaw in YAWS.iter().filter(|yaw| !gallery.contains(yaw)) {
        for score in Score::ALL {
            let trial = |probe: &&Fitted| {
                let value = |f: &&Fitted| score.of(&probe.face, &f.face);
                let (own, others): (Vec<&Fitted>, Vec<&Fitted>) =
                    known.iter().partition(|f| f.person == probe.person);
                let same = own.first().map(value)?;
                Some(Trial { same, others: others.iter().map(value).collect() })
            };
            let trials: Vec<Trial> = at(&[*yaw]).iter().filter_map(trial).collect();
            let [same, other] = means(&trials);
            println!(
                "gallery {gallery:?} probe {yaw:2} n {} {score:6} rank-1 {:5.1} %  d' {:.2}  \
                 cosine {same:.2} / {other:.2}",
                trials.len(),
                100.0 * first(&trials).share,
                sensitivity(&trials),
            );
        }
    }
}
