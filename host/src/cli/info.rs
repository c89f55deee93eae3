//! `onescan info`.

use clap::Args;
use onescan::error::Result;
use onescan::fit::summary::hex;
use onescan::interchange;
use onescan::progress::print;
use onescan_core::basis::Basis;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Say what a model holds and where it comes from.
///
/// Also checks the file: a damaged model gives an error that says what and where.
#[derive(Args)]
pub(super) struct Info {
    /// The model: .3dmm, .h5, .h5.json or .mat.
    model: PathBuf,
    /// For programs.
    #[arg(long)]
    json: bool,
}

impl Info {
    pub(super) fn run(self) -> Result<()> {
        let file = interchange::open(&self.model)?;
        let model = file.view();
        if self.json {
            let landmarks: serde_json::Map<String, Value> =
                model.landmarks().map(|(name, vertex)| (name.to_string(), vertex.into())).collect();
            let value = json!({
                "vertices": model.vertices(),
                "triangles": model.triangles.len(),
                "shape": half_json(&model.shape),
                "albedo": half_json(&model.albedo),
                "landmarks": landmarks,
                "occlusion_map": model.occlusion().is_some(),
                "checksum": hex(model.checksum()),
                "provenance": model.provenance(),
            });
            print(format_args!("{value:#}"))?;
            return Ok(());
        }
        print(format_args!("{} vertices, {} triangles", model.vertices(), model.triangles.len()))?;
        print_half("shape", &model.shape, "mm² per coordinate")?;
        print_half("albedo", &model.albedo, "per channel")?;
        let names: Vec<_> = model.landmarks().map(|(name, _)| name).collect();
        match names.len() {
            0 => print("no landmarks")?,
            count => {
                print(format_args!("{count} landmarks:"))?;
                for line in names.chunks(3) {
                    let row: Vec<String> = line.iter().map(|name| format!("{name:<28}")).collect();
                    print(format_args!("  {}", row.join(" ").trim_end()))?;
                }
            }
        }
        if model.occlusion().is_some() {
            print("an occlusion map: where the surface is likely to be hidden")?;
        }
        print(format_args!("checksum {}", hex(model.checksum())))?;
        print(model.provenance().trim_end())
    }
}

/// Components that hold at least `fraction` of the whole variance, if the model's do.
fn components_for(basis: &Basis<'_>, fraction: f64) -> Option<usize> {
    let mut sum = 0.0;
    let wanted = fraction * basis.total_variance();
    basis
        .variance()
        .iter()
        .position(|&v| {
            sum += f64::from(v);
            sum >= wanted
        })
        .map(|index| index + 1)
}

fn captured(basis: &Basis<'_>) -> f64 {
    let kept: f64 = basis.variance().iter().map(|&v| f64::from(v)).sum();
    // An empty sum is −0.
    if basis.total_variance() > 0.0 { (0.0 + kept) / basis.total_variance() } else { 1.0 }
}

fn half_json(basis: &Basis<'_>) -> Value {
    json!({
        "rank": basis.rank(),
        "captured": captured(basis),
        "total_variance": basis.total_variance(),
        "variance": basis.variance(),
    })
}

fn print_half(name: &str, basis: &Basis<'_>, unit: &str) -> Result<()> {
    let points = basis.mean().len().max(1) as f64;
    print(format_args!(
        "{name}: {} components hold {:.1} % of the variance ({:.4} {unit})",
        basis.rank(),
        100.0 * captured(basis),
        basis.total_variance() / points
    ))?;
    for fraction in [0.5, 0.8, 0.9, 0.95, 0.99] {
        if let Some(count) = components_for(basis, fraction) {
            print(format_args!("  {:>4.0} % in {count}", 100.0 * fraction))?;
        }
    }
    Ok(())
}
