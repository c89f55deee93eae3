//! Textures look like the photos they are made of, and what photos do not show looks like what another
//! photo shows there.

use onescan::demo::template_model;
use onescan::fit::Fit;
use onescan::photo::Crop;
use onescan::photo::picture::Picture;
use onescan::texture::{Kind, Shot, bake, show};
use onescan::{mesh::skin::Skin, render};
use onescan_core::model::Model;
use onescan_core::scene::{Scene, View};
use onescan_tests::photos;
use onescan_tests::program::fixtures;

/// Photos of one person with fits to them.
struct Fitted {
    photos: Vec<(Picture, Crop)>,
    fits: Vec<Fit>,
}

impl Fitted {
    fn new(model: &Model<'_>, paths: &[&str]) -> Self {
        let photos: Vec<_> =
            paths.iter().map(|path| photos::read(&fixtures().join(path))).collect();
        let fits = photos::fit(model, &photos);
        let pictures = photos.into_iter().map(|(picture, _)| picture);
        Self { photos: pictures.zip(fits.iter().map(|fit| fit.crop)).collect(), fits }
    }

    fn scene(&self, number: usize) -> &Scene {
        &self.fits[number].best.scene
    }

    /// The skin by one of the photos, where nothing hides the face, over an albedo.
    fn skin(
        &self,
        model: &Model<'_>,
        number: usize,
        kind: Kind,
        hidden: Option<&Picture>,
        albedo: &[f32],
    ) -> Skin {
        let scene = self.scene(number);
        let mesh = render::instance(model, &scene.subject.shape, albedo);
        let (photo, crop) = &self.photos[number];
        let shot = Shot {
            photo,
            crop: *crop,
            mask: self.fits[number].mode.as_ref().map(|mode| &mode.mask[..]),
            hidden,
            view: &scene.view,
        };
        bake(model, &scene.subject, &mesh, &[shot], kind).unwrap()
    }

    /// Root mean square difference of the skin from what a photo shows of the face, where `wanted` says
    /// so of a point of the model.
    fn difference(
        &self,
        model: &Model<'_>,
        number: usize,
        skin: &Skin,
        wanted: impl Fn([f32; 3]) -> bool,
    ) -> f64 {
        let (photo, crop) = &self.photos[number];
        let scene = self.scene(number);
        let shown = render::smooth(scene, |scene, _| Ok(show(model, scene, skin, [0; 3]))).unwrap();
        let seen = crop.cut(photo).unwrap();
        let depth = render::inverse_distances(model, scene);
        let mask = &self.fits[number].mode.as_ref().unwrap().mask;
        let width = seen.width as usize;
        let (mut sum, mut count) = (0.0, 0);
        for (i, &inverse) in depth.iter().enumerate() {
            // At the outline pixels are mixed with what is behind.
            let around = [i, i.wrapping_sub(1), i + 1, i.wrapping_sub(width), i + width];
            let inside = around.iter().all(|&j| depth.get(j).is_some_and(|&inverse| inverse > 0.0));
            let at = || point(&scene.view, [i % width, i / width], 1.0 / inverse);
            if inside && mask[i] >= 0.5 && wanted(at()) {
                for (a, b) in shown.rgb[i].iter().zip(seen.rgb[i]) {
                    sum += (f64::from(a.abs_diff(b)) / 255.0).powi(2) / 3.0;
                }
                count += 1;
            }
        }
        assert!(count > 1000, "{count} pixels");
        (sum / f64::from(count)).sqrt()
    }

    /// Black where the first photo shows the half of the face that is x > 0, white elsewhere.
    fn half(&self, model: &Model<'_>) -> Picture {
        let ((photo, crop), scene) = (&self.photos[0], self.scene(0));
        let depth = render::inverse_distances(model, scene);
        let width = crop.scaled_to[0] as usize;
        Picture::from_fn(photo.width, photo.height, |x, y| {
            let [x, y] = crop.to_crop([x, y].map(f64::from)).map(|t| t.round().max(0.0) as usize);
            let inverse = if x < width { depth.get(y * width + x) } else { None };
            let inverse = inverse.filter(|inverse| **inverse > 0.0);
            let hidden = inverse.is_some_and(|d| point(&scene.view, [x, y], 1.0 / d)[0] > 0.0);
            if hidden { [0; 3] } else { [255; 3] }
        })
    }
}

/// What a view has at a pixel, at this distance, as a point of the model.
fn point(view: &View, [x, y]: [usize; 2], distance: f32) -> [f32; 3] {
    let pixel = view.camera.pixel_scale();
    let world = [
        (x as f32 - pixel.centre[0]) / pixel.focal[0] * distance,
        (pixel.centre[1] - y as f32) / pixel.focal[1] * distance,
        -distance,
    ];
    let (r, t) = (view.pose.rotation(), view.pose.translation);
    let moved: [f32; 3] = std::array::from_fn(|k| (world[k] - t[k]) / view.pose.scale);
    std::array::from_fn(|k| (0..3).map(|i| r[i][k] * moved[i]).sum())
}

#[test]
fn a_textured_face_looks_like_its_photo_and_a_hidden_half_like_the_other() {
    let built = template_model(60, &mut |_, _| ()).unwrap();
    let model = built.model.view();
    for path in ["photos/astronaut.png", "photos/grace_hopper.jpg", "photos/obama.jpg"] {
        let fitted = Fitted::new(&model, &[path]);
        let albedo = &fitted.scene(0).subject.albedo;
        let half = fitted.half(&model);
        let skin = |kind, hidden| fitted.skin(&model, 0, kind, hidden, albedo);
        let seen = fitted.difference(&model, 0, &skin(Kind::Photo, None), |_| true);
        assert!(seen < 0.03, "{path}: {seen}");
        let [mirrored, plain] = [Kind::Photo, Kind::None]
            .map(|kind| fitted.difference(&model, 0, &skin(kind, Some(&half)), |[x, ..]| x > 8.0));
        println!("{path}: seen {seen:.4}; hidden, mirrored {mirrored:.4}, albedo {plain:.4}");
        assert!(mirrored > 1.2 * seen, "{path}: the half was not hidden, {mirrored} {seen}");
        // Details that are not where they are on the other half count twice: no better than albedo.
        assert!(mirrored < 1.1 * plain, "{path}: {mirrored} {plain}");
    }
}

#[test]
fn what_a_photo_does_not_show_looks_like_what_another_shows_there() {
    let built = template_model(100, &mut |_, _| ()).unwrap();
    let model = built.model.view();
    for person in ["05", "23", "41"] {
        let paths = ["45", "00"].map(|yaw| format!("rough/{person}_{yaw}.jpg"));
        let fitted = Fitted::new(&model, &paths.each_ref().map(|path| &path[..]));
        // Shape by both, colours by the one alone.
        let alone = Fitted::new(&model, &[&paths[0]]);
        let albedo = &alone.scene(0).subject.albedo;
        let side = fitted.scene(0);
        let depth = render::inverse_distances(&model, side);
        let hidden = |point: [f32; 3]| {
            let (u, v, d) = side.view.camera.project(side.view.pose.to_world(point));
            let (x, y) = ((u + 0.5) as usize, (v + 0.5) as usize);
            let drawn = depth[y * side.view.camera.image_size[0] as usize + x];
            d > 1.0 / drawn + 4.0
        };
        let [baked, plain] = [Kind::Albedo, Kind::None].map(|kind| {
            let skin = fitted.skin(&model, 0, kind, None, albedo);
            fitted.difference(&model, 1, &skin, hidden)
        });
        println!("{person}: hidden from the side, baked {baked:.4}, albedo {plain:.4}");
        assert!(baked < 0.03, "{person}: {baked}");
    }
}
