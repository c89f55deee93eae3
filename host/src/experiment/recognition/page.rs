//! The experiment's table and page.

use super::results::{Cell, Order, RANKS, Results, Row, SetResult, TEN_MIXTURE, Taking};
use super::{Plan, Set, YAWS, people::Crowd, pictures};
use crate::error::{Error, Result};
use crate::photo;
use crate::photo::picture::{Picture, WHITE, contact_sheet};
use crate::recognition::scores::Score;
use crate::report::charts::{Scale, Series, curves};
use crate::report::{essay, figure};
use std::fmt::Write as _;

/// Models whose cumulative match is drawn: as many as the page has colours.
const DRAWN: [&str; 5] =
    ["symmetric-full", "standard-full", "ten-scan-pca", TEN_MIXTURE, "sixty-people-pca"];
/// Of these the first shows whom it takes for whom.
const SHOWN: &str = DRAWN[0];
/// Pictures of mistakes: so many.
const MISTAKES: usize = 8;
/// Their sides, pixels.
const SIDE: u32 = 160;
/// Differences as likely as this by chance are none: the customary 5 %.
const SIGNIFICANT: f64 = 0.05;

fn percent(share: f64) -> String {
    format!("{:.1}", 100.0 * share)
}

/// `97.2 (94.3–98.6)`.
fn share(cell: &Cell) -> String {
    let [low, high] = cell.first.interval.map(percent);
    format!("{} ({low}–{high})", percent(cell.first.share))
}

impl Results {
    /// The tables, in Markdown.
    pub fn markdown(&self) -> String {
        let mut text = String::new();
        for set in &self.sets {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "## {}\n", set.title());
            text += &set.rank_table();
            let _ = writeln!(text, "\n### By score\n");
            text += &set.score_table();
            if !set.orders.is_empty() {
                let _ = writeln!(text, "\n### The paper's orderings\n");
                text += &set.order_table();
                let _ = writeln!(text, "\n### The same by d′\n");
                text += &set.gap_table();
            }
            text.push('\n');
        }
        text
    }

    /// The page.
    ///
    /// # Errors
    /// Pictures that cannot be read.
    pub fn page(&self, plan: &Plan) -> Result<String> {
        let mut body = String::new();
        for (set, kind) in self.sets.iter().zip(plan.sets()) {
            let _ = writeln!(body, "<section>\n<h2>{}</h2>", set.title());
            body += "<p>Rank 1, % (95 % interval by Wilson’s score), the cosine of shape and \
                     albedo; in the last columns the paper’s, on other pictures of other \
                     people.</p>\n";
            body += &html_table(&set.rank_table());
            body += &set.charts();
            body += "<h3>By score</h3>\n";
            body += &html_table(&set.score_table());
            if !set.orders.is_empty() {
                body += "<h3>The paper’s orderings</h3>\n<p>Probes that only the first, and only \
                         the second model gets right, and the probability of so large a difference \
                         by chance (McNemar’s exact test).</p>\n";
                body += &html_table(&set.order_table());
                body += "<p>By how much d′ of the first is above that of the second, ± its standard \
                         error over people (the jackknife); “not told” if zero is within 1.96 of \
                         these.</p>\n";
                body += &html_table(&set.gap_table());
            }
            if let Some((sheet, text)) = set.mistakes(plan, kind)? {
                body += "<h3>The worst mistakes</h3>\n";
                body += &figure(&sheet, &text, MISTAKEN)?;
                let _ = writeln!(body, "<p class=\"note\">{text}</p>");
            }
            body += "</section>\n";
        }
        let lead = "People told apart by what fits find of them. The gallery is a picture of each, \
                    seen from the front; the probes are turned, in another light.";
        essay("Who is it?", lead, &body)
    }
}

const MISTAKEN: &str = "A column for each mistake: the probe, the picture of the same person in the \
                        gallery, and the one it was taken for.";

impl SetResult {
    fn title(&self) -> String {
        let of = if self.set == "clean" { "Clean pictures of" } else { "Rough pictures of" };
        format!("{of} {} people (chance {:.1} %)", self.people, 100.0 / self.people.max(1) as f64)
    }

    fn rank_table(&self) -> String {
        let mut text = String::from(
            "| model | 15° | 30° | 45° | d′ | paper 15° | 30° | 45° |\n|---|---|---|---|---|---|---|---|\n",
        );
        for row in &self.models {
            let cells: Vec<&Cell> = row.of(Score::default()).collect();
            let shares: Vec<String> = cells.iter().map(|cell| share(cell)).collect();
            let apart: Vec<String> =
                cells.iter().map(|cell| format!("{:.2}", cell.sensitivity)).collect();
            let paper = row.paper.map(|x| format!("{x:.1}")).join(" | ");
            let (shares, apart) = (shares.join(" | "), apart.join(" / "));
            let _ = writeln!(text, "| {} | {shares} | {apart} | {paper} |", row.name);
        }
        text
    }

    fn score_table(&self) -> String {
        let mut text =
            String::from("| model | score | 15° | 30° | 45° | d′ |\n|---|---|---|---|---|---|\n");
        for row in &self.models {
            for score in Score::ALL {
                let shares: Vec<_> = row.of(score).map(|cell| percent(cell.first.share)).collect();
                let apart: Vec<_> =
                    row.of(score).map(|cell| format!("{:.2}", cell.sensitivity)).collect();
                let (shares, apart) = (shares.join(" | "), apart.join(" / "));
                let _ = writeln!(text, "| {} | {score} | {shares} | {apart} |", row.name);
            }
        }
        text
    }

    fn order_table(&self) -> String {
        let mut text = String::from("| pair | 15° | 30° | 45° |\n|---|---|---|---|\n");
        for Order { better, worse, angles } in &self.orders {
            let _ = write!(text, "| {better} above {worse}");
            for angle in angles {
                let [one, other] = angle.only;
                let verdict = match (angle.chance < SIGNIFICANT, one > other) {
                    (false, _) => "not told",
                    (true, true) => "yes",
                    (true, false) => "reversed",
                };
                let _ = write!(text, " | {one} : {other}, p {:.3}, {verdict}", angle.chance);
            }
            text += " |\n";
        }
        text
    }

    fn gap_table(&self) -> String {
        let mut text = String::from("| pair | score | 15° | 30° | 45° |\n|---|---|---|---|---|\n");
        for Order { better, worse, angles } in &self.orders {
            let scores = angles.first().map(|angle| &angle.gaps[..]).unwrap_or_default();
            for (place, (score, _)) in scores.iter().enumerate() {
                let _ = write!(text, "| {better} above {worse} | {score}");
                for (_, gap) in angles.iter().filter_map(|angle| angle.gaps.get(place)) {
                    let verdict = match (gap.is_told(), gap.difference > 0.0) {
                        (false, _) => "not told",
                        (true, true) => "yes",
                        (true, false) => "reversed",
                    };
                    let _ = write!(text, " | {:+.2} ± {:.2}, {verdict}", gap.difference, gap.error);
                }
                text += " |\n";
            }
        }
        text
    }

    /// Cumulative match curves, a chart for each angle.
    fn charts(&self) -> String {
        let drawn: Vec<(usize, &Row)> = (DRAWN.iter().enumerate())
            .filter_map(|(color, name)| {
                Some((color, self.models.iter().find(|row| row.name == *name)?))
            })
            .collect();
        let mut text = String::from("<ul class=\"legend\">\n");
        for (color, row) in &drawn {
            let _ = writeln!(text, "<li class=\"series-{color}\"><i></i>{}</li>", row.name);
        }
        text += "</ul>\n<div class=\"charts three\">\n";
        for yaw in &YAWS[1..] {
            let series: Vec<Series> = (drawn.iter())
                .filter_map(|(color, row)| {
                    let cell = row.of(Score::default()).find(|cell| cell.yaw == *yaw)?;
                    let at = |(i, share): (usize, &f64)| ((i + 1) as f64, 100.0 * share, 0.0);
                    let points = cell.cumulative.iter().enumerate().map(at).collect();
                    Some(Series { points, color: *color })
                })
                .collect();
            let name = format!("Cumulative match at {yaw}°");
            if let Some(svg) = curves(&name, "rank", &Scale::Linear(RANKS), &series, None) {
                let _ = writeln!(
                    text,
                    "<figure>{svg}<figcaption><b>{yaw}°</b>: % of probes whose person is among so \
                     many first.</figcaption></figure>"
                );
            }
        }
        text + "</div>\n"
    }

    /// The worst mistakes as a sheet of pictures, and in words; `None` if there are none.
    fn mistakes(&self, plan: &Plan, set: Set) -> Result<Option<(Picture, String)>> {
        let row = self.models.iter().find(|row| row.name == SHOWN).or(self.models.first());
        let Some(row) = row else { return Ok(None) };
        let with_yaw = |(takings, yaw): (&Vec<Taking>, &u32)| {
            let yaw = *yaw;
            takings.iter().map(move |taking| (*taking, yaw)).collect::<Vec<_>>()
        };
        let mut all: Vec<(Taking, u32)> =
            row.takings().iter().zip(&YAWS[1..]).flat_map(with_yaw).collect();
        all.retain(|(taking, _)| taking.taken != taking.person);
        all.sort_by(|a, b| b.0.margin.total_cmp(&a.0.margin));
        all.truncate(MISTAKES);
        if all.is_empty() {
            return Ok(None);
        }
        let show = Show::new(plan, set)?;
        let mut rows: [Vec<Picture>; 3] = Default::default();
        let mut text = format!("By {}: ", row.name);
        for (i, (Taking { person, taken, margin }, yaw)) in all.iter().enumerate() {
            let of = [(*person, *yaw), (*person, 0), (*taken, 0)];
            for (row, (person, yaw)) in rows.iter_mut().zip(of) {
                row.push(show.picture(person, yaw)?.resized(SIDE, SIDE));
            }
            let comma = if i == 0 { "" } else { ", " };
            let _ = write!(text, "{comma}{person} at {yaw}° for {taken} (by {margin:.2})");
        }
        text.push('.');
        // Pictures are of one size, however many there are.
        for row in &mut rows {
            row.resize(MISTAKES, Picture::filled(SIDE, SIDE, WHITE));
        }
        let pictures: Vec<&Picture> = rows.iter().flatten().collect();
        Ok(Some((contact_sheet(&pictures, MISTAKES, 4, WHITE), text)))
    }
}

/// Where the pictures of a set come from.
enum Show {
    Crowd(Box<Crowd>),
    Files(Vec<super::Rough>),
}

impl Show {
    fn new(plan: &Plan, set: Set) -> Result<Self> {
        match (set, &plan.pictures) {
            (Set::Rough, Some(directory)) => Ok(Self::Files(pictures(directory)?)),
            _ => Ok(Self::Crowd(Box::new(Crowd::new(&plan.fixtures, plan.seed)?))),
        }
    }

    fn picture(&self, person: u32, yaw: u32) -> Result<Picture> {
        match self {
            Self::Crowd(crowd) => Ok(crowd.picture(person as usize, yaw)?.0),
            Self::Files(files) => {
                let found = files.iter().find(|file| (file.person, file.yaw) == (person, yaw));
                let file = found.ok_or_else(|| {
                    Error::new(format_args!("no picture of person {person} at {yaw}°"))
                })?;
                photo::read(&file.path)
            }
        }
    }
}

/// A table in Markdown as HTML.
pub(crate) fn html_table(markdown: &str) -> String {
    let mut text = String::from("<table class=\"measures\">\n");
    for (i, line) in markdown.lines().enumerate().filter(|(i, _)| *i != 1) {
        let cell = if i == 0 { "th" } else { "td" };
        text += "<tr>";
        for (k, content) in line.trim_matches('|').split('|').map(str::trim).enumerate() {
            // The first says what the row is about.
            let cell = if k == 0 { "th" } else { cell };
            let _ = write!(text, "<{cell}>{content}</{cell}>");
        }
        text += "</tr>\n";
    }
    text + "</table>\n"
}
