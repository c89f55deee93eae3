//! Colours of model and scan, more or less blurred, and the scan's albedo.

use super::options::Level;
use super::scan::{at, blur, slopes};
use super::state::{Problem, Registration, TINT, quad};
use crate::engine::Quad;
use crate::least_squares::{Equations, System, matrix_words, system_words};
use crate::vector::{add, scale, xyz};

/// Standard deviation of a scan's tint: of offsets in units of colour, of gains about 1. Wide, so that only
/// what colours do not say is held; chosen, not measured.
const TINT_SD: f32 = 0.3;
/// One vertex in so many tells the albedo: there are far more than coefficients.
const STRIDE: usize = 4;

impl Registration<'_, '_> {
    /// Goes to a level: blurs the colours.
    pub(super) fn enter(&mut self, level: &Level) {
        let Problem { scan, .. } = self.problem;
        for (to, color) in self.scan_colors.iter_mut().zip(scan.colors) {
            *to = *color;
        }
        let sums = self.passing.get_mut(..8 * scan.points.len()).unwrap_or_default();
        let sums: &mut [[Quad; 2]] = bytemuck::try_cast_slice_mut(sums).unwrap_or_default();
        blur(
            self.scan_colors,
            |t| scan.triangles.get(t).copied(),
            |v| scan.point(v),
            level.blur,
            sums,
        );
        self.paint(level.blur);
    }

    /// Computes the model's colours: its albedo and the tint, blurred; and how they change.
    pub(super) fn paint(&mut self, deviation: f32) {
        let Problem { model, engine, .. } = self.problem;
        (engine.instance)(&model.albedo, self.albedo_coefficients, self.albedo);
        let [r, g, b, gains @ ..] = self.tint;
        for (v, (color, albedo)) in self.colors.iter_mut().zip(&*self.albedo).enumerate() {
            let own = add(xyz(*albedo), [r, g, b]);
            let mean = model.albedo.mean_at(v);
            *color = [0, 1, 2].map(|c| own[c] + gains[c] * mean[c]);
        }
        let sums = self.passing.get_mut(..8 * self.colors.len()).unwrap_or_default();
        let sums: &mut [[Quad; 2]] = bytemuck::try_cast_slice_mut(sums).unwrap_or_default();
        let point = |v: u32| xyz(quad(self.positions, v));
        blur(self.colors, |t| model.triangles.get(t), point, deviation, sums);
        self.find_slopes();
    }

    /// Computes how the model's colours change along its surface: at a vertex the mean of the faces
    /// around it, each counted by its area.
    fn find_slopes(&mut self) {
        let Problem { model, .. } = self.problem;
        self.slopes.fill([[0.0; 3]; 3]);
        let areas = self.passing.get_mut(..self.slopes.len()).unwrap_or_default();
        let areas: &mut [f32] = bytemuck::try_cast_slice_mut(areas).unwrap_or_default();
        areas.fill(0.0);
        for corners in (0..).map_while(|t| model.triangles.get(t)) {
            let points = corners.map(|v| xyz(quad(self.positions, v)));
            let (slopes, area) = slopes(points, corners.map(|v| at(self.colors, v)));
            for v in corners {
                let v = v as usize;
                if let (Some(to), Some(sum)) = (self.slopes.get_mut(v), areas.get_mut(v)) {
                    *sum += area;
                    for (to, slope) in to.iter_mut().zip(slopes) {
                        *to = add(*to, scale(slope, area));
                    }
                }
            }
        }
        for (slopes, area) in self.slopes.iter_mut().zip(&*areas) {
            if *area > 0.0 {
                *slopes = slopes.map(|slope| scale(slope, 1.0 / (area * self.place.size)));
            }
        }
    }

    /// Finds albedo coefficients and tint of what the feet show.
    pub(super) fn find_albedo(&mut self) {
        let memory = core::mem::take(&mut self.passing);
        let _ = self.find_albedo_in(memory);
        self.passing = memory;
    }

    fn find_albedo_in(&mut self, memory: &mut [u32]) -> Option<()> {
        let Problem { model, options, engine, .. } = self.problem;
        let k = self.albedo_coefficients.len();
        let n = k + TINT;
        let memory: &mut [f32] = bytemuck::try_cast_slice_mut(memory).ok()?;
        let (equations, rest) = memory.split_at_mut_checked(system_words(n))?;
        let matrix = rest.get_mut(..matrix_words(n))?;
        let mut system = System::new(n, engine.normal_equations, equations)?;
        for i in 0..n {
            let sd = if i < k { options.width } else { TINT_SD };
            system.pull(i, 1.0 / (sd * sd), 0.0);
        }
        let weight = STRIDE as f32 * self.share
            / (options.albedo_sd * options.albedo_sd * options.albedo_patch);
        for (v, seen) in self.seen.iter().enumerate().take(model.vertices()).step_by(STRIDE) {
            let [.., sure] = *seen;
            if !(sure > 0.1) {
                continue;
            }
            let mean = model.albedo.mean_at(v);
            let unit = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            for row in &mut self.rows {
                row.get_mut(..n)?.fill(0.0);
            }
            let [r, g, b] = &mut self.rows;
            let leading = [r.get_mut(..k)?, g.get_mut(..k)?, b.get_mut(..k)?];
            (engine.rows)(&model.albedo, Some(&self.albedo_by_vertex), &[(v, unit)], leading);
            for (c, row) in self.rows.iter_mut().enumerate() {
                *row.get_mut(k + c)? = 1.0;
                *row.get_mut(k + 3 + c)? = mean.get(c).copied()?;
                let apart = seen.get(c)? - mean.get(c)?;
                system.add_row(row.get(..n)?, weight * sure, apart);
            }
        }
        let step = self.step.get_mut(..n)?;
        system.solve_damped(0.0, |_| 0.0, matrix, step)?;
        let (coefficients, tint) = step.split_at_checked(k)?;
        for (to, coefficient) in self.albedo_coefficients.iter_mut().zip(coefficients) {
            *to = *coefficient;
        }
        self.tint = *tint.first_chunk()?;
        Some(())
    }
}
