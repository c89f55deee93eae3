//! The document of a glTF file, checked: what the crate `gltf` takes for granted, and what it
//! refuses although it is valid.

use crate::error::{Error, Result};
use crate::scan::mesh_file::unmarked;
use ::gltf::Document;
use ::gltf::binary::Glb;
use ::gltf::json::validation::{Error as Fault, Validate};
use ::gltf::json::{self, Root};
use serde_json::{Map, Value};

/// Extensions a file may require: those that do not change positions or albedo, and those that
/// are read.
const EXTENSIONS: [&str; 13] = [
    "KHR_lights_punctual",
    "KHR_materials_clearcoat",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants",
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
];

/// Parses container and document; also the container's bytes.
///
/// # Errors
/// Malformed or of another version, extensions that are required and not read, indices out of range.
pub(super) fn open(bytes: &[u8]) -> Result<(Document, Option<Vec<u8>>)> {
    let bytes = unmarked(bytes);
    let (text, blob) = if bytes.starts_with(b"glTF") {
        let word = |at: usize| {
            let word = bytes.get(at..).and_then(<[u8]>::first_chunk);
            word.map_or(0, |word| u32::from_le_bytes(*word))
        };
        if word(4) == 1 {
            return Err(old("1"));
        }
        let length = word(8) as usize;
        if length < 12 || length > bytes.len() {
            return Err(Error::new(format_args!(
                "header: {length} bytes promised, {} there; the file is cut short or damaged, \
                 export it again",
                bytes.len()
            )));
        }
        let Glb { json, bin, .. } = Glb::from_slice(bytes).map_err(|_| {
            Error::new("its chunks do not fit together; the file is damaged, export it again")
        })?;
        (json, bin.map(std::borrow::Cow::into_owned))
    } else if bytes.trim_ascii_start().starts_with(b"{") {
        (bytes.into(), None)
    } else {
        return Err(Error::new("not a glTF file; export the scan again"));
    };
    let mut value: Value = serde_json::from_slice(&text).map_err(|e| {
        Error::new(format_args!(
            "line {}, column {}: not JSON; the file is damaged, export it again",
            e.line(),
            e.column()
        ))
    })?;
    let version = value["asset"]["version"].as_str().unwrap_or_default();
    if !version.starts_with("2.") {
        return Err(old(version));
    }
    without_unread(&mut value);
    if let Some(name) = packed(&value) {
        return Err(unsupported(name));
    }
    let mut root: Root = serde_path_to_error::deserialize(value).map_err(|e| {
        Error::new(format_args!("{}: not what glTF 2.0 has there; export the scan again", e.path()))
    })?;
    for name in std::mem::take(&mut root.extensions_required) {
        if !EXTENSIONS.contains(&name.as_str()) {
            return Err(unsupported(&name));
        }
    }
    check(&root)?;
    Ok((Document::from_json_without_validation(root), blob))
}

fn old(version: &str) -> Error {
    Error::new(format_args!(
        "glTF of version {version:?}, only 2.0 is read; convert it (gltf-pipeline, Blender)"
    ))
}

/// Drops what is not read, and adds what may be left out.
fn without_unread(document: &mut Value) {
    if let Some(fields) = document.as_object_mut() {
        fields.remove("animations");
        fields.remove("cameras");
    }
    let mut each = |list: &str, change: fn(&mut Map<String, Value>)| {
        let items = document.get_mut(list).and_then(Value::as_array_mut);
        items.into_iter().flatten().filter_map(Value::as_object_mut).for_each(change);
    };
    each("nodes", |node| drop(node.remove("camera")));
    each("scenes", |scene| {
        scene.entry("nodes").or_insert_with(|| Value::Array(Vec::new()));
    });
}

/// The compression of a primitive that is not there uncompressed as well.
fn packed(document: &Value) -> Option<&'static str> {
    const DRACO: &str = "KHR_draco_mesh_compression";
    let meshes = document["meshes"].as_array().into_iter().flatten();
    let mut primitives =
        meshes.flat_map(|mesh| mesh["primitives"].as_array().into_iter().flatten());
    let bare = |primitive: &Value| {
        let accessor =
            primitive["attributes"]["POSITION"].as_u64().and_then(|i| usize::try_from(i).ok());
        accessor.is_some_and(|i| document["accessors"][i]["bufferView"].is_null())
    };
    let packed = |primitive: &Value| !primitive["extensions"][DRACO].is_null() && bare(primitive);
    primitives.any(packed).then_some(DRACO)
}

/// Checks that all indices are in range and everything is there.
fn check(root: &Root) -> Result<()> {
    let accessors = root.accessors.len();
    let attributes = root.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let attributes = attributes.flat_map(|p| p.attributes.values()).map(json::Index::value);
    // The crate's own check takes this for granted.
    if let Some(attribute) = attributes.max().filter(|attribute| *attribute >= accessors) {
        return Err(Error::new(format_args!(
            "accessor {attribute} is out of range, there are {accessors}; the file is damaged, \
             export it again"
        )));
    }
    let mut found = None;
    root.validate(root, json::Path::new, &mut |path, fault| {
        let path = path().to_string();
        // Without a view, an accessor's numbers are zero.
        let zeros = fault == Fault::Missing
            && path.starts_with("accessors[")
            && path.ends_with(".bufferView");
        if !zeros {
            found.get_or_insert((path, fault));
        }
    });
    let Some((path, fault)) = found else { return Ok(()) };
    let what = match fault {
        Fault::IndexOutOfBounds => "is out of range",
        Fault::Invalid => "is not what glTF 2.0 has there",
        Fault::Missing => "is missing",
        Fault::Oversize => "is too large",
        Fault::Unsupported => "is not read",
    };
    Err(Error::new(format_args!("{path} {what}; not a good glTF 2.0 file, export it again")))
}

fn unsupported(extension: &str) -> Error {
    let mend = match extension {
        "KHR_draco_mesh_compression" => "export without Draco compression",
        "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
            "export without meshopt compression (gltfpack: without -c)"
        }
        "KHR_texture_basisu" | "EXT_texture_webp" | "MSFT_texture_dds" => {
            "export with PNG or JPEG textures"
        }
        _ => "export without it",
    };
    Error::new(format_args!("requires {extension}, which is not read; {mend}"))
}
