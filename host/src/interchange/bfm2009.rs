//! The Basel face model of 2009, `01_MorphableModel.mat`.
//!
//! Its unit is the micrometre, its colours go to 255, it keeps standard deviations, and its
//! triangles are numbered from one and clockwise.

use crate::error::{Error, Result};
use crate::interchange::mat::{self, Array};
use crate::model::morphable::{Import, Morphable};
use crate::model::process::Process;
use faer::Mat;

/// Micrometres in a millimetre.
const MICROMETRES: f64 = 1000.0;
/// What is white.
const WHITE: f64 = 255.0;

/// Reads the model of a file's bytes.
///
/// # Errors
/// Those of [`mat::read`], and naming the array: another size, numbers that are not finite,
/// triangles out of range.
pub fn parse(bytes: &[u8]) -> Result<Import> {
    const NAMES: [&str; 7] = ["shapeMU", "shapePC", "shapeEV", "texMU", "texPC", "texEV", "tl"];
    let arrays = mat::read(bytes, NAMES)?;
    for (name, array) in NAMES.iter().zip(&arrays) {
        if let Some(i) = array.values.iter().position(|x| !(*x as f32).is_finite()) {
            return Err(Error::new(format_args!(
                "{name}: entry {i} is {}; the file is damaged, get it again",
                array.values[i]
            )));
        }
    }
    let [shape_mean, shape_basis, shape_deviations, color_mean, color_basis, color_deviations, tl] =
        arrays;
    let vertices = shape_mean.values.len() / 3;
    let shape =
        process(["shapePC", "shapeEV"], vertices, [shape_mean, shape_basis, shape_deviations])?
            .in_unit(1.0 / MICROMETRES);
    let albedo =
        process(["texPC", "texEV"], vertices, [color_mean, color_basis, color_deviations])?
            .in_unit(1.0 / WHITE);
    let provenance = "format = \"Basel face model 2009\"\n".to_string();
    let model = Morphable::new(shape, albedo, triangles(&tl, vertices)?, Vec::new(), provenance);
    let notes = vec!["the file names no landmarks; give them with --landmarks".to_string()];
    Ok(Import { model, notes })
}

/// Mean (3V × 1), unit columns (3V × r) and standard deviations (r × 1) of one half.
fn process(names: [&str; 2], vertices: usize, arrays: [Array; 3]) -> Result<Process> {
    let [mean, basis, deviations] = arrays;
    let rank = deviations.values.len();
    let wrong = |name: &str, size: [usize; 2], expected: [usize; 2]| {
        Err(Error::new(format_args!("{name}: size {size:?}, expected {expected:?}; get it again")))
    };
    if vertices == 0 || mean.values.len() != 3 * vertices {
        return wrong(&names[0].replace("PC", "MU"), mean.size, [3 * vertices, 1]);
    }
    if basis.size != [3 * vertices, rank] {
        return wrong(names[0], basis.size, [3 * vertices, rank]);
    }
    let entries =
        |row: usize, k: usize| basis.values[3 * vertices * k + row % vertices * 3 + row / vertices];
    let point = |p: &[f64; 3]| p.map(|x| x as f32);
    Ok(Process::new(
        mean.values.as_chunks().0.iter().map(point).collect(),
        Mat::from_fn(3 * vertices, rank, entries),
        deviations.values.iter().map(|s| s * s).collect(),
        0.0,
    ))
}

/// Triangles from rows of three numbers.
fn triangles(tl: &Array, vertices: usize) -> Result<Vec<[u32; 3]>> {
    let [count, 3] = tl.size else {
        return Err(Error::new(format_args!("tl: size {:?}, expected three columns", tl.size)));
    };
    if count == 0 {
        return Err(Error::new("tl: there are no triangles; get the file again"));
    }
    (0..count)
        .map(|t| {
            // Turned, so that they are counter-clockwise.
            let corners = [1, 0, 2].map(|k| tl.values[k * count + t]);
            if corners.iter().all(|&v| v >= 1.0 && v <= vertices as f64 && v.fract() == 0.0) {
                Ok(corners.map(|v| v as u32 - 1))
            } else {
                Err(Error::new(format_args!(
                    "tl: triangle {t} is {corners:?}, vertices are 1 to {vertices}; the file is \
                     damaged, get it again"
                )))
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::interchange::mat::tests::{compressed, file, matrix};

    fn example(change: impl Fn(&mut Vec<Vec<u8>>)) -> Vec<u8> {
        let mean = [0.0, 0.0, 0.0, 2000.0, 0.0, 0.0, 0.0, 3000.0, 0.0];
        let mut basis = vec![0.0; 18];
        basis[3] = 1.0;
        basis[9 + 7] = 1.0;
        let colors: Vec<f32> = (0..9).map(|i| 25.5 * i as f32).collect();
        let mut elements = vec![
            matrix("shapeMU", [9, 1], &mean),
            compressed(&matrix("shapePC", [9, 2], &basis)),
            matrix("shapeEV", [2, 1], &[500.0, 250.0]),
            matrix("texMU", [9, 1], &colors),
            matrix("texPC", [9, 1], &[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
            matrix("texEV", [1, 1], &[51.0]),
            matrix("tl", [1, 3], &[1.0, 3.0, 2.0]),
        ];
        change(&mut elements);
        file(&elements)
    }

    #[test]
    fn units_and_orientation_become_ours() {
        let Import { model, .. } = parse(&example(|_| {})).unwrap();
        assert_eq!(model.shape.mean, [[0.0; 3], [2.0, 0.0, 0.0], [0.0, 3.0, 0.0]]);
        assert_eq!(model.triangles, [[2, 0, 1]], "counter-clockwise");
        let moved = model.shape.instance(&[1.0, -2.0]);
        assert!((moved[1][0] - 2.5).abs() < 1e-12 && (moved[2][1] - 2.5).abs() < 1e-12);
        assert!((model.albedo.mean[2][2] - 0.8).abs() < 1e-7);
        assert!((model.albedo.instance(&[1.0])[0][0] - 0.2).abs() < 1e-12);
    }

    #[test]
    fn faults_name_the_array() {
        let says = |at: usize, element: Vec<u8>, part: &str| {
            let bytes = example(|elements| elements[at].clone_from(&element));
            let message = parse(&bytes).unwrap_err().to_string();
            assert!(message.contains(part), "{message:?} does not say {part:?}");
        };
        says(0, matrix("shapeMU", [8, 1], &[0.0; 8]), "shapeMU: size [8, 1]");
        says(0, matrix("shapeMU", [9, 1], &[f32::NAN; 9]), "shapeMU: entry 0 is NaN");
        says(2, matrix("shapeEV", [3, 1], &[0.0; 3]), "shapePC: size [9, 2], expected [9, 3]");
        says(3, matrix("texMU", [3, 1], &[0.0; 3]), "texMU: size [3, 1]");
        says(6, matrix("tl", [1, 3], &[1.0, 4.0, 2.0]), "tl: triangle 0");
        says(6, matrix("tl", [1, 3], &[0.0, 3.0, 2.0]), "tl: triangle 0");
        says(6, matrix("tl", [3, 1], &[1.0, 3.0, 2.0]), "three columns");
        says(6, matrix("tl", [0, 3], &[]), "no triangles");
        says(6, matrix("lt", [1, 3], &[1.0, 3.0, 2.0]), "no array tl");
    }
}
