//! Smooth fields over a surface through scattered values.

use super::mirror::mean_edge;

/// Over what length values are averaged, and over what length a field dies away from them; shares of the
/// object's size. Chosen, not measured, as are the sweeps and how far they overshoot.
const AVERAGED: f32 = 0.03;
const CARRIED: f32 = 0.25;
const SWEEPS: usize = 150;
const OVERSHOOT: f32 = 1.8;

/// The neighbours of each vertex, and what binds.
pub(super) struct Smoother {
    neighbours: Vec<Vec<u32>>,
    /// How much a value counts against a neighbour, and how much zero does.
    value: f32,
    zero: f32,
}

impl Smoother {
    pub(super) fn new(points: &[[f32; 3]], triangles: &[[u32; 3]], object: f32) -> Self {
        let mut neighbours = vec![Vec::new(); points.len()];
        for &[a, b, c] in triangles {
            for (i, j) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
                let known: &mut Vec<u32> = &mut neighbours[i as usize];
                if !known.contains(&j) {
                    known.push(j);
                }
            }
        }
        let edge = mean_edge(points, triangles);
        let bind = |share: f32| {
            let k = edge / (share * object);
            k * k
        };
        Self { neighbours, value: bind(AVERAGED), zero: bind(CARRIED) }
    }

    /// The field `x` that makes
    /// `Σ_i value·w_i |x_i − e_i|² + zero |x_i|² + Σ_edges |x_i − x_j|²` least, of values `e` with
    /// weights `w`.
    pub(super) fn smooth(&self, values: &[[f32; 4]]) -> Vec<[f32; 3]> {
        let mut field = vec![[0.0_f32; 3]; values.len()];
        for _ in 0..SWEEPS {
            for (i, (neighbours, &[r, g, b, weight])) in
                self.neighbours.iter().zip(values).enumerate()
            {
                let bound = self.value * weight;
                let mut sum = [r, g, b].map(|e| bound * e);
                for &j in neighbours {
                    let x = field[j as usize];
                    sum = [sum[0] + x[0], sum[1] + x[1], sum[2] + x[2]];
                }
                let total = bound + self.zero + neighbours.len() as f32;
                for k in 0..3 {
                    field[i][k] += OVERSHOOT * (sum[k] / total - field[i][k]);
                }
            }
        }
        field
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::demo::template;

    #[test]
    fn a_field_goes_through_its_values_and_dies_away_from_them() {
        let mesh = template().unwrap().0;
        let smoother = Smoother::new(&mesh.points, &mesh.triangles, 250.0);
        // The right half says one half, the left nothing.
        let known =
            |p: &[f32; 3]| if p[0] < 0.0 { [0.5, -0.5, 0.0, 1.0] } else { [9.0, 9.0, 9.0, 0.0] };
        let values: Vec<_> = mesh.points.iter().map(known).collect();
        for (p, [r, g, b]) in mesh.points.iter().zip(smoother.smooth(&values)) {
            assert!((r + g).abs() < 1e-4 && b == 0.0, "{p:?}: {r} {g} {b}");
            match p[0] {
                x if x < -40.0 => assert!((r - 0.5).abs() < 0.03, "{p:?}: {r}"),
                x if x > 60.0 => assert!((0.0..0.25).contains(&r), "{p:?}: {r}"),
                _ => assert!((0.0..0.51).contains(&r), "{p:?}: {r}"),
            }
        }
    }
}
