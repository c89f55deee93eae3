//! Golden values of the reference engine's conventions (camera, light, colour, likelihoods).

use onescan_core::color::{ColorTransform, color_matrix};
use onescan_core::light;
use onescan_core::likelihood::pixels::ln_normaliser;
use onescan_core::likelihood::{LN_2PI, ln_normal};
use onescan_core::scene::{Camera, Pose};

fn close(found: f32, expected: f64, tolerance: f64) {
    assert!((f64::from(found) - expected).abs() <= tolerance, "{found} is not {expected}");
}

fn camera_512() -> Camera {
    Camera::for_image(512, 512)
}

fn project(pose: &Pose, camera: &Camera, p: [f32; 3]) -> (f32, f32, f32) {
    camera.project(pose.to_world(p))
}

#[test]
fn default_square_camera() {
    let camera = camera_512();
    let (u, v, d) = project(&Pose::AWAY_1M, &camera, [0.0; 3]);
    close(u, 256.0, 0.0);
    close(v, 256.0, 0.0);
    close(camera.window_depth(d), 0.990_009_900_1, 1e-7);
    let (u, v, d) = project(&Pose::AWAY_1M, &camera, [40.0, 30.0, 90.0]);
    close(u, 340.395_604_395_6, 1e-4);
    close(v, 192.703_296_703_3, 1e-4);
    close(camera.window_depth(d), 0.989_020_879_2, 1e-7);
}

#[test]
fn principal_point_is_in_device_coordinates() {
    let right = Camera { principal_point: [0.2, 0.0], ..camera_512() };
    let (u, v, _) = project(&Pose::AWAY_1M, &right, [0.0; 3]);
    close(u, 307.2, 1e-4);
    close(v, 256.0, 1e-4);
    let up = Camera { principal_point: [0.0, 0.2], ..camera_512() };
    let (u, v, _) = project(&Pose::AWAY_1M, &up, [0.0; 3]);
    close(u, 256.0, 1e-4);
    close(v, 204.8, 1e-4);
}

#[test]
fn posed_camera() {
    let pose =
        Pose { scale: 1.1, translation: [5.0, -7.0, -900.0], roll: 0.1, yaw: 0.3, pitch: -0.2 };
    let camera = Camera {
        sensor: [8.0 / 3.0, 2.0],
        principal_point: [0.05, -0.1],
        ..Camera::for_image(640, 480)
    };
    let world = pose.to_world([40.0, 30.0, 90.0]);
    close(world[0], 68.234_718_458, 1e-4);
    close(world[1], 51.616_252_838_1, 1e-4);
    close(world[2], -826.573_121_161_1, 2e-4);
    let (u, v, _) = camera.project(world);
    close(u, 484.592_412_250_6, 2e-4);
    close(v, 151.597_088_874_9, 2e-4);
}

#[test]
fn film_camera() {
    let camera = Camera { focal_length: 50.0, sensor: [36.0, 24.0], ..Camera::for_image(720, 480) };
    let (u, v, _) = project(&Pose::AWAY_1M, &camera, [40.0, 30.0, 90.0]);
    close(u, 403.956_043_956, 1e-4);
    close(v, 207.032_967_033, 1e-4);
}

#[test]
fn camera_keeps_pixels_square() {
    let sensor = Camera::for_image(640, 480).sensor;
    close(sensor[0], 2.666_666_666_7, 1e-6);
    close(sensor[1], 2.0, 0.0);
    assert_eq!(Camera::for_image(250, 250).sensor, [2.0, 2.0]);
}

#[test]
fn euler_angles_of_a_large_yaw() {
    let pose = Pose { yaw: 2.0, ..Pose::AWAY_1M };
    let (roll, yaw, pitch) = Pose::euler(&pose.rotation());
    close(roll.abs(), std::f64::consts::PI, 1e-6);
    close(yaw, 1.141_592_653_6, 1e-6);
    close(pitch.abs(), std::f64::consts::PI, 1e-6);
}

#[test]
fn spherical_harmonics_basis() {
    let expected = [
        0.886_227_023_2,
        0.682_217_771_9,
        0.682_217_771_9,
        0.341_108_886,
        0.190_685_633_8,
        0.381_371_267_7,
        0.082_569_301_5,
        0.190_685_633_8,
        -0.143_014_225_4,
    ];
    let found = light::basis([1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0]);
    for (found, expected) in found.into_iter().zip(expected) {
        close(found, expected, 1e-7);
    }
}

#[test]
fn named_lights() {
    close(light::ambient_white()[0][0], 1.128_379_042_673_902_2, 1e-6);
    let frontal = light::frontal();
    close(frontal[0][1], 0.902_703_234_139_121_8, 1e-6);
    close(frontal[2][2], 0.195_441_014_316_113, 1e-7);
    for radiance in light::radiance(&frontal, [1.0 / 3.0, 2.0 / 3.0, 2.0 / 3.0]) {
        close(radiance, 0.933_333_333_3, 1e-6);
    }
}

#[test]
fn light_in_the_models_frame_is_the_same_light() {
    let light: light::Light =
        std::array::from_fn(|i| std::array::from_fn(|c| ((7 * i + 3 * c) as f32 * 0.7).sin()));
    let pose = Pose { roll: 0.4, yaw: -0.9, pitch: 0.3, ..Pose::AWAY_1M };
    let r = pose.rotation();
    let turned = light::ModelLight::new(&light, &r);
    for n in [[0.6, 0.0, 0.8], [0.0, -1.0, 0.0], [0.48, 0.6, -0.64]] {
        let world: [f32; 3] = std::array::from_fn(|i| (0..3).map(|j| r[i][j] * n[j]).sum::<f32>());
        for (a, b) in light::radiance(&light, world).into_iter().zip(turned.radiance(n)) {
            close(a, f64::from(b), 2e-6);
        }
    }
}

#[test]
fn light_is_recovered_from_what_it_lights() {
    let truth: light::Light =
        std::array::from_fn(|i| std::array::from_fn(|c| ((5 * i + c) as f32).cos() * 0.3));
    let color = ColorTransform { gain: [1.1, 0.9, 1.0], contrast: 0.8, offset: [0.01, 0.0, 0.03] };
    let points = (0..400).map(|k| {
        let (z, a) = (k as f32 / 200.0 - 0.9975, k as f32 * 2.4);
        let s = (1.0 - z * z).sqrt();
        let normal = [s * a.cos(), s * a.sin(), z];
        let albedo = [0.7, 0.5 + 0.1 * a.sin(), 0.4];
        let r = light::radiance(&truth, normal);
        let target = color.apply(std::array::from_fn(|c| albedo[c] * r[c]));
        light::LitPoint { albedo, normal, target }
    });
    let found = light::solve(points, &color).unwrap();
    for (f, t) in found.iter().flatten().zip(truth.iter().flatten()) {
        // The ridge pulls by about 1e-4 of the coefficients.
        close(*f, f64::from(*t), 2e-3);
    }
    assert!(light::solve([], &color).is_none());
}

#[test]
fn color_transform() {
    let color =
        ColorTransform { gain: [1.1, 0.9, 1.0], contrast: 0.8, offset: [0.01, 0.02, -0.03] };
    let out = color.apply([0.6, 0.4, 0.2]);
    for (found, expected) in out.into_iter().zip([0.63436, 0.38684, 0.2176]) {
        close(found, expected, 1e-6);
    }
    for (found, expected) in color.invert(out).unwrap().into_iter().zip([0.6, 0.4, 0.2]) {
        close(found, expected, 1e-6);
    }
    assert!(ColorTransform { contrast: 0.0, ..color }.invert(out).is_none());
    let m = color_matrix(&color);
    for c in 0..3 {
        let linear = m[c][0] * 0.6 + m[c][1] * 0.4 + m[c][2] * 0.2 + color.offset[c];
        close(linear, f64::from(out[c]), 1e-6);
    }
}

#[test]
fn likelihood_terms() {
    let landmark = -LN_2PI - 2.0 * 4.0_f64.ln() - 25.0 / 32.0;
    assert!((landmark - -5.391_715_788_649_126).abs() < 1e-12);
    let sd = f64::from(0.043_f32);
    assert!((ln_normaliser(sd) - 6.682_849_788_369_349).abs() < 1e-9);
    assert!((ln_normal(0.3, 0.0, 0.1) - (-3.116_353_440_210_627)).abs() < 1e-12);
}
