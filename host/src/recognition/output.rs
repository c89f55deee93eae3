//! What a recognition leaves behind: for every probe the gallery by how alike it is.

use super::scores::Score;
use super::statistics::{Share, Trial, cumulative, first, means, sensitivity};
use crate::error::{Error, Result};
use crate::json;
use crate::photo::picture::{Picture, WHITE, contact_sheet};
use crate::report::{Escaped, essay, figure};
use serde::Serialize;
use std::fmt::Write as _;

/// Ranks shown to a person. Chosen, not measured.
pub const SHOWN: usize = 5;

/// The result.
#[derive(Debug, Serialize)]
pub struct Recognition {
    /// Files of the models that were fitted.
    pub models: Vec<String>,
    /// What the scores are.
    pub score: Score,
    /// The probes.
    pub probes: Vec<Ranking>,
    /// How well people were told apart, if names say who is who.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub told: Option<Told>,
}

/// A probe, and the gallery by how alike it is.
#[derive(Debug, Serialize)]
pub struct Ranking {
    /// Name of the probe.
    pub probe: String,
    /// The gallery, the most alike first.
    pub gallery: Vec<Candidate>,
}

/// A face of the gallery.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Candidate {
    /// Its name.
    pub name: String,
    /// Its score.
    pub score: f64,
}

/// How well people were told apart.
#[derive(Debug, Serialize)]
pub struct Told {
    /// How often the first was right, of the probes whose person is in the gallery.
    pub first: Share,
    /// d′.
    pub sensitivity: f64,
    /// Means of the scores of the same person and of others.
    pub means: [f64; 2],
    /// Cumulative match, from rank 1 on.
    pub cumulative: Vec<f64>,
    /// Probes whose person is not in the gallery.
    pub unknown: usize,
}

impl Ranking {
    /// Sorts the gallery; of equals the first comes first.
    pub fn new(probe: String, mut gallery: Vec<Candidate>) -> Self {
        gallery.sort_by(|a, b| b.score.total_cmp(&a.score));
        Self { probe, gallery }
    }
}

impl Told {
    /// Looks at rankings: `person` says who the face of a name is, and of a person's faces the best counts.
    /// `None` if no probe's person is in the gallery.
    pub fn new(probes: &[Ranking], person: impl Fn(&str) -> String) -> Option<Self> {
        let (mut trials, mut unknown) = (Vec::new(), 0);
        for Ranking { probe, gallery } in probes {
            let wanted = person(probe);
            let mut people: Vec<(String, f64)> = Vec::new();
            for Candidate { name, score } in gallery {
                // They are sorted: a person's first is the best.
                let person = person(name);
                if people.iter().all(|(known, _)| *known != person) {
                    people.push((person, *score));
                }
            }
            match people.iter().find(|(name, _)| *name == wanted) {
                None => unknown += 1,
                Some(&(_, same)) => {
                    let others = people.iter().filter(|(name, _)| *name != wanted);
                    trials.push(Trial { same, others: others.map(|(_, score)| *score).collect() });
                }
            }
        }
        let people = trials.iter().map(|trial| 1 + trial.others.len()).max()?;
        Some(Self {
            first: first(&trials),
            sensitivity: sensitivity(&trials),
            means: means(&trials),
            cumulative: cumulative(&trials, people.min(20)),
            unknown,
        })
    }

    /// One line for a person.
    pub fn line(&self) -> String {
        let Share { hits, of, share, interval: [low, high] } = self.first;
        let unknown = match self.unknown {
            0 => String::new(),
            n => format!("; {n} probe(s) of nobody in the gallery"),
        };
        format!(
            "{hits} of {of} right, {:.1} % (95 % interval {:.1} to {:.1}), d′ {:.2}{unknown}",
            100.0 * share,
            100.0 * low,
            100.0 * high,
            self.sensitivity
        )
    }
}

impl Recognition {
    /// The contents of `ranks.json`.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_json(&self) -> Result<String> {
        json::to_text(self)
    }

    /// The contents of `ranks.csv`: a line for each pair.
    pub fn to_csv(&self) -> String {
        let mut text = String::from("probe,rank,name,score\n");
        for Ranking { probe, gallery } in &self.probes {
            for (i, Candidate { name, score }) in gallery.iter().enumerate() {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{},{},{},{score:.6}", cell(probe), i + 1, cell(name));
            }
        }
        text
    }

    /// The first of every probe, for a terminal.
    pub fn to_text(&self) -> String {
        let shown = |candidate: &Candidate| format!("{} {:.3}", candidate.name, candidate.score);
        let wide = self.probes.iter().map(|ranking| ranking.probe.chars().count()).max();
        let wide = wide.unwrap_or(0).max("probe".len());
        let mut text = format!("{:wide$}  nearest of the gallery, {}\n", "probe", self.score);
        for Ranking { probe, gallery } in &self.probes {
            let first: Vec<String> = gallery.iter().take(SHOWN).map(shown).collect();
            let _ = writeln!(text, "{probe:wide$}  {}", first.join("  "));
        }
        text
    }

    /// The page. `pictures` gives the picture of a face, if there is one, by whether it is a probe and by its
    /// name.
    ///
    /// # Errors
    /// Pictures without pixels.
    pub fn page(&self, pictures: impl Fn(bool, &str) -> Option<Picture>) -> Result<String> {
        let mut body = String::from("<section>\n<h2>Ranks</h2>\n");
        if let Some(told) = &self.told {
            let _ = writeln!(body, "<p>{}.</p>", Escaped(&told.line()));
        }
        let _ = writeln!(
            body,
            "<p>Scores are {}; more is more alike. ranks.csv and ranks.json beside this page hold \
             all of them.</p>",
            match self.score {
                Score::Cosine => "cosines, of shape and of albedo, averaged",
                Score::Joint => "cosines of shape and albedo together",
                Score::Shape => "cosines of shape",
                Score::Albedo => "cosines of albedo",
            }
        );
        body += "<table class=\"measures\">\n<tr><th>probe</th>";
        let columns = self.probes.first().map_or(0, |ranking| ranking.gallery.len().min(SHOWN));
        for rank in 1..=columns {
            let _ = write!(body, "<th>{rank}</th>");
        }
        body += "</tr>\n";
        for Ranking { probe, gallery } in &self.probes {
            let _ = write!(body, "<tr><th scope=\"row\">{}</th>", Escaped(probe));
            for Candidate { name, score } in gallery.iter().take(SHOWN) {
                let _ = write!(body, "<td>{} {score:.3}</td>", Escaped(name));
            }
            body += "</tr>\n";
        }
        body += "</table>\n";
        if let Some(sheet) = self.sheet(pictures)? {
            body += "<h2>In pictures</h2>\n";
            body += &figure(
                &sheet,
                "A row for each probe: the probe, then the nearest of the gallery",
                "A row for each probe: the probe, then the nearest of the gallery in their order.",
            )?;
        }
        body += "</section>\n";
        let lead = "Photos compared by the shape and the colour that fits found in them.";
        essay("Who is it?", lead, &body)
    }

    /// Probes and the nearest of the gallery; `None` if there is no picture of a probe.
    fn sheet(&self, pictures: impl Fn(bool, &str) -> Option<Picture>) -> Result<Option<Picture>> {
        const ROWS: usize = 40;
        const SIDE: u32 = 120;
        let columns = self.probes.first().map_or(0, |ranking| ranking.gallery.len().min(3));
        let mut all = Vec::new();
        for Ranking { probe, gallery } in self.probes.iter().take(ROWS) {
            let Some(own) = pictures(true, probe) else { return Ok(None) };
            all.push(own);
            for Candidate { name, .. } in gallery.iter().take(columns) {
                all.push(
                    pictures(false, name).unwrap_or_else(|| Picture::filled(SIDE, SIDE, WHITE)),
                );
            }
        }
        if all.is_empty() {
            return Ok(None);
        }
        let all: Vec<Picture> = all.iter().map(|picture| picture.resized(SIDE, SIDE)).collect();
        let sheet = contact_sheet(&all.iter().collect::<Vec<_>>(), 1 + columns, 4, WHITE);
        if sheet.width == 0 {
            return Err(Error::new("a picture without pixels"));
        }
        Ok(Some(sheet))
    }
}

/// A cell of a CSV.
fn cell(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        return format!("\"{}\"", text.replace('"', "\"\""));
    }
    text.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ranking(probe: &str, gallery: &[(&str, f64)]) -> Ranking {
        let of = |&(name, score): &(&str, f64)| Candidate { name: name.into(), score };
        Ranking::new(probe.into(), gallery.iter().map(of).collect())
    }

    fn example() -> Recognition {
        let probes = vec![
            ranking("anna_2", &[("ben_1", 0.1), ("anna_1", 0.9), ("anna_0", -0.5)]),
            ranking("carl", &[("ben_1", 0.2), ("anna_1", 0.1)]),
        ];
        Recognition { models: vec!["m".into()], score: Score::Cosine, probes, told: None }
    }

    #[test]
    fn the_best_of_a_persons_faces_counts() {
        let person = |name: &str| name.split('_').next().unwrap_or(name).to_owned();
        let told = Told::new(&example().probes, person).unwrap();
        assert_eq!((told.first.hits, told.first.of, told.unknown), (1, 1, 1));
        assert_eq!(told.cumulative, [1.0, 1.0]);
        assert!(Told::new(&example().probes, |_| "nobody".into()).is_some());
        assert!(Told::new(&[ranking("x", &[("y", 1.0)])], str::to_owned).is_none());
    }

    #[test]
    fn files_hold_every_pair() {
        let mut found = example();
        found.probes[1].probe = "a \"b\", c".into();
        let csv = found.to_csv();
        assert!(csv.starts_with("probe,rank,name,score\nanna_2,1,anna_1,0.900000\n"), "{csv}");
        assert!(csv.contains("\n\"a \"\"b\"\", c\",2,anna_1,0.100000\n"), "{csv}");
        assert!(found.to_json().unwrap().contains("\"score\": \"cosine\""));
        let text = found.to_text();
        assert!(text.lines().nth(1).unwrap().starts_with("anna_2"), "{text}");
        let page = found.page(|_, _| Some(Picture::filled(2, 2, [0; 3]))).unwrap();
        assert!(page.contains("a &quot;b&quot;, c") && page.matches("<img").count() == 1);
    }
}
