//! Positions far from their origin, like those of maps: moved there before they become f32.

use crate::vector::distance;

/// Greatest error of rounding to f32, as a fraction of the diagonal of the points' box, that is
/// left alone: 0.002 mm in a face.
const ERROR: f64 = 1e-5;

/// The points in f32, and what was subtracted from them before: nothing, unless their distance from
/// the origin would cost digits that they need; then the centre of their box, rounded.
pub(crate) fn settled(points: &[[f64; 3]]) -> (Vec<[f32; 3]>, [f64; 3]) {
    let rounded = |p: &[f64; 3]| p.map(|c| c as f32);
    let exact = |p: &[f64; 3]| rounded(p).map(f64::from) == *p;
    let (low, high) =
        points.iter().fold(([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]), |(low, high), p| {
            (std::array::from_fn(|i| low[i].min(p[i])), std::array::from_fn(|i| high[i].max(p[i])))
        });
    let diagonal = distance(high, low);
    let largest = low.iter().chain(&high).fold(0.0_f64, |largest, c| largest.max(c.abs()));
    // Half a unit in the last of the 24 binary digits.
    let error = largest * f64::from(f32::EPSILON) / 2.0;
    // A number that a person can write down.
    let places = 10.0_f64.powi((3.0 - diagonal.log10()).ceil() as i32);
    let centre: [f64; 3] =
        std::array::from_fn(|i| (f64::midpoint(low[i], high[i]) * places).round() / places);
    if !(error > ERROR * diagonal && diagonal > 0.0 && centre.iter().all(|c| c.is_finite()))
        || points.iter().all(exact)
    {
        return (points.iter().map(rounded).collect(), [0.0; 3]);
    }
    let moved = |p: &[f64; 3]| std::array::from_fn(|i| (p[i] - centre[i]) as f32);
    (points.iter().map(moved).collect(), centre)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_would_lose_digits_is_moved() {
        let near = [[0.1, 0.2, 0.3], [200.1, 100.0, -50.0]];
        assert_eq!(settled(&near), (vec![[0.1, 0.2, 0.3], [200.1, 100.0, -50.0]], [0.0; 3]));
        let map = near.map(|p| [p[0] + 4e5, p[1] + 5e6, p[2]]);
        let (points, origin) = settled(&map);
        for (p, q) in points.iter().zip(near) {
            for i in 0..3 {
                let back = f64::from(p[i]) + origin[i] - [4e5, 5e6, 0.0][i];
                assert!((back - q[i]).abs() < 1e-5, "{back} {q:?}");
            }
        }
        // What was stored in f32 has nothing to lose, and stays where it is.
        let stored = map.map(|p| p.map(|c| f64::from(c as f32)));
        assert_eq!(settled(&stored).1, [0.0; 3]);
        assert_eq!(settled(&[[f64::MAX; 3], [f64::MIN; 3]]).1, [0.0; 3]);
        assert_eq!(settled(&[]), (Vec::new(), [0.0; 3]));
    }
}
