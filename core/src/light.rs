//! Spherical-harmonics light (second order, nine coefficients) on Lambertian surfaces.
//!
//! `radiance_c(n) = Σ_i k_i·Y_i(n)·L_{i,c}` with `n` the unit normal in the world, basis index
//! `i = l² + l + m` and the Lambert kernel `k` (Zivanov et al. 2013). Radiance is not
//! clamped and casts no shadows.

use crate::color::ColorTransform;

/// Nine spherical-harmonics coefficients per colour channel, `[basis function][RGB]`.
pub type Light = [[f32; 3]; 9];

/// `½√(1/π)`, `½√(3/π)`, `½√(15/π)`, `¼√(5/π)`, `¼√(15/π)`.
const N: [f32; 5] = [0.282_094_8, 0.488_602_5, 1.092_548_4, 0.315_391_57, 0.546_274_2];

/// Lambert kernel per band, the six-decimal literals of the reference engine: π, 2π/3, π/4.
const K: [f32; 3] = [3.141593, 2.094395, 0.785398];

/// `k_i·N_i`: what multiplies the polynomial of basis function `i`.
pub(crate) const SCALE: [f32; 9] = [
    K[0] * N[0],
    K[1] * N[1],
    K[1] * N[1],
    K[1] * N[1],
    K[2] * N[2],
    K[2] * N[2],
    K[2] * N[3],
    K[2] * N[2],
    K[2] * N[4],
];

/// `k_i·Y_i(n)` of a unit normal: the light's coefficients times this is the radiance.
pub fn basis(normal: [f32; 3]) -> [f32; 9] {
    let [x, y, z] = normal;
    let p = [1.0, y, z, x, x * y, y * z, 2.0 * z * z - x * x - y * y, z * x, x * x - y * y];
    core::array::from_fn(|i| SCALE[i] * p[i])
}

/// Radiance at a unit normal (world frame).
pub fn radiance(light: &Light, normal: [f32; 3]) -> [f32; 3] {
    let y = basis(normal);
    core::array::from_fn(|c| (0..9).map(|i| y[i] * light[i][c]).sum())
}

/// Ambient and directional light: radiance `a + d·(direction·n)` per channel.
pub fn ambient_diffuse(ambient: [f32; 3], diffuse: [f32; 3], direction: [f32; 3]) -> Light {
    let [x, y, z] = direction;
    let mut light = [[0.0; 3]; 9];
    for c in 0..3 {
        light[0][c] = ambient[c] / SCALE[0];
        light[1][c] = diffuse[c] * y / SCALE[1];
        light[2][c] = diffuse[c] * z / SCALE[1];
        light[3][c] = diffuse[c] * x / SCALE[1];
    }
    light
}

/// White light of radiance one from everywhere.
pub fn ambient_white() -> Light {
    ambient_diffuse([1.0; 3], [0.0; 3], [0.0, 0.0, 1.0])
}

/// The light a fit starts from: radiance `0.8 + 0.2·n_z`.
pub fn frontal() -> Light {
    ambient_diffuse([0.8; 3], [0.2; 3], [0.0, 0.0, 1.0])
}

/// A light turned into the model's frame: one quadratic in the normal per channel.
///
/// `radiance_c(R·n) = e₀ + e₁x + e₂y + e₃z + e₄xy + e₅yz + e₆zx + e₇(x² − y²) + e₈(2z²−x²−y²)` for
/// a unit normal `n = (x, y, z)` in the *model's* frame: rotating the nine coefficients once
/// replaces rotating every normal.
#[derive(Clone, Copy, Debug)]
pub struct ModelLight {
    /// `[term][channel]`, in the order above.
    pub terms: [[f32; 3]; 9],
}

impl ModelLight {
    /// Turns a world light into the model's frame; `rotation` is the pose's, row-major.
    ///
    /// With `radiance = e + b·n_w + n_wᵀQ n_w` and `n_w = R n`: `b' = Rᵀb`, `Q' = RᵀQR`, and `Q'`
    /// stays trace-free, so nine terms suffice.
    pub fn new(light: &Light, rotation: &[[f32; 3]; 3]) -> Self {
        let r = rotation;
        let mut terms = [[0.0; 3]; 9];
        for c in 0..3 {
            let e: [f32; 9] = core::array::from_fn(|i| SCALE[i] * light[i][c]);
            let b = [e[3], e[1], e[2]];
            let q = [
                [e[8] - e[6], 0.5 * e[4], 0.5 * e[7]],
                [0.5 * e[4], -e[8] - e[6], 0.5 * e[5]],
                [0.5 * e[7], 0.5 * e[5], 2.0 * e[6]],
            ];
            let bm: [f32; 3] =
                core::array::from_fn(|j| r[0][j] * b[0] + r[1][j] * b[1] + r[2][j] * b[2]);
            let qr: [[f32; 3]; 3] = core::array::from_fn(|i| {
                core::array::from_fn(|j| q[i][0] * r[0][j] + q[i][1] * r[1][j] + q[i][2] * r[2][j])
            });
            let qm =
                |i: usize, j: usize| r[0][i] * qr[0][j] + r[1][i] * qr[1][j] + r[2][i] * qr[2][j];
            let column = [
                e[0],
                bm[0],
                bm[1],
                bm[2],
                2.0 * qm(0, 1),
                2.0 * qm(1, 2),
                2.0 * qm(0, 2),
                0.5 * (qm(0, 0) - qm(1, 1)),
                0.5 * qm(2, 2),
            ];
            for (term, value) in terms.iter_mut().zip(column) {
                term[c] = value;
            }
        }
        Self { terms }
    }

    /// Radiance at a unit normal of the model's frame.
    #[inline(always)]
    pub fn radiance(&self, [x, y, z]: [f32; 3]) -> [f32; 3] {
        let t = &self.terms;
        let d = x * x - y * y;
        let s = 2.0 * z * z - x * x - y * y;
        let mut radiance = [0.0; 3];
        for c in 0..3 {
            radiance[c] = t[0][c]
                + t[1][c] * x
                + t[2][c] * y
                + t[3][c] * z
                + t[4][c] * (x * y)
                + t[5][c] * (y * z)
                + t[6][c] * (z * x)
                + t[7][c] * d
                + t[8][c] * s;
        }
        radiance
    }
}

impl ModelLight {
    /// `Σ_c weight_c ∇ radiance_c` at a point of the model's frame; tangential and radial part.
    #[inline(always)]
    pub fn gradient(&self, [x, y, z]: [f32; 3], weights: [f32; 3]) -> [f32; 3] {
        let t = &self.terms;
        let mut gradient = [0.0; 3];
        for c in 0..3 {
            let k = weights[c];
            let (d, s) = (t[7][c], t[8][c]);
            gradient[0] += k * (t[1][c] + t[4][c] * y + t[6][c] * z + 2.0 * x * (d - s));
            gradient[1] += k * (t[2][c] + t[4][c] * x + t[5][c] * z - 2.0 * y * (d + s));
            gradient[2] += k * (t[3][c] + t[5][c] * y + t[6][c] * x + 4.0 * z * s);
        }
        gradient
    }
}

/// One visible surface point with what the picture shows there.
#[derive(Clone, Copy, Debug)]
pub struct LitPoint {
    /// Albedo, RGB.
    pub albedo: [f32; 3],
    /// Unit normal, world frame.
    pub normal: [f32; 3],
    /// Colour of the picture.
    pub target: [f32; 3],
}

/// Ridge of [`solve`], relative to the mean diagonal: a face turned to the side shows only half
/// of the sphere of normals, and without it the other half's light would run away. Chosen, not measured.
const RIDGE: f64 = 1e-4;

/// Closed-form light: the least-squares coefficients that explain the points' colours.
///
/// Undoes the colour transform, then solves per channel the 9×9 normal equations
/// `(AᵀA + ridge) L = Aᵀb` with rows `A_p = albedo_p·k∘Y(n_p)`. `None` with fewer
/// than nine points, a transform without inverse, or a singular system.
pub fn solve(points: impl IntoIterator<Item = LitPoint>, color: &ColorTransform) -> Option<Light> {
    use nalgebra::{SMatrix, SVector};
    let mut normal_matrix = [SMatrix::<f64, 9, 9>::zeros(); 3];
    let mut right = [SVector::<f64, 9>::zeros(); 3];
    let mut count = 0;
    for point in points {
        let y = basis(point.normal).map(f64::from);
        let b = color.invert(point.target)?;
        for c in 0..3 {
            let albedo = f64::from(point.albedo[c]);
            let row = y.map(|v| v * albedo);
            for j in 0..9 {
                for i in j..9 {
                    normal_matrix[c][(i, j)] += row[i] * row[j];
                }
                right[c][j] += row[j] * f64::from(b[c]);
            }
        }
        count += 1;
    }
    if count < 9 {
        return None;
    }
    let mut light = [[0.0; 3]; 9];
    for c in 0..3 {
        let ridge = RIDGE * normal_matrix[c].trace() / 9.0;
        for i in 0..9 {
            normal_matrix[c][(i, i)] += ridge;
        }
        // Only the lower triangle is read.
        let solution = normal_matrix[c].cholesky()?.solve(&right[c]);
        for i in 0..9 {
            light[i][c] = solution[i] as f32;
            if !light[i][c].is_finite() {
                return None;
            }
        }
    }
    Some(light)
}
