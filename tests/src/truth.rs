//! How near a fitted face comes to the true one.

use onescan::scan::rigid::Rigid;

/// Root mean square over groups of `per` differences.
pub fn rms<'a>(pairs: impl Iterator<Item = (&'a f32, &'a f32)>, per: usize) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    for (a, b) in pairs {
        sum += f64::from(a - b).powi(2);
        count += 1;
    }
    (sum / (count / per).max(1) as f64).sqrt()
}

/// Points after the best rotation and translation onto others, and after the best similarity, which also
/// scales: a single picture does not show how large a face is.
///
/// # Panics
/// Without points, or with points that are not finite.
pub fn aligned(moving: &[[f32; 3]], fixed: &[[f32; 3]]) -> [Vec<[f32; 3]>; 2] {
    let motion = Rigid::between(moving, fixed).expect("points that are finite");
    let moved: Vec<_> = moving.iter().map(|&p| motion.apply(p)).collect();
    // Both have their centre at the same place.
    let centre: [f32; 3] = std::array::from_fn(|i| {
        (moved.iter().map(|p| f64::from(p[i])).sum::<f64>() / moved.len() as f64) as f32
    });
    let (mut across, mut own) = (0.0, 0.0);
    for (p, q) in moved.iter().zip(fixed) {
        for i in 0..3 {
            across += f64::from(p[i] - centre[i]) * f64::from(q[i] - centre[i]);
            own += f64::from(p[i] - centre[i]).powi(2);
        }
    }
    let scale = (across / own) as f32;
    let scaled = moved
        .iter()
        .map(|p| std::array::from_fn(|i| centre[i] + scale * (p[i] - centre[i])))
        .collect();
    [moved, scaled]
}

/// Root mean square vertex distance, mm, after both.
///
/// # Panics
/// Without points, or with points that are not finite.
pub fn distances_after_alignment(moving: &[[f32; 3]], fixed: &[[f32; 3]]) -> [f64; 2] {
    aligned(moving, fixed)
        .map(|moved| rms(moved.as_flattened().iter().zip(fixed.as_flattened()), 3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_turned_and_grown_copy_is_as_far_as_it_has_grown() {
        let points: Vec<[f32; 3]> =
            vec![[1.0, 2.0, 3.0], [-4.0, 0.5, 2.0], [0.0, -3.0, 1.0], [2.0, 2.0, -6.0]];
        let moved: Vec<[f32; 3]> =
            points.iter().map(|[x, y, z]| [5.0 - 1.5 * y, 1.5 * x, 1.5 * z + 7.0]).collect();
        let [rigid, similar] = distances_after_alignment(&points, &moved);
        assert!(similar < 1e-5, "{similar}");
        let centre: [f32; 3] =
            std::array::from_fn(|i| points.iter().map(|p| p[i]).sum::<f32>() / 4.0);
        let spread = rms(points.as_flattened().iter().zip([centre; 4].as_flattened()), 3);
        assert!((rigid - 0.5 * spread).abs() < 1e-5, "{rigid} {spread}");
    }
}
