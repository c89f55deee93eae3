//! Render parameters of the reference engine: `.rps` files. All versions of its JSON are read,
//! V4.0 is written.

mod old;

use crate::error::{Error, Result};
use crate::files::read_text;
use crate::fit::summary::check_scene;
use crate::json;
use onescan_core::color::ColorTransform;
use onescan_core::light::{self, Light, ModelLight};
use onescan_core::scene::{Camera, Coefficients, MAX_RANK, Pose, Scene, Subject, View};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Contents of an `.rps` file.
#[derive(Clone, Debug, PartialEq)]
pub struct Rps {
    /// The scene.
    pub scene: Scene,
    /// Where the model of the coefficients is; may be empty.
    pub model_uri: String,
}

/// Version written.
const VERSION: &str = "V4.0";

impl Rps {
    /// Reads a file.
    ///
    /// # Errors
    /// As [`Rps::parse`], naming the file; a file that cannot be read.
    pub fn read(path: &Path) -> Result<Self> {
        let text = read_text(path)?;
        Self::parse(&text).map_err(|e| Error::file(path, e))
    }

    /// Parses the JSON of versions V1.0 to V4.0; unknown fields are ignored.
    ///
    /// A camera that is itself posed (`view` not neutral) is folded into the object's pose and
    /// the light, which shows the same picture. Light beyond the second order is dropped, as the
    /// reference engine's shader does.
    ///
    /// # Errors
    /// A later version, damaged JSON, and what a [`Scene`] cannot hold: an orthographic camera, no
    /// environment map, expressions, more than [`MAX_RANK`] coefficients.
    pub fn parse(text: &str) -> Result<Self> {
        let Versioned { version } = json::parse(text)?;
        let file: File = match version.as_str() {
            VERSION => json::parse(text)?,
            "V3.0" => json::parse::<old::V3>(text)?.into_v4()?,
            "V2.0" => json::parse::<old::V2>(text)?.into_v4()?,
            "" | "legacy" | "V1.0" => json::parse::<old::V1>(text)?.into_v4(),
            other => {
                return Err(Error::new(format_args!(
                    "version: render parameters {other:?} are not read, only V1.0 to {VERSION}; \
                     scalismo-faces writes {VERSION}"
                )));
            }
        };
        let scene = file.scene()?;
        check_scene(&scene)?;
        Ok(Self { scene: file.view.fold(scene), model_uri: file.momo.model_uri })
    }

    /// The file's text: V4.0, neutral view, all light in the environment map.
    ///
    /// # Errors
    /// A number that is not finite, naming the field.
    pub fn to_text(&self) -> Result<String> {
        let Scene { subject: Subject { shape, albedo }, view } = &self.scene;
        let View { pose, camera, light, color } = view;
        json::to_text(&File {
            pose: PoseJson {
                scaling: pose.scale,
                translation: pose.translation,
                roll: pose.roll,
                yaw: pose.yaw,
                pitch: pose.pitch,
            },
            view: Eye::default(),
            camera: CameraJson {
                focal_length: camera.focal_length,
                principal_point: camera.principal_point,
                sensor_size: camera.sensor,
                near: camera.near,
                far: camera.far,
                orthographic: false,
            },
            environment_map: EnvironmentMap {
                coefficients: light.to_vec(),
                kind: "SphericalHarmonicsLight",
            },
            directional_light: DirectionalLight::default(),
            momo: Momo {
                shape: shape.to_vec(),
                color: albedo.to_vec(),
                expression: Vec::new(),
                model_uri: self.model_uri.clone(),
            },
            image_size: ImageSize { height: camera.image_size[1], width: camera.image_size[0] },
            color_transform: ColorJson {
                gain: color.gain,
                color_contrast: color.contrast,
                offset: color.offset,
            },
            version: VERSION.to_owned(),
        })
    }
}

/// What tells the versions apart; files before V2.0 have no such field.
#[derive(Deserialize)]
struct Versioned {
    #[serde(default)]
    version: String,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct File {
    pose: PoseJson,
    view: Eye,
    camera: CameraJson,
    environment_map: EnvironmentMap,
    #[serde(skip_deserializing)]
    directional_light: DirectionalLight,
    momo: Momo,
    image_size: ImageSize,
    color_transform: ColorJson,
    version: String,
}

#[derive(Serialize, Deserialize)]
struct PoseJson {
    scaling: f32,
    translation: [f32; 3],
    roll: f32,
    yaw: f32,
    pitch: f32,
}

/// Pose of the camera: `X_eye = R⁻¹(X_world − t)`.
#[derive(Default, PartialEq, Serialize, Deserialize)]
struct Eye {
    translation: [f32; 3],
    roll: f32,
    yaw: f32,
    pitch: f32,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct CameraJson {
    focal_length: f32,
    principal_point: [f32; 2],
    sensor_size: [f32; 2],
    near: f32,
    far: f32,
    orthographic: bool,
}

#[derive(Serialize, Deserialize)]
struct EnvironmentMap {
    /// Same order as [`Light`]: `i = l² + l + m`.
    coefficients: Vec<[f32; 3]>,
    #[serde(rename = "@type", skip_deserializing)]
    kind: &'static str,
}

/// Written as off, ignored on reading: the reference engine uses it only without environment map.
#[derive(Serialize)]
struct DirectionalLight {
    ambient: [f32; 3],
    diffuse: [f32; 3],
    direction: [f32; 3],
    specular: [f32; 3],
    shininess: f32,
    #[serde(rename = "@type")]
    kind: &'static str,
}

impl Default for DirectionalLight {
    fn default() -> Self {
        Self {
            ambient: [0.0; 3],
            diffuse: [0.0; 3],
            direction: [0.0, 0.0, 1.0],
            specular: [0.0; 3],
            shininess: 10.0,
            kind: "DirectionalLight",
        }
    }
}

#[derive(Serialize, Deserialize)]
struct Momo {
    shape: Vec<f32>,
    color: Vec<f32>,
    expression: Vec<f32>,
    #[serde(rename = "modelURI")]
    model_uri: String,
}

#[derive(Serialize, Deserialize)]
struct ImageSize {
    height: u32,
    width: u32,
}

#[derive(Serialize, Deserialize)]
#[serde(rename_all = "camelCase")]
struct ColorJson {
    gain: [f32; 3],
    /// Called `gamma` in V1 files, but it never was one.
    color_contrast: f32,
    offset: [f32; 3],
}

impl File {
    /// The scene without the view.
    fn scene(&self) -> Result<Scene> {
        if self.camera.orthographic {
            return Err(Error::new(
                "camera.orthographic: only perspective cameras are drawn; use a long focal length",
            ));
        }
        if self.momo.expression.iter().any(|&c| c != 0.0) {
            return Err(Error::new(
                "momo.expression: models here have no expressions; set these coefficients to 0",
            ));
        }
        let coefficients = |name: &str, values: &[f32]| {
            Coefficients::from_slice(values).map_err(|_| {
                Error::new(format_args!(
                    "momo.{name}: {} coefficients, at most {MAX_RANK} are carried; cut the list",
                    values.len()
                ))
            })
        };
        let PoseJson { scaling: scale, translation, roll, yaw, pitch } = self.pose;
        let view = View {
            pose: Pose { scale, translation, roll, yaw, pitch },
            camera: Camera {
                focal_length: self.camera.focal_length,
                sensor: self.camera.sensor_size,
                principal_point: self.camera.principal_point,
                near: self.camera.near,
                far: self.camera.far,
                image_size: [self.image_size.width, self.image_size.height],
            },
            light: self.light()?,
            color: ColorTransform {
                gain: self.color_transform.gain,
                contrast: self.color_transform.color_contrast,
                offset: self.color_transform.offset,
            },
        };
        let subject = Subject {
            shape: coefficients("shape", &self.momo.shape)?,
            albedo: coefficients("color", &self.momo.color)?,
        };
        Ok(Scene { subject, view })
    }

    fn light(&self) -> Result<Light> {
        let given = &self.environment_map.coefficients;
        if given.is_empty() || given.len().isqrt().pow(2) != given.len() {
            return Err(Error::new(format_args!(
                "environmentMap.coefficients: {} of them, expected 1, 4, 9 or another square \
                 (a directional light is not read)",
                given.len()
            )));
        }
        let mut light = Light::default();
        light.iter_mut().zip(given).for_each(|(to, from)| *to = *from);
        Ok(light)
    }
}

impl Eye {
    /// Makes the eye the origin of the world, where a [`Scene`] has it.
    ///
    /// With `R_v, t_v` of the view, `X_eye = R_vᵀ(R·sX + t − t_v)`: the pose becomes
    /// `R' = R_vᵀR`, `t' = R_vᵀ(t − t_v)`, and since the light stays where it was in the old
    /// world, `L'(n) = L(R_v n)`.
    fn fold(&self, scene: Scene) -> Scene {
        if *self == Self::default() {
            return scene;
        }
        let Self { translation, roll, yaw, pitch } = *self;
        let eye = Pose { scale: 1.0, translation, roll, yaw, pitch }.rotation();
        let turned = |v: [f32; 3]| -> [f32; 3] {
            std::array::from_fn(|i| eye[0][i] * v[0] + eye[1][i] * v[1] + eye[2][i] * v[2])
        };
        let Scene { subject, view } = scene;
        let pose = view.pose.rotation();
        let columns: [[f32; 3]; 3] =
            std::array::from_fn(|j| turned([pose[0][j], pose[1][j], pose[2][j]]));
        let rotation = std::array::from_fn(|i| std::array::from_fn(|j| columns[j][i]));
        let (roll, yaw, pitch) = Pose::euler(&rotation);
        let t = std::array::from_fn(|i| view.pose.translation[i] - self.translation[i]);
        let view = View {
            pose: Pose { translation: turned(t), roll, yaw, pitch, ..view.pose },
            light: turned_light(&view.light, &eye),
            ..view
        };
        Scene { subject, view }
    }
}

/// The light `L'` with `L'(n) = L(Rn)`.
fn turned_light(light: &Light, rotation: &[[f32; 3]; 3]) -> Light {
    // Per coefficient: its term in `ModelLight`, and a direction where its polynomial is `value`,
    // to divide the basis function's factor out again.
    const TERMS: [(usize, [f32; 3], f32); 9] = [
        (0, [0.0, 0.0, 1.0], 1.0),
        (2, [0.0, 1.0, 0.0], 1.0),
        (3, [0.0, 0.0, 1.0], 1.0),
        (1, [1.0, 0.0, 0.0], 1.0),
        (4, [1.0, 1.0, 0.0], 1.0),
        (5, [0.0, 1.0, 1.0], 1.0),
        (8, [0.0, 0.0, 1.0], 2.0),
        (6, [1.0, 0.0, 1.0], 1.0),
        (7, [1.0, 0.0, 0.0], 1.0),
    ];
    let terms = ModelLight::new(light, rotation).terms;
    std::array::from_fn(|i| {
        let (term, direction, value) = TERMS[i];
        let factor = light::basis(direction)[i] / value;
        terms[term].map(|t| t / factor)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::turned;
    use proptest::prelude::*;

    fn example() -> Rps {
        let mut scene = Scene::initial(640, 480, 2, 1);
        scene.view.pose =
            Pose { scale: 1.1, translation: [5.0, -7.0, -900.0], roll: 0.1, yaw: 0.3, pitch: -0.2 };
        scene.view.light = std::array::from_fn(|i| [0.1 * i as f32, 0.3, -0.05 * i as f32]);
        scene.view.color =
            ColorTransform { gain: [1.1, 0.9, 1.0], contrast: 0.8, offset: [0.01; 3] };
        scene.subject.shape[0] = -1.5;
        Rps { scene, model_uri: "face.3dmm".into() }
    }

    #[test]
    fn what_is_written_reads_back_to_the_last_bit() {
        let text = example().to_text().unwrap();
        assert_eq!(Rps::parse(&text).unwrap(), example());
    }

    #[test]
    fn files_have_the_fields_the_reference_engine_requires() {
        let text = example().to_text().unwrap();
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        for field in [
            "/pose/scaling",
            "/view/translation/2",
            "/camera/focalLength",
            "/camera/principalPoint/1",
            "/camera/sensorSize/1",
            "/camera/orthographic",
            "/environmentMap/coefficients/8/2",
            "/directionalLight/shininess",
            "/momo/shape/1",
            "/momo/expression",
            "/momo/modelURI",
            "/imageSize/width",
            "/colorTransform/colorContrast",
        ] {
            assert!(value.pointer(field).is_some(), "{field}");
        }
        assert_eq!(value["version"], "V4.0");
    }

    /// The engine's own example file; set `ONESCAN_INTEROP` to the folder that has it.
    #[test]
    fn the_engines_file_is_read_with_its_posed_camera() {
        let folder = std::env::var_os("ONESCAN_INTEROP").map_or_else(
            || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data/interop"),
            Into::into,
        );
        let path = folder.join("renderParametersV4.rps");
        if !path.exists() {
            eprintln!("skipped: {} is not there", path.display());
            return;
        }
        let Rps { scene, model_uri } = Rps::read(&path).unwrap();
        assert_eq!(model_uri, "modelPath1");
        assert_eq!(scene.subject.shape[..], [-1.0, 0.5, -0.25]);
        assert_eq!(scene.subject.albedo[..], [1.0, 0.0, 0.5]);
        assert_eq!(scene.view.camera.image_size, [720, 480]);
        // A model point goes where world pose and camera pose together take it.
        let world = Pose { roll: 0.125, yaw: -0.125, pitch: 0.25, ..Pose::AWAY_1M }
            .to_world([40., 30., 9.]);
        let view = Pose { roll: -0.125, yaw: 1.5, pitch: 0.75, ..Pose::AWAY_1M }.rotation();
        let eye = scene.view.pose.to_world([40.0, 30.0, 9.0]);
        let t = [10.0, 20.0, 2000.0];
        for (i, w) in world.into_iter().enumerate() {
            let back = (0..3).map(|j| view[i][j] * eye[j]).sum::<f32>() + t[i];
            assert!((back - w).abs() < 1e-3, "{back} {w}");
        }
        let newest = Rps { scene, model_uri };
        for version in ["V1", "V2", "V3"] {
            let old = Rps::read(&folder.join(format!("renderParameters{version}.rps"))).unwrap();
            assert_eq!(old, newest, "{version}");
        }
    }

    #[test]
    fn what_a_scene_cannot_hold_is_refused_by_field() {
        let text = example().to_text().unwrap();
        let error = |from: &str, to: &str| {
            assert!(text.contains(from), "{from}");
            Rps::parse(&text.replacen(from, to, 1)).unwrap_err().to_string()
        };
        assert!(error("\"orthographic\": false", "\"orthographic\": true").contains("perspective"));
        assert!(error("\"expression\": []", "\"expression\": [0, 1]").contains("momo.expression"));
        assert!(error("\"coefficients\": [", "\"coefficients\": [[1,1,1],").contains("10 of them"));
        let many = format!("\"shape\": [{}", "0,".repeat(200));
        assert!(error("\"shape\": [", &many).contains("momo.shape: 202"));
        let scale = error("\"scaling\": 1.1", "\"scaling\": 1e40");
        assert!(scale.contains("pose.scaling: number out of range"), "{scale}");
        assert!(error("\"yaw\"", "\"jaw\"").starts_with("pose: missing field `yaw`"));
        assert!(error("V4.0", "V9.9").contains("V9.9"));
        assert!(Rps::parse("[]").is_err() && Rps::parse("").is_err());
    }

    proptest! {
        #[test]
        fn turning_light_and_normals_together_changes_nothing(
            light: [[i8; 3]; 9], angles in [-3.0..3.0_f32, -3.0..3.0_f32, -3.0..3.0_f32],
        ) {
            let light = light.map(|c| c.map(|v| f32::from(v) / 64.0));
            let [roll, yaw, pitch] = angles;
            let r = Pose { roll, yaw, pitch, ..Pose::AWAY_1M }.rotation();
            let n = [2.0 / 7.0, -3.0 / 7.0, 6.0 / 7.0];
            let rn = turned(&r, n);
            let turned = light::radiance(&turned_light(&light, &r), n);
            for (a, b) in turned.into_iter().zip(light::radiance(&light, rn)) {
                prop_assert!((a - b).abs() < 1e-4, "{a} {b}");
            }
        }

        #[test]
        fn any_numbers_survive(numbers: [f32; 4]) {
            let mut rps = example();
            rps.scene.view.pose.yaw = numbers[0];
            rps.scene.view.color.offset = [numbers[1], numbers[2], numbers[3]];
            let finite = numbers.iter().all(|n| n.is_finite());
            match rps.to_text() {
                Ok(text) => prop_assert_eq!(Rps::parse(&text).unwrap(), rps),
                Err(_) => prop_assert!(!finite),
            }
        }

        #[test]
        fn damaged_text_never_panics(at in 0_usize..2000, byte: u8) {
            let mut text = example().to_text().unwrap().into_bytes();
            let at = at % text.len();
            text[at] = byte;
            let _ = Rps::parse(&String::from_utf8_lossy(&text));
        }
    }
}
