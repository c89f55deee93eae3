//! What the page says of a sampled posterior.

use super::words::{Escaped, number};
use crate::fit::summary::{Marginal, PosteriorFound};
use std::fmt::{self, Write};

/// Parameters shown of those that mixed worst.
const WORST: usize = 10;

/// What a sampler found: pose with its intervals, and the parameters that mixed worst.
pub(super) fn section(f: &mut impl Write, found: &PosteriorFound) -> fmt::Result {
    writeln!(
        f,
        "<h3>How sure that is</h3>\n<p>{} chains of {} states from the posterior; {} of {} parameters \
         have mixed (R̂ below 1.01, effective sample sizes of at least 400). The shape is known to {} mm \
         (root mean square of the vertices' standard deviations; the picture's scale ends at {} \
         mm).</p>",
        found.chains,
        found.draws,
        found.mixed,
        found.parameters.len(),
        number(found.vertex_sd_mm, 1),
        number(found.uncertainty_scale_mm, 0),
    )?;
    let is_pose = |m: &&Marginal| m.name.starts_with("pose.") || m.name.starts_with("camera.");
    let mut rows: Vec<&Marginal> = found.parameters.iter().filter(is_pose).collect();
    let mut worst: Vec<&Marginal> = found.parameters.iter().filter(|m| !is_pose(m)).collect();
    worst.sort_by(|a, b| b.r_hat.total_cmp(&a.r_hat));
    rows.extend(worst.into_iter().take(WORST));
    f.write_str(
        "<table class=\"moves\"><thead><tr><th>Parameter</th><th>Mean</th><th>90 % interval</th><th>R̂</th>\
         <th>ESS, bulk</th><th>ESS, tails</th></tr></thead><tbody>\n",
    )?;
    for m in rows {
        writeln!(
            f,
            "<tr><td><code>{}</code></td><td>{}</td><td>{} to {}</td><td>{}</td><td>{}</td>\
             <td>{}</td></tr>",
            Escaped(&m.name),
            number(m.mean, 2),
            number(m.low, 2),
            number(m.high, 2),
            number(m.r_hat.min(99.0), 3),
            number(m.ess_bulk, 0),
            number(m.ess_tail, 0),
        )?;
    }
    f.write_str(
        "</tbody></table>\n<p class=\"note\">Angles in degrees, places in mm. Pose and camera, and \
         what mixed worst of the rest; all are in fit.json, all states in posterior.h5.</p>\n",
    )
}

/// The files that stand beside the page, whatever folder a fit's own are in.
pub(super) fn files(f: &mut impl Write) -> fmt::Result {
    for (file, what) in [
        ("posterior.h5", "all states of the chains"),
        ("mean.glb", "the posterior's mean face"),
        ("uncertainty.glb", "that face, coloured by how far its points are known"),
    ] {
        writeln!(f, "<li><a href=\"{file}\">{file}</a>: {what}</li>")?;
    }
    Ok(())
}
