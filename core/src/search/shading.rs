//! One pixel's colour and its derivatives, by reverse differentiation.
//!
//! `c = M·(a ∘ ρ(n)) + o` with `n = ñ/‖ñ‖`, where `ñ = Σ bᵢnᵢ` and `a = Σ bᵢaᵢ` are interpolated
//! between the corners. Given `γ = ∂E/∂c`, with `τ = Mᵀγ`:
//!
//! * `∂E/∂a = τ ∘ ρ`, `∂E/∂ρ = τ ∘ a`;
//! * `∂E/∂n = Σ_c (∂E/∂ρ_c) ∇ρ_c(n)`, `∂E/∂ñ = (I − n nᵀ) ∂E/∂n / ‖ñ‖`;
//! * light, gain, contrast and offset enter linearly.
//!
//! How colours follow the motion of the surface in the window: `gradient.rs`.

use super::unknowns::COLOR;
use crate::color::{ColorTransform, LUMINANCE, color_matrix};
use crate::light::{self, ModelLight};
use crate::math;
use crate::scene::View;
use crate::vector::{Vec3, add, apply, apply_transposed, dot, scale, sub, times};

/// Light and colour transform of a view.
pub(super) struct Shading {
    light: ModelLight,
    mix: [Vec3; 3],
    color: ColorTransform,
    rotation: [Vec3; 3],
}

/// A visible point of the surface: its corners' attributes and its colour.
#[derive(Clone, Copy)]
pub(super) struct Point {
    /// Weights of the corners.
    pub(super) weights: Vec3,
    /// Normals of the corners.
    pub(super) normals: [Vec3; 3],
    normal: Vec3,
    inverse_length: f32,
    albedo: Vec3,
    radiance: Vec3,
    /// The colour, not clamped.
    pub(super) color: Vec3,
}

/// What a colour's change costs, passed back to what the colour is made of.
#[derive(Clone, Copy)]
pub(super) struct Adjoint {
    /// Of the interpolated normal before it is normalised, model frame.
    pub(super) normal: Vec3,
    /// Of the interpolated albedo.
    pub(super) albedo: Vec3,
    /// Of the radiance: times [`Adjoint::harmonics`], of the light's coefficients.
    pub(super) radiance: Vec3,
    /// `k∘Y` of the normal.
    pub(super) harmonics: [f32; 9],
    /// Of gain, contrast and offset.
    pub(super) color: [f32; COLOR],
}

impl Shading {
    pub(super) fn new(view: &View) -> Self {
        let rotation = view.pose.rotation();
        Self {
            light: ModelLight::new(&view.light, &rotation),
            mix: color_matrix(&view.color),
            color: view.color,
            rotation,
        }
    }

    /// The point with these weights between three corners' normals and albedos.
    #[inline(always)]
    pub(super) fn point(&self, weights: Vec3, normals: [Vec3; 3], albedos: [Vec3; 3]) -> Point {
        let blend = |v: [Vec3; 3]| {
            let [a, b, c] = v;
            add(add(scale(a, weights[0]), scale(b, weights[1])), scale(c, weights[2]))
        };
        let (n, albedo) = (blend(normals), blend(albedos));
        let inverse_length = math::rsqrt(dot(n, n));
        let normal = scale(n, inverse_length);
        let radiance = self.light.radiance(normal);
        let color = add(apply(&self.mix, times(albedo, radiance)), self.color.offset);
        Point { weights, normals, normal, inverse_length, albedo, radiance, color }
    }

    /// Cosine of a point's normal and the direction from which it is seen, or nearly so.
    #[inline(always)]
    pub(super) fn facing(&self, point: &Point) -> f32 {
        dot(self.rotation[2], point.normal)
    }

    /// Passes `∂E/∂c` back.
    #[inline(always)]
    pub(super) fn adjoint(&self, point: &Point, gradient: Vec3) -> Adjoint {
        let mixed = apply_transposed(&self.mix, gradient);
        let radiance = times(mixed, point.albedo);
        let n = point.normal;
        let by_normal = self.light.gradient(n, radiance);
        let across = sub(by_normal, scale(n, dot(n, by_normal)));
        let lit = times(point.albedo, point.radiance);
        let luminance = dot(lit, LUMINANCE);
        let contrast = self.color.contrast;
        let grey = (1.0 - contrast) * luminance;
        let mut color = [0.0; COLOR];
        for c in 0..3 {
            color[c] = gradient[c] * (contrast * lit[c] + grey);
            color[3] += gradient[c] * self.color.gain[c] * (lit[c] - luminance);
            color[4 + c] = gradient[c];
        }
        Adjoint {
            normal: scale(across, point.inverse_length),
            albedo: times(mixed, point.radiance),
            radiance,
            harmonics: light::basis(apply(&self.rotation, n)),
            color,
        }
    }
}
