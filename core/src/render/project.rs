//! Model positions to window coordinates.

use crate::scene::View;

/// Vertices handled together; the loop over them has no branches and vectorises.
const BATCH: usize = 8;

/// Adding and subtracting this rounds a number below 16384 to a multiple of 1/256.
///
/// On that grid the differences of coordinates of a small triangle are exact in f32 and so are
/// its edge functions, so neighbouring triangles agree about every pixel on their common edge:
/// no cracks, without integer rasterization.
const SNAP: f32 = 49_152.0;

/// Fills `window` with `[u, v, 1/d, 0]` per vertex of `positions` (`[x, y, z, 0]`): window pixels on a 1/256 grid, and the inverse
/// distance. `u` and `v` are NaN for vertices nearer than the near plane: no triangle with such a
/// corner passes for a front face, so nothing else has to look at the near plane.
#[inline(always)]
pub fn project(view: &View, positions: &[[f32; 4]], window: &mut [[f32; 4]]) {
    let r = view.pose.rotation();
    let s = view.pose.scale;
    let t = view.pose.translation;
    let near = view.camera.near;
    let pixel = view.camera.pixel_scale();
    let m: [[f32; 3]; 3] = r.map(|row| row.map(|v| v * s));
    let batches = positions.as_chunks::<BATCH>().0;
    for (out, p) in window.as_chunks_mut::<BATCH>().0.iter_mut().zip(batches) {
        let mut u = [0.0_f32; BATCH];
        let mut v = [0.0_f32; BATCH];
        let mut inverse = [0.0_f32; BATCH];
        for l in 0..BATCH {
            let [x, y, z, _] = p[l];
            let xw = m[0][0] * x + m[0][1] * y + m[0][2] * z + t[0];
            let yw = m[1][0] * x + m[1][1] * y + m[1][2] * z + t[1];
            let d = -(m[2][0] * x + m[2][1] * y + m[2][2] * z + t[2]);
            let i = 1.0 / d;
            // Not a branch: NaN added before the near plane, 0 behind it.
            let visible = if d > near { 0.0 } else { f32::NAN };
            u[l] = (pixel.focal[0] * xw * i + pixel.centre[0] + SNAP) - SNAP + visible;
            v[l] = (pixel.centre[1] - pixel.focal[1] * yw * i + SNAP) - SNAP + visible;
            inverse[l] = i;
        }
        for l in 0..BATCH {
            out[l] = [u[l], v[l], inverse[l], 0.0];
        }
    }
}
