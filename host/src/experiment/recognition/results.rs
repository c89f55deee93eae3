//! What the jobs came to: how often people are told, by model, angle and score.

use super::models::{MIXTURE, Named};
use super::{Job, Plan, Set, YAWS};
use crate::error::Result;
use crate::json;
use crate::recognition::scores::{Face, Score};
use crate::recognition::statistics::{
    Gap, Share, Trial, by_chance, cumulative, first, means, sensitivity,
};
use serde::Serialize;
use std::collections::BTreeMap;

/// Ranks of the cumulative match curves.
pub const RANKS: usize = 20;
/// Name of the mixture's row.
pub const TEN_MIXTURE: &str = "scan-mixture";

/// Everything, set by set.
#[derive(Serialize)]
pub struct Results {
    /// What pictures there were.
    pub sets: Vec<SetResult>,
    /// Seed of the synthetic people.
    pub seed: u64,
    /// Components of models of kernels.
    pub rank: usize,
}

/// A set of pictures.
#[derive(Serialize)]
pub struct SetResult {
    /// Its name.
    pub set: String,
    /// People in the gallery.
    pub people: usize,
    /// The models, in the table's order.
    pub models: Vec<Row>,
    /// Pairs of models the paper orders.
    pub orders: Vec<Order>,
}

/// A model's results.
#[derive(Serialize)]
pub struct Row {
    /// Its name.
    pub name: String,
    /// The paper's rank-1 shares at 15, 30 and 45°, %.
    pub paper: [f64; 3],
    /// By score and angle.
    pub cells: Vec<Cell>,
    /// Of the cosine: whom the probes were taken for.
    #[serde(skip)]
    takings: Vec<Vec<Taking>>,
    /// Of [`COMPARED`], by angle: all scores.
    #[serde(skip)]
    trials: [Vec<Vec<Trial>>; 2],
}

/// One angle of probes by one score.
#[derive(Serialize)]
pub struct Cell {
    /// The score.
    pub score: Score,
    /// The angle.
    pub yaw: u32,
    /// How often the first of the gallery was right.
    pub first: Share,
    /// d′.
    pub sensitivity: f64,
    /// Means of the scores of the same person and of others.
    pub means: [f64; 2],
    /// Cumulative match, from rank 1 on.
    pub cumulative: Vec<f64>,
}

/// Whom a probe was taken for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taking {
    /// Whom it shows.
    pub person: u32,
    /// Whom it was taken for.
    pub taken: u32,
    /// By how much the wrong score was above the right one.
    pub margin: f64,
}

/// Two models, of which the paper has the first above the second.
#[derive(Serialize)]
pub struct Order {
    /// The better one, by the paper.
    pub better: String,
    /// The other.
    pub worse: String,
    /// By angle.
    pub angles: Vec<Angle>,
}

/// The pair at an angle.
#[derive(Serialize)]
pub struct Angle {
    /// The angle.
    pub yaw: u32,
    /// Probes that only the one, and only the other got right.
    pub only: [usize; 2],
    /// Probability of so large a difference by chance (`McNemar`'s exact test).
    pub chance: f64,
    /// Differences of d′, by the score.
    pub gaps: Vec<(Score, Gap)>,
}

/// Pairs of which the paper says that the first is better.
const PAIRS: [(&str, &str); 14] = [
    ("standard-full", "standard-rgb"),
    ("standard-full", "standard-xyz"),
    ("correlated-full", "correlated-rgb"),
    ("correlated-full", "correlated-xyz"),
    ("symmetric-full", "symmetric-rgb"),
    ("symmetric-full", "symmetric-xyz"),
    ("correlated-full", "standard-full"),
    ("symmetric-full", "standard-full"),
    ("symmetric-full", "correlated-full"),
    (TEN_MIXTURE, "ten-scan-pca"),
    ("symmetric-full", "ten-scan-pca"),
    ("symmetric-full", TEN_MIXTURE),
    ("sixty-people-pca", "symmetric-full"),
    ("sixty-people-pca", TEN_MIXTURE),
];

/// Scores by which d′ is compared: the default, and that of the halves in which kernels on one mean differ.
const COMPARED: [Score; 2] = [Score::Cosine, Score::Albedo];

/// By person, the faces that a model's components found.
type Faces = BTreeMap<u32, Vec<Face>>;

impl Results {
    /// Of all jobs that have been done. Models some of whose jobs have not are left out.
    ///
    /// # Errors
    /// Results of other settings.
    pub fn read(plan: &Plan) -> Result<Self> {
        let sets = plan.sets().map(|set| SetResult::read(plan, set)).collect::<Result<Vec<_>>>()?;
        Ok(Self { sets, seed: plan.seed, rank: plan.rank })
    }

    /// The contents of `recognition.json`.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_json(&self) -> Result<String> {
        json::to_text(self)
    }
}

impl SetResult {
    fn read(plan: &Plan, set: Set) -> Result<Self> {
        let mut models = Vec::new();
        let mut components: Vec<[Faces; 4]> = Vec::new();
        let (mut people, mut of_mixture) = (0, 0);
        for model in &plan.models {
            of_mixture += usize::from(model.is_of_mixture());
            let Some(faces) = faces(plan, set, model)? else { continue };
            people = people.max(faces[0].len());
            models.push(Row::new(&model.name, model.paper, &faces));
            if model.is_of_mixture() {
                components.push(faces);
            }
        }
        if components.len() == of_mixture && of_mixture > 1 {
            let mut parts = components.into_iter();
            let mut all = parts.next().unwrap_or_default();
            for part in parts {
                for (all, part) in all.iter_mut().zip(part) {
                    for (person, faces) in part {
                        all.entry(person).or_default().extend(faces);
                    }
                }
            }
            models.push(Row::new(TEN_MIXTURE, MIXTURE, &all));
        }
        let orders = PAIRS.iter().filter_map(|(better, worse)| Order::of(&models, better, worse));
        let orders = orders.collect();
        Ok(Self { set: set.to_string(), people, models, orders })
    }
}

/// The faces that a model found, by angle; `None` if some job has not been done.
fn faces(plan: &Plan, set: Set, model: &Named) -> Result<Option<[Faces; 4]>> {
    let mut all: [Faces; 4] = Default::default();
    for (all, yaw) in all.iter_mut().zip(YAWS) {
        let Some(fitted) = plan.read(&Job { set, model: model.clone(), yaw })? else {
            return Ok(None);
        };
        *all = fitted.faces.into_iter().map(|(person, face)| (person, vec![face])).collect();
    }
    Ok(Some(all))
}

impl Row {
    fn new(name: &str, paper: [f64; 3], faces: &[Faces; 4]) -> Self {
        let [gallery, probes @ ..] = faces;
        let mut row = Self {
            name: name.into(),
            paper,
            cells: Vec::new(),
            takings: Vec::new(),
            trials: Default::default(),
        };
        for score in Score::ALL {
            for (probes, &yaw) in probes.iter().zip(&YAWS[1..]) {
                let (trials, takings) = trials(gallery, probes, score);
                row.cells.push(Cell {
                    score,
                    yaw,
                    first: first(&trials),
                    sensitivity: sensitivity(&trials),
                    means: means(&trials),
                    cumulative: cumulative(&trials, RANKS.min(gallery.len())),
                });
                if score == Score::default() {
                    row.takings.push(takings);
                }
                if let Some(place) = COMPARED.iter().position(|compared| *compared == score) {
                    row.trials[place].push(trials);
                }
            }
        }
        row
    }

    /// The angles by a score.
    pub fn of(&self, score: Score) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(move |cell| cell.score == score)
    }

    /// Whom probes were taken for, angle by angle from 15°.
    pub fn takings(&self) -> &[Vec<Taking>] {
        &self.takings
    }
}

/// Every probe against the gallery.
fn trials(gallery: &Faces, probes: &Faces, score: Score) -> (Vec<Trial>, Vec<Taking>) {
    let (mut trials, mut takings) = (Vec::new(), Vec::new());
    for (person, probe) in probes {
        let Some(own) = gallery.get(person) else { continue };
        let same = score.of_mixture(probe, own);
        let (mut others, mut taken, mut best) = (Vec::new(), *person, same);
        for (other, faces) in gallery.iter().filter(|(other, _)| *other != person) {
            let value = score.of_mixture(probe, faces);
            if !(value < best) {
                (taken, best) = (*other, value);
            }
            others.push(value);
        }
        trials.push(Trial { same, others });
        takings.push(Taking { person: *person, taken, margin: best - same });
    }
    (trials, takings)
}

impl Order {
    /// `None` if one of the models is not there.
    fn of(models: &[Row], better: &str, worse: &str) -> Option<Self> {
        let find = |name| models.iter().find(|row| row.name == name);
        let (one, other) = (find(better)?, find(worse)?);
        let gaps = |angle: usize| {
            let gap = |(place, score): (usize, &Score)| {
                let trials = [one, other].map(|row| &*row.trials[place][angle]);
                Gap::between(trials).map(|gap| (*score, gap))
            };
            COMPARED.iter().enumerate().filter_map(gap).collect()
        };
        let angles = YAWS[1..].iter().zip(one.takings.iter().zip(&other.takings)).enumerate();
        let angles = angles.map(|(angle, (&yaw, (one, other)))| {
            let right = |taking: &Taking| taking.person == taking.taken;
            let only = |one: &[Taking], other: &[Taking]| {
                one.iter().zip(other).filter(|(a, b)| right(a) && !right(b)).count()
            };
            let only = [only(one, other), only(other, one)];
            Angle { yaw, only, chance: by_chance(only), gaps: gaps(angle) }
        });
        Some(Self { better: better.into(), worse: worse.into(), angles: angles.collect() })
    }
}
