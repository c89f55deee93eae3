//! Coordinates in which a ridge of the posterior is straight.
//!
//! A picture tells the product of light and albedo: brighter skin in dimmer light looks alike. In light
//! and albedo that ridge is bent; so around a mode the light's coordinates are, in place of `L`,
//!
//! `M_kc = ā_c g_c/(ā_c g_c)_mode · L_kc`
//!
//! of channel `c`, with its mean albedo `ā`, linear in the coefficients, and its gain `g`. The change
//! of variables has the Jacobian `|∂L/∂M| = Π_c ((ā_c g_c)_mode/(ā_c g_c))⁹`.

use super::unknowns::{LIGHT, Layout};
use crate::basis::Basis;
use crate::math;
use crate::memory::Carver;
use crate::scene::View;

/// Coefficients of a light per channel.
const HARMONICS: usize = LIGHT / 3;

/// Words of memory a [`Chart`] needs.
pub(super) const fn chart_words(albedo_rank: usize) -> usize {
    3 * albedo_rank
}

/// What the charts of all views share.
pub(super) struct Chart<'w> {
    /// Mean albedo of the model's mean, and of each component, `[channel][component]`.
    mean: [f32; 3],
    components: [&'w mut [f32]; 3],
}

/// A view's chart, which begins at the mode.
#[derive(Clone, Copy)]
pub(super) struct Origin {
    view: View,
    /// `ā`.
    albedo: [f32; 3],
}

impl<'w> Chart<'w> {
    /// Of a model's albedo, so many components of it; `None` if there is too little memory.
    /// `ones` has room for as many vertices as the model has.
    pub(super) fn carve(
        carver: &mut Carver<'w>,
        albedo: &Basis<'_>,
        rank: usize,
        ones: &mut [[f32; 4]],
    ) -> Option<Self> {
        let vertices = albedo.mean().len() / 3;
        let share = 1.0 / vertices.max(1) as f32;
        let mut mean = [0.0; 3];
        for v in 0..vertices {
            for (mean, value) in mean.iter_mut().zip(albedo.mean_at(v)) {
                *mean += share * value;
            }
        }
        let mut components = [carver.floats(rank)?, carver.floats(rank)?, carver.floats(rank)?];
        for (channel, components) in components.iter_mut().enumerate() {
            let mut one = [0.0; 4];
            *one.get_mut(channel)? = share;
            ones.fill([0.0; 4]);
            ones.get_mut(..vertices)?.fill(one);
            components.fill(0.0);
            albedo.transposed(ones, components);
        }
        Some(Self { mean, components })
    }

    /// `ā` of albedo coefficients.
    pub(super) fn albedo(&self, coefficients: &[f32]) -> [f32; 3] {
        let mut albedo = self.mean;
        for (albedo, components) in albedo.iter_mut().zip(&self.components) {
            *albedo += components.iter().zip(coefficients).map(|(a, b)| a * b).sum::<f32>();
        }
        albedo
    }

    /// Passes what the unknowns of a view cost, or a row of the matrix, on to the chart's. `volume` is
    /// 1 if the Jacobian's logarithm counts as well, else 0.
    pub(super) fn pull(
        &self,
        costs: &mut [f32],
        layout: Layout,
        number: usize,
        origin: &Origin,
        (view, albedo): (&View, [f32; 3]),
        volume: f32,
    ) {
        let Some(parts) = layout.split(costs, number) else { return };
        let bright = origin.bright(view, albedo);
        for c in 0..3 {
            let product = |(light, cost): (&[f32; 3], &[f32; 3])| light[c] * cost[c];
            let along = view.light.iter().zip(&*parts.light).map(product).sum::<f32>();
            let brighter = -(along + volume * HARMONICS as f32);
            for (cost, component) in parts.albedo.iter_mut().zip(&*self.components[c]) {
                *cost += component * brighter / albedo[c];
            }
            parts.color[c] += brighter / view.color.gain[c];
            for cost in &mut *parts.light {
                cost[c] /= bright[c];
            }
        }
    }
}

impl Origin {
    /// At a mode.
    pub(super) fn new(view: View, albedo: [f32; 3]) -> Self {
        Self { view, albedo }
    }

    /// `ā_c g_c` as a multiple of the mode's.
    fn bright(&self, view: &View, albedo: [f32; 3]) -> [f32; 3] {
        core::array::from_fn(|c| {
            albedo[c] * view.color.gain[c] / (self.albedo[c] * self.view.color.gain[c])
        })
    }

    /// The view a step of the chart away from the mode, where the mean albedo is that, and the
    /// logarithm of the Jacobian; `None` where something is not positive.
    pub(super) fn view(
        &self,
        layout: Layout,
        number: usize,
        step: &mut [f32],
        albedo: [f32; 3],
    ) -> Option<(View, f64)> {
        let parts = layout.split(step, number)?;
        let mut light = self.view.light;
        for (light, step) in light.as_flattened_mut().iter_mut().zip(parts.light.as_flattened()) {
            *light += step;
        }
        let mut view = self.view;
        parts.advance_view(&mut view);
        let bright = self.bright(&view, albedo);
        let mut volume = 0.0;
        for c in 0..3 {
            if !(bright[c] > 0.0) {
                return None;
            }
            volume -= HARMONICS as f64 * math::ln(f64::from(bright[c]));
            for light in &mut light {
                light[c] /= bright[c];
            }
        }
        view.light = light;
        Some((view, volume))
    }
}
