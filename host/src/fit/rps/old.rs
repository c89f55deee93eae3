//! Versions V1.0 to V3.0 of render parameters, as V4.0 says the same.

use super::{
    CameraJson, ColorJson, DirectionalLight, EnvironmentMap, Eye, File, ImageSize, Momo, PoseJson,
    VERSION,
};
use crate::error::{Error, Result};
use serde::Deserialize;

/// Coefficient `i` of the light is V1.0's number `V1_LIGHT[i]`: x before y, and `2z²−x²−y²` first
/// of its band.
const V1_LIGHT: [usize; 9] = [0, 2, 3, 1, 7, 5, 4, 6, 8];

/// Light and model have other names than in V4.0 and say what they are.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct V3 {
    pose: PoseJson,
    view: Eye,
    camera: CameraJson,
    illumination: Illumination,
    render_object: RenderObject,
    image_size: ImageSize,
    color_transform: ColorJson,
}

/// The camera has its pose within it and its principal point in pixels.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct V2 {
    pose: PoseJson,
    camera: PosedCamera,
    illumination: Illumination,
    render_object: RenderObject,
    image: ImageSize,
    color: ColorJson,
}

/// Before there was a version: sensor sizes are times the near plane's distance.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct V1 {
    pose: PoseJson,
    camera: PosedCamera,
    spherical_harmonics_light: Vec<[f32; 3]>,
    morphable_model: MorphableModel,
    /// Height, width.
    image: [u32; 2],
    color: Gamma,
}

#[derive(Deserialize)]
struct Illumination {
    #[serde(rename = "@type", default)]
    kind: String,
    #[serde(default)]
    coefficients: Vec<[f32; 3]>,
}

#[derive(Deserialize)]
struct RenderObject {
    #[serde(rename = "@type", default)]
    kind: String,
    #[serde(default)]
    shape: Vec<f32>,
    #[serde(default)]
    color: Vec<f32>,
    #[serde(default)]
    expression: Vec<f32>,
    #[serde(rename = "modelURI", default)]
    model_uri: String,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct PosedCamera {
    far: f32,
    near: f32,
    focal_length: f32,
    orthographic: bool,
    /// Pixels; misspelt in V1.0.
    #[serde(alias = "principlePoint")]
    principal_point: [f64; 2],
    sensor_size: [f32; 2],
    #[serde(flatten)]
    view: Eye,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct MorphableModel {
    color_coefficients: Vec<f32>,
    shape_coefficients: Vec<f32>,
    #[serde(rename = "modelURI", default)]
    model_uri: String,
}

#[derive(Deserialize)]
struct Gamma {
    gain: [f32; 3],
    #[serde(rename = "gamma")]
    contrast: f32,
    offset: [f32; 3],
}

impl V3 {
    pub(super) fn into_v4(self) -> Result<File> {
        Ok(File {
            pose: self.pose,
            view: self.view,
            camera: self.camera,
            environment_map: self.illumination.environment_map()?,
            directional_light: DirectionalLight::default(),
            momo: self.render_object.momo()?,
            image_size: self.image_size,
            color_transform: self.color_transform,
            version: VERSION.into(),
        })
    }
}

impl V2 {
    pub(super) fn into_v4(self) -> Result<File> {
        let (camera, view) = self.camera.apart(&self.image);
        Ok(File {
            pose: self.pose,
            view,
            camera,
            environment_map: self.illumination.environment_map()?,
            directional_light: DirectionalLight::default(),
            momo: self.render_object.momo()?,
            image_size: self.image,
            color_transform: self.color,
            version: VERSION.into(),
        })
    }
}

impl V1 {
    pub(super) fn into_v4(self) -> File {
        let [height, width] = self.image;
        let image_size = ImageSize { height, width };
        let near = self.camera.near;
        let (mut camera, view) = self.camera.apart(&image_size);
        camera.sensor_size = camera.sensor_size.map(|side| side / near);
        let file = &self.spherical_harmonics_light;
        // A list that is no square stays one, and is refused later.
        let coefficient = |i: usize| file.get(*V1_LIGHT.get(i).unwrap_or(&i)).copied();
        let coefficients = (0..file.len()).map(|i| coefficient(i).unwrap_or(file[i])).collect();
        File {
            pose: self.pose,
            view,
            camera,
            environment_map: EnvironmentMap { coefficients, kind: "" },
            directional_light: DirectionalLight::default(),
            momo: Momo {
                shape: self.morphable_model.shape_coefficients,
                color: self.morphable_model.color_coefficients,
                expression: Vec::new(),
                model_uri: self.morphable_model.model_uri,
            },
            image_size,
            color_transform: ColorJson {
                gain: self.color.gain,
                color_contrast: self.color.contrast,
                offset: self.color.offset,
            },
            version: VERSION.into(),
        }
    }
}

impl Illumination {
    fn environment_map(self) -> Result<EnvironmentMap> {
        if !["", "SphericalHarmonicsLight"].contains(&self.kind.as_str()) {
            return Err(Error::new(format_args!(
                "illumination: {}, only SphericalHarmonicsLight is drawn",
                self.kind
            )));
        }
        Ok(EnvironmentMap { coefficients: self.coefficients, kind: "" })
    }
}

impl RenderObject {
    fn momo(self) -> Result<Momo> {
        let Self { kind, shape, color, expression, model_uri } = self;
        if !["", "MoMoInstance", "MoMoExpressInstance"].contains(&kind.as_str()) {
            return Err(Error::new(format_args!(
                "renderObject: {kind}, only instances of morphable models are drawn"
            )));
        }
        Ok(Momo { shape, color, expression, model_uri })
    }
}

impl PosedCamera {
    /// The camera, its principal point in the picture's coordinates, and its pose.
    fn apart(self, image: &ImageSize) -> (CameraJson, Eye) {
        let [x, y] = self.principal_point;
        let principal_point =
            [2.0 * x / f64::from(image.width), 2.0 * y / f64::from(image.height)].map(|c| c as f32);
        let camera = CameraJson {
            focal_length: self.focal_length,
            principal_point,
            sensor_size: self.sensor_size,
            near: self.near,
            far: self.far,
            orthographic: self.orthographic,
        };
        (camera, self.view)
    }
}

#[cfg(test)]
mod tests {
    use crate::fit::rps::Rps;
    use serde_json::{Value, json};

    /// Version V1.0 with a light that has all coefficients.
    fn first() -> Value {
        let light: Vec<[f32; 3]> = (0..9).map(|i| [i as f32, 0.0, 0.0]).collect();
        json!({
            "pose": {"scaling": 1, "translation": [0, 0, -1000], "roll": 0, "yaw": 0, "pitch": 0},
            "camera": {
                "focalLength": 50, "principlePoint": [8, 0], "sensorSize": [72, 48], "near": 2,
                "far": 1000, "orthographic": false, "skewFactor": 1, "translation": [0, 0, 0],
                "roll": 0, "yaw": 0, "pitch": 0,
            },
            "color": {"gain": [1, 1, 1], "gamma": 0.5, "offset": [0, 0, 0]},
            "image": [80, 160],
            "morphableModel": {"shapeCoefficients": [], "colorCoefficients": [1], "modelURI": ""},
            "sphericalHarmonicsLight": light,
        })
    }

    #[test]
    fn the_first_version_has_its_own_order_and_units() {
        let scene = Rps::parse(&first().to_string()).unwrap().scene;
        assert_eq!(scene.view.light.map(|c| c[0]), [0.0, 2.0, 3.0, 1.0, 7.0, 5.0, 4.0, 6.0, 8.0]);
        assert_eq!(scene.view.camera.sensor, [36.0, 24.0]);
        assert_eq!(scene.view.camera.image_size, [160, 80]);
        assert_eq!(scene.view.camera.principal_point, [0.1, 0.0]);
        assert_eq!(scene.view.color.contrast, 0.5);
    }

    #[test]
    fn what_old_versions_lack_is_named() {
        let error = |path: &str, value: Value| {
            let mut file = first();
            *file.pointer_mut(path).unwrap() = value;
            Rps::parse(&file.to_string()).unwrap_err().to_string()
        };
        assert!(error("/camera", json!({})).starts_with("camera"));
        assert!(error("/camera/near", json!(0)).contains("sensor"));
        assert!(error("/image", json!([0, 0])).contains("principal_point"));
        assert!(error("/sphericalHarmonicsLight", json!([])).contains("0 of them"));
        assert!(error("/sphericalHarmonicsLight", json!([[1, 1, 1], [1, 1, 1]])).contains("2 of"));
    }
}
