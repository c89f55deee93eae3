//! What a photo says of a surface: colours, and how far each may be believed.

use super::canvas::between;
use crate::error::Result;
use crate::photo::Crop;
use crate::photo::picture::Picture;
use crate::render;
use crate::vector::{dot, length, turned};
use onescan_core::color::ColorTransform;
use onescan_core::light::ModelLight;
use onescan_core::model::Model;
use onescan_core::scene::{Scene, Subject, View};

/// A photo with a fit to it.
#[derive(Clone, Copy)]
pub struct Shot<'a> {
    /// The whole photo.
    pub photo: &'a Picture,
    /// The part of it that the fit looked at.
    pub crop: Crop,
    /// How far each pixel of that part shows the object, in `[0, 1]`; `None`: wherever it is drawn.
    pub mask: Option<&'a [f32]>,
    /// A picture of the whole photo's size, black where something hides the object.
    pub hidden: Option<&'a Picture>,
    /// Pose, camera, light and colours in that part.
    pub view: &'a View,
}

/// Longest side of the picture that colours are taken of, pixels.
pub(super) const MOST: u32 = 2048;

/// How near to an outline, to what hides the object and to its border a photo is not believed, and from
/// where on wholly; shares of the longer side of what the fit looked at, of which a face is about a half.
/// A fit's outline is right to a pixel or two of 256. Chosen, not measured, as are the next.
const OUTLINE: [f32; 2] = [0.006, 0.026];
/// The same about what is before the object; its border is found pixel by pixel.
const BEFORE: [f32; 2] = [0.002, 0.016];
/// The same where the object hides itself: colours of both sides are its own.
const FOLD: [f32; 2] = [0.0, 0.003];
/// Cosines between which a surface that is seen from the side is not believed and wholly.
const GRAZING: [f32; 2] = [0.1, 0.35];
/// What is that much farther than what is drawn is behind it, and a step between pixels so high is an
/// outline; shares of the object's size.
const BEHIND: f32 = 0.015;
/// Light is taken for at least so much of the mean: colours are divided by it.
const DIM: f32 = 0.3;

/// What a shot says of any point of the surface.
pub(super) struct Seen {
    picture: Vec<[f32; 3]>,
    size: [usize; 2],
    /// Inverse distance of what is drawn at each pixel, 0 nothing.
    depth: Vec<f32>,
    /// How far each pixel is believed.
    belief: Vec<f32>,
    view: View,
    rotation: [[f32; 3]; 3],
    lamp: Lamp,
    /// Millimetres.
    behind: f32,
}

impl Seen {
    /// Looks at a photo; `normals` are the surface's, `size` how large the object is, millimetres.
    ///
    /// # Errors
    /// A crop that does not fit its photo.
    pub(super) fn new(
        model: &Model<'_>,
        subject: &Subject,
        shot: &Shot<'_>,
        normals: &[[f32; 3]],
        object: f32,
    ) -> Result<Self> {
        let longer = shot.crop.size[0].max(shot.crop.size[1]).max(1);
        let own = shot.crop.scaled_to[0].max(shot.crop.scaled_to[1]);
        // The photo's own pixels, but no fewer than the fit had and no more than a texture shows.
        let side = longer.clamp(own.min(MOST), MOST);
        let scale = |s: u32| {
            ((u64::from(s) * u64::from(side) + u64::from(own) / 2) / u64::from(own.max(1))).max(1)
        };
        let crop = Crop { scaled_to: shot.crop.scaled_to.map(|s| scale(s) as u32), ..shot.crop };
        let mut view = *shot.view;
        view.camera = render::resampled_camera(&view.camera, crop.scaled_to);
        let scene = Scene { subject: subject.clone(), view };
        let size = crop.scaled_to.map(|s| s as usize);
        let mut seen = Self {
            picture: crop.cut(shot.photo)?.to_unit(),
            size,
            depth: render::inverse_distances(model, &scene),
            belief: Vec::new(),
            rotation: view.pose.rotation(),
            lamp: Lamp::new(&view, normals),
            view,
            behind: BEHIND * object * view.pose.scale,
        };
        let hidden = shot.hidden.map(|hidden| crop.cut(hidden)).transpose()?;
        seen.belief = seen.believed(shot, hidden.as_ref());
        Ok(seen)
    }

    /// The light of the shot.
    pub(super) fn lamp(&self) -> &Lamp {
        &self.lamp
    }

    /// Albedo as the photo shows it at a point with this unit normal, both in the model's frame, and how
    /// far it is to be believed.
    pub(super) fn look(&self, point: [f32; 3], normal: [f32; 3]) -> [f32; 4] {
        let world = self.view.pose.to_world_by(&self.rotation, point);
        let (u, v, d) = self.view.camera.project(world);
        let [w, h] = self.size.map(|side| side as f32);
        if !(d > self.view.camera.near && u >= 0.0 && v >= 0.0 && u <= w - 1.0 && v <= h - 1.0) {
            return [0.0; 4];
        }
        let cosine = -dot(turned(&self.rotation, normal), world) / length(world);
        let drawn = self.depth[(v + 0.5) as usize * self.size[0] + (u + 0.5) as usize];
        let hidden = !(drawn > 0.0 && d < 1.0 / drawn + self.behind);
        let facing = step(GRAZING, cosine);
        if hidden || facing == 0.0 {
            return [0.0; 4];
        }
        let [r, g, b, belief] = between(self.size, [u, v], &|i| {
            let [r, g, b] = self.picture[i];
            [r, g, b, self.belief[i]]
        });
        match self.lamp.albedo([r, g, b], normal) {
            Some([r, g, b]) if belief > 0.0 => [r, g, b, belief * facing],
            _ => [0.0; 4],
        }
    }

    /// Belief by the distance to the nearest pixel that does not show the object, or is at an outline.
    fn believed(&self, shot: &Shot<'_>, hidden: Option<&Picture>) -> Vec<f32> {
        let [width, height] = self.size;
        let foreign = self.foreign(shot);
        let distance = |i: usize| 1.0 / self.depth[i];
        let outline = |i: usize, j: usize| !((distance(i) - distance(j)).abs() < self.behind);
        // Where the object ends, where something else is before it, and where it hides itself.
        let mut far = [(); 3].map(|()| vec![f32::MAX; width * height]);
        for y in 0..height {
            for x in 0..width {
                let i = y * width + x;
                let beside = x > 0 && outline(i, i - 1) || y > 0 && outline(i, i - width);
                let beside = beside || x + 1 < width && outline(i, i + 1);
                let beside = beside || y + 1 < height && outline(i, i + width);
                let hidden = hidden.is_some_and(|hidden| hidden.rgb[i][1] < 128);
                for (far, none) in
                    far.iter_mut().zip([self.depth[i] == 0.0, hidden || foreign[i], beside])
                {
                    if none {
                        far[i] = 0.0;
                    }
                }
            }
        }
        for far in &mut far {
            spread(far, width);
        }
        let side = width.max(height) as f32;
        let belief = |i: usize| {
            let parts = [OUTLINE, BEFORE, FOLD].into_iter().zip(&far);
            parts.map(|(range, far)| step(range, far[i] / side)).product()
        };
        (0..width * height).map(belief).collect()
    }

    /// Which pixels show something else: those that the mask takes for that, but for islands of them within
    /// the object. These are its own, though the model does not have them: teeth, folds, make-up.
    fn foreign(&self, shot: &Shot<'_>) -> Vec<bool> {
        let [width, height] = self.size;
        let [across, down] = shot.crop.scaled_to.map(|side| side as usize);
        let masked = |i: usize| {
            let (x, y) = (i % width * across / width, i / width * down / height);
            shot.mask.is_some_and(|mask| !(mask.get(y * across + x) >= Some(&0.5)))
        };
        let mut foreign: Vec<bool> = self.depth.iter().map(|&depth| depth == 0.0).collect();
        let mut open: Vec<usize> = (0..foreign.len()).filter(|&i| foreign[i]).collect();
        // What is at the picture's border may go on beyond it.
        let border = |i: usize| {
            let (x, y) = (i % width, i / width);
            x == 0 || y == 0 || x + 1 == width || y + 1 == height
        };
        open.extend((0..foreign.len()).filter(|&i| border(i) && masked(i)));
        for &i in &open {
            foreign[i] = true;
        }
        while let Some(i) = open.pop() {
            let beside = [
                (i % width > 0).then(|| i - 1),
                (i % width + 1 < width).then_some(i + 1),
                i.checked_sub(width),
                (i + width < foreign.len()).then_some(i + width),
            ];
            for j in beside.into_iter().flatten() {
                if !foreign[j] && masked(j) {
                    foreign[j] = true;
                    open.push(j);
                }
            }
        }
        foreign.iter().zip(&self.depth).map(|(foreign, depth)| *foreign && *depth > 0.0).collect()
    }
}

/// Replaces every number by the least sum of a number of the picture and the distance to it, along the
/// eight directions.
fn spread(far: &mut [f32], width: usize) {
    let height = far.len() / width.max(1);
    let diagonal = 2.0_f32.sqrt();
    let mut relax = |x: usize, y: usize, side: isize| {
        let mut best = far[y * width + x];
        for (dx, dy, length) in [(-1, 0, 1.0), (0, -1, 1.0), (-1, -1, diagonal), (1, -1, diagonal)]
        {
            let at = (x.checked_add_signed(side * dx), y.checked_add_signed(side * dy));
            if let (Some(x), Some(y)) = at
                && x < width
                && y < height
            {
                best = best.min(far[y * width + x] + length);
            }
        }
        far[y * width + x] = best;
    };
    for y in 0..height {
        for x in 0..width {
            relax(x, y, 1);
        }
    }
    for y in (0..height).rev() {
        for x in (0..width).rev() {
            relax(x, y, -1);
        }
    }
}

/// From 0 to 1 between two numbers, without a corner at either.
fn step([from, to]: [f32; 2], x: f32) -> f32 {
    let t = ((x - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Light and colours of a view, in the model's frame, there and back.
pub(super) struct Lamp {
    light: ModelLight,
    color: ColorTransform,
    least: [f32; 3],
}

impl Lamp {
    fn new(view: &View, normals: &[[f32; 3]]) -> Self {
        let light = ModelLight::new(&view.light, &view.pose.rotation());
        let mut sum = [0.0_f32; 3];
        for &normal in normals {
            let radiance = light.radiance(normal);
            sum = std::array::from_fn(|c| sum[c] + radiance[c].max(0.0));
        }
        let least = sum.map(|sum| (DIM * sum / normals.len().max(1) as f32).max(1e-3));
        Self { light, color: view.color, least }
    }

    fn radiance(&self, normal: [f32; 3]) -> [f32; 3] {
        let radiance = self.light.radiance(normal);
        std::array::from_fn(|c| radiance[c].max(self.least[c]))
    }

    /// The colour of a surface in the photo.
    pub(super) fn color(&self, albedo: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        let radiance = self.radiance(normal);
        self.color.apply(std::array::from_fn(|c| albedo[c] * radiance[c]))
    }

    /// The albedo that gives such a colour; `None` where the camera has left nothing of it.
    fn albedo(&self, color: [f32; 3], normal: [f32; 3]) -> Option<[f32; 3]> {
        let (lit, radiance) = (self.color.invert(color)?, self.radiance(normal));
        let albedo: [f32; 3] = std::array::from_fn(|c| lit[c] / radiance[c]);
        albedo.iter().all(|a| a.is_finite()).then_some(albedo)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn islands_of_the_mask_are_the_objects_own_and_bays_are_not() {
        // The object fills the middle; X is masked, in a bay from above and on an island.
        let rows = [
            "........", ".oXXooo.", ".ooXooo.", ".oooooo.", ".ooXXoo.", ".oooooo.", ".oooooo.",
            "........",
        ];
        let pixels = || rows.iter().flat_map(|row| row.bytes());
        let mask: Vec<f32> = pixels().map(|pixel| if pixel == b'o' { 0.9 } else { 0.2 }).collect();
        let view = View::initial(8, 8);
        let seen = Seen {
            picture: vec![[0.5; 3]; 64],
            size: [8, 8],
            depth: pixels().map(|pixel| if pixel == b'.' { 0.0 } else { 0.001 }).collect(),
            belief: Vec::new(),
            rotation: view.pose.rotation(),
            lamp: Lamp::new(&view, &[[0.0, 0.0, 1.0]]),
            behind: 1.0,
            view,
        };
        let photo = Picture::filled(8, 8, [9; 3]);
        let crop = Crop::whole([8, 8]);
        let shot = Shot { photo: &photo, crop, mask: Some(&mask), hidden: None, view: &view };
        let foreign: Vec<usize> =
            seen.foreign(&shot).iter().enumerate().filter_map(|(i, f)| f.then_some(i)).collect();
        assert_eq!(foreign, [10, 11, 19]);
    }

    #[test]
    fn distances_spread_to_all_sides() {
        let mut far = vec![f32::MAX; 35];
        far[2 * 7 + 3] = 0.0;
        spread(&mut far, 7);
        assert_eq!((far[2 * 7], far[2 * 7 + 6], far[3], far[4 * 7 + 3]), (3.0, 3.0, 2.0, 2.0));
        assert!((far[0] - (1.0 + 2.0 * 2.0_f32.sqrt())).abs() < 1e-6);
    }

    #[test]
    fn light_is_taken_away_and_put_back() {
        let mut view = View::initial(8, 8);
        view.color.gain = [0.9, 1.1, 1.3];
        view.color.contrast = 0.8;
        let lamp = Lamp::new(&view, &[[0.0, 0.0, 1.0]]);
        for normal in [[0.0, 0.0, 1.0], [0.6, 0.0, -0.8]] {
            let albedo = lamp.albedo([0.3, 0.7, 0.2], normal).unwrap();
            for (a, b) in lamp.color(albedo, normal).iter().zip([0.3, 0.7, 0.2]) {
                assert!((a - b).abs() < 1e-6);
            }
        }
        view.color.contrast = 0.0;
        assert_eq!(Lamp::new(&view, &[]).albedo([0.5; 3], [0.0, 0.0, 1.0]), None);
    }
}
