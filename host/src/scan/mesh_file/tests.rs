use super::*;
use crate::demo;
use crate::mesh::skin::{Colors, Skin, Texture};
use crate::mesh::{glb, obj};
use crate::photo::picture::Picture;
use crate::scan::doctor::Findings;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use proptest::prelude::*;
use serde_json::{Value, json};
use std::fs;
use tempfile::tempdir;

const GREY: [f32; 3] = [0.5; 3];

fn grey() -> Options {
    Options { color: Some(GREY), ..Options::default() }
}

fn parse_as(name: &str, bytes: &[u8], options: &Options) -> Result<Mesh> {
    let path = Path::new(name);
    parse(path, bytes, Format::of(path, bytes).unwrap(), options).map(|scan| scan.mesh)
}

#[track_caller]
fn refused(name: &str, bytes: impl AsRef<[u8]>, options: &Options, part: &str) {
    let message = parse_as(name, bytes.as_ref(), options).unwrap_err().to_string();
    assert!(message.contains(part), "{message:?} does not say {part:?}");
}

/// A glTF document in the making.
#[derive(Default)]
struct Draft {
    binary: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Draft {
    fn view(&mut self, bytes: &[u8]) -> usize {
        self.views.push(json!({
            "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len(),
        }));
        self.binary.extend(bytes);
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    fn accessor(&mut self, bytes: &[u8], fields: Value) -> usize {
        let mut accessor = fields;
        accessor["bufferView"] = self.view(bytes).into();
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn floats<const N: usize>(&mut self, values: &[[f32; N]]) -> usize {
        let kind = ["", "SCALAR", "VEC2", "VEC3", "VEC4"][N];
        self.accessor(
            bytemuck::cast_slice(values.as_flattened()),
            json!({ "componentType": 5126, "type": kind, "count": values.len(),
                    "min": [0, 0, 0], "max": [0, 0, 0] }),
        )
    }

    fn indices(&mut self, values: &[u16]) -> usize {
        self.accessor(
            bytemuck::cast_slice(values),
            json!({ "componentType": 5123, "type": "SCALAR", "count": values.len() }),
        )
    }

    /// The document with these fields besides, its buffer embedded.
    fn document(&self, fields: Value) -> Value {
        let mut document = fields;
        let data = STANDARD.encode(&self.binary);
        document["asset"] = json!({ "version": "2.0" });
        document["buffers"] = json!([{
            "byteLength": self.binary.len(), "uri": format!("data:application/octet-stream;base64,{data}"),
        }]);
        document["bufferViews"] = json!(self.views);
        document["accessors"] = json!(self.accessors);
        document
    }
}

fn read_document(document: &Value, options: &Options) -> Result<Mesh> {
    parse_as("scan.gltf", document.to_string().as_bytes(), options)
}

/// A triangle in z = 0 that looks to +z.
const TRIANGLE: [[f32; 3]; 3] = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.]];

fn triangle_document(change: impl FnOnce(&mut Value)) -> Value {
    let mut draft = Draft::default();
    draft.floats(&TRIANGLE);
    draft.indices(&[0, 1, 2]);
    let mut document = draft.document(json!({
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
    }));
    change(&mut document);
    document
}

#[test]
fn what_is_written_as_glb_or_ply_is_read() {
    let (mesh, _) = demo::template().unwrap();
    let place = tempdir().unwrap();
    let path = place.path().join("face.GLB");
    fs::write(&path, glb::encode(&mesh, "face").unwrap()).unwrap();
    let Scan { mesh: read, millimetres, .. } = read(&path, &Options::default()).unwrap();
    assert_eq!(millimetres, 1000.0);
    assert_eq!(read.triangles, mesh.triangles);
    for (a, b) in read.points.as_flattened().iter().zip(mesh.points.as_flattened()) {
        assert!((a * millimetres - b).abs() < 1e-4, "{a} {b}");
    }
    let byte = |c: &f32| (c * 255.0).round() as u8;
    let bytes = |mesh: &Mesh| mesh.colors.as_flattened().iter().map(byte).collect::<Vec<_>>();
    assert_eq!(bytes(&read), bytes(&mesh));

    let mut file = Vec::new();
    ply::write(&mut file, &mesh, ply::Encoding::Binary).unwrap();
    assert_eq!(parse_as("face", &file, &Options::default()).unwrap(), mesh);
}

#[test]
fn nodes_place_their_meshes_and_a_mirror_keeps_the_outside() {
    let document = triangle_document(|document| {
        document["scenes"] = json!([{ "nodes": [0, 2] }]);
        document["nodes"] = json!([
            { "children": [1], "translation": [10, 0, 0], "scale": [2, 2, 2] },
            // A quarter turn about z, then the parent's.
            { "mesh": 0, "rotation": [0, 0, 0.5_f32.sqrt(), 0.5_f32.sqrt()] },
            { "mesh": 0, "matrix": [-1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,5,1] },
        ]);
    });
    let mesh = read_document(&document, &grey()).unwrap();
    let expected =
        [[10., 0., 0.], [10., 2., 0.], [8., 0., 0.], [0., 0., 5.], [-1., 0., 5.], [0., 1., 5.]];
    for (a, b) in mesh.points.as_flattened().iter().zip(expected.as_flattened()) {
        assert!((a - b).abs() < 1e-6, "{:?}", mesh.points);
    }
    assert_eq!(mesh.triangles, [[0, 1, 2], [3, 5, 4]]);
}

#[test]
fn lists_strips_and_fans_need_no_indices() {
    let square = [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [1., 1., 0.]];
    for (mode, points, expected) in [
        (4, &square[..3], vec![[0, 1, 2]]),
        (5, &square[..], vec![[0, 1, 2], [2, 1, 3]]),
        (6, &[square[0], square[1], square[3], square[2]], vec![[0, 1, 2], [0, 2, 3]]),
    ] {
        let mut draft = Draft::default();
        draft.floats(points);
        let primitive = json!({ "attributes": { "POSITION": 0 }, "mode": mode });
        let document = draft.document(json!({ "meshes": [{ "primitives": [primitive] }] }));
        let mesh = read_document(&document, &grey()).unwrap();
        assert_eq!(mesh.triangles, expected, "mode {mode}");
    }
}

/// A square whose halves lie on different places of a texture, with the positions and normals
/// split there, as exporters do.
fn textured_square(material: &Value) -> Value {
    let mut draft = Draft::default();
    let [a, b, c, d] = [[0., 0., 0.], [1., 0., 0.], [1., 1., 0.], [0., 1., 0.]];
    draft.floats(&[a, b, c, a, c, d]);
    let (red, blue) = ([0.25, 0.25], [0.75, 0.75]);
    draft.floats(&[red, red, red, blue, blue, blue]);
    draft.indices(&[0, 1, 2, 3, 4, 5]);
    let picture = Picture::from_fn(2, 2, |x, y| match (x, y) {
        (0, 0) => [200, 0, 0],
        (1, 1) => [0, 0, 100],
        _ => [0, 255, 0],
    });
    let view = draft.view(&picture.to_png().unwrap());
    draft.document(json!({
        "meshes": [{ "primitives": [{
            "attributes": { "POSITION": 0, "TEXCOORD_0": 1 }, "indices": 2, "material": 0,
        }] }],
        "materials": [{ "pbrMetallicRoughness": material }],
        "textures": [{ "source": 0 }],
        "images": [{ "bufferView": view, "mimeType": "image/png" }],
    }))
}

fn bytes(mesh: &Mesh) -> Vec<[u8; 3]> {
    mesh.colors.iter().map(|c| c.map(|c| (255.0 * c).round() as u8)).collect()
}

#[test]
fn seams_are_joined_and_get_the_mean_colour() {
    let document = textured_square(&json!({ "baseColorTexture": { "index": 0 } }));
    let mesh = read_document(&document, &Options::default()).unwrap();
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(bytes(&mesh), [[100, 0, 50], [200, 0, 0], [100, 0, 50], [0, 0, 100]]);
    let flipped = Options { flip_v: true, ..Options::default() };
    let mesh = read_document(&document, &flipped).unwrap();
    assert_eq!(bytes(&mesh)[1], [0, 255, 0]);
}

#[test]
fn factors_are_linear_and_textures_are_not() {
    // sRGB 200 is 0.5776 linear; a fifth of that is sRGB 95.
    let half = json!({ "baseColorTexture": { "index": 0 }, "baseColorFactor": [0.2, 1, 1, 1] });
    let mesh = read_document(&textured_square(&half), &Options::default()).unwrap();
    assert_eq!(bytes(&mesh)[1], [95, 0, 0]);
    let moved = json!({ "baseColorTexture": { "index": 0, "extensions": {
        "KHR_texture_transform": { "offset": [0.5, 0.5] },
    } } });
    let mesh = read_document(&textured_square(&moved), &Options::default()).unwrap();
    assert_eq!(bytes(&mesh)[1], [0, 0, 100]);
    // Without texture the factor counts, unless the user has a better colour.
    let flat = textured_square(&json!({ "baseColorFactor": [0.21404114, 0, 1, 1] }));
    let mesh = read_document(&flat, &Options::default()).unwrap();
    assert_eq!(bytes(&mesh), [[128, 0, 255]; 4]);
    assert_eq!(bytes(&read_document(&flat, &grey()).unwrap()), [[128; 3]; 4]);
}

#[test]
fn a_texture_of_ones_own_overrules_the_material() {
    let place = tempdir().unwrap();
    let file = place.path().join("own.png");
    Picture::filled(3, 3, [1, 2, 3]).write_png(&file).unwrap();
    let options = Options { texture: Some(file), ..Options::default() };
    let document = textured_square(&json!({ "baseColorFactor": [0.5, 0, 1, 1] }));
    assert_eq!(bytes(&read_document(&document, &options).unwrap()), [[1, 2, 3]; 4]);
    let bare = triangle_document(|_| ()).to_string();
    refused("a.gltf", bare, &options, "has no texture coordinates");
}

#[test]
fn bad_documents_are_refused() {
    let bad = |part: &str, change: &dyn Fn(&mut Value)| {
        refused("a.gltf", triangle_document(change).to_string(), &grey(), part);
    };
    for (extension, mend) in [
        ("KHR_draco_mesh_compression", "without Draco"),
        ("EXT_meshopt_compression", "without meshopt"),
        ("ACME_magic", "requires ACME_magic, which is not read"),
    ] {
        bad(mend, &|d| d["extensionsRequired"] = json!([extension]));
    }
    bad("accessor 9 is out of range", &|d| {
        d["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 9.into();
    });
    bad("not a good glTF 2.0 file", &|d| d["meshes"][0]["primitives"][0]["indices"] = 9.into());
    bad("promises 1000000000000 elements", &|d| d["accessors"][0]["count"] = json!(1e12 as u64));
    bad("promises 3 elements", &|d| d["accessors"][0]["byteOffset"] = 4.into());
    bad("promises 3 elements", &|d| d["accessors"][0]["byteOffset"] = json!(u64::MAX));
    bad("2 numbers to an element", &|d| d["accessors"][0]["type"] = "VEC2".into());
    bad("does not hold indices", &|d| d["accessors"][1]["componentType"] = 5126.into());
    bad("changes elements it does not have", &|d| {
        d["accessors"][0]["sparse"] = json!({ "count": 1,
            "indices": { "bufferView": 1, "byteOffset": 2, "componentType": 5125 },
            "values": { "bufferView": 0 } });
    });
    bad("without any data", &|d| {
        d["accessors"][0]["count"] = json!(1e12 as u64);
        d["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    });
    bad("version \"1.0\"", &|d| d["asset"]["version"] = "1.0".into());
    bad("meshes[0].primitives[0]", &|d| {
        d["meshes"][0]["primitives"][0].as_object_mut().unwrap().remove("attributes");
    });
    bad("without Draco", &|d| {
        d["meshes"][0]["primitives"][0]["extensions"] =
            json!({ "KHR_draco_mesh_compression": { "bufferView": 0, "attributes": {} } });
        d["accessors"][0].as_object_mut().unwrap().remove("bufferView");
    });
    bad("reaches beyond its buffer", &|d| d["bufferViews"][0]["byteLength"] = 400.into());
    bad("reaches beyond its buffer", &|d| d["bufferViews"][0]["byteOffset"] = json!(u64::MAX));
    bad("has 44 bytes, 99 are promised", &|d| d["buffers"][0]["byteLength"] = 99.into());
    bad("embedded data", &|d| d["buffers"][0]["uri"] = "data:;base64,####".into());
    bad("no.bin: No such file", &|d| d["buffers"][0]["uri"] = "no.bin".into());
    bad("is not on this computer", &|d| d["buffers"][0]["uri"] = "https://a.b/c.bin".into());
    bad("has two parents", &|d| d["nodes"] = json!([{ "children": [0], "mesh": 0 }]));
    bad("holds no mesh", &|d| d["nodes"] = json!([{}]));
    bad("has no faces", &|d| d["meshes"][0]["primitives"][0]["mode"] = 1.into());
    bad("is not finite", &|d| {
        d["nodes"] = json!([{ "mesh": 0, "scale": [3e38, 1, 1], "translation": [3e38, 0, 0] }]);
    });
    let bare = triangle_document(|_| ()).to_string();
    refused("a.gltf", &bare, &Options::default(), "has no vertex colours and no texture");
    refused("a.gltf", "not json", &grey(), "not a glTF file");
    refused("a.gltf", &bare[..bare.len() / 2], &grey(), "line 1");

    let image = |field: &str, value: Value, part: &str| {
        let mut document = textured_square(&json!({ "baseColorTexture": { "index": 0 } }));
        document["images"][0] = json!({ field: value });
        refused("a.gltf", document.to_string(), &grey(), part);
    };
    image("uri", "skin%20.png".into(), "skin .png: No such file");
    image("name", "no data".into(), "image 0: no data");
    image("bufferView", 0.into(), "image 0: not a picture");
}

#[test]
fn an_index_out_of_range_is_named() {
    let mut draft = Draft::default();
    draft.floats(&TRIANGLE);
    draft.indices(&[0, 1, 3]);
    let primitive = json!({ "attributes": { "POSITION": 0 }, "indices": 1 });
    let document = draft.document(json!({ "meshes": [{ "primitives": [primitive] }] }));
    let part = "mesh 0, primitive 0: index 3 is out of range, there are 3 vertices";
    refused("a.gltf", document.to_string(), &grey(), part);
}

#[test]
fn a_container_that_lies_about_its_length_is_refused() {
    let (mesh, _) = demo::template().unwrap();
    let whole = glb::encode(&mesh, "face").unwrap();
    for length in [4, 11, 12, 20, 100, whole.len() / 2, whole.len() - 1] {
        refused("a.glb", &whole[..length], &grey(), "");
    }
    let mut short = whole;
    short[8..12].copy_from_slice(&3_u32.to_le_bytes());
    refused("a.glb", short, &grey(), "header: 3 bytes promised");
}

#[test]
fn a_ply_is_painted_with_its_texture() {
    let place = tempdir().unwrap();
    let picture = Picture::from_fn(2, 2, |x, y| [100 * x as u8, 100 * y as u8, 0]);
    picture.write_png(&place.path().join("skin.png")).unwrap();
    let path = place.path().join("scan.ply");
    let per_vertex = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 3\n\
        property float x\nproperty float y\nproperty float z\nproperty float s\nproperty float t\n\
        element face 1\nproperty list uchar int vertex_indices\nend_header\n\
        0 0 0 0.25 0.25\n1 0 0 0.75 0.25\n0 1 0 0.25 0.75\n3 0 1 2\n";
    let per_face = "ply\nformat ascii 1.0\ncomment TextureFile skin.png\nelement vertex 3\n\
        property float x\nproperty float y\nproperty float z\n\
        element face 1\nproperty list uchar int vertex_indices\n\
        property list uchar float texcoord\nend_header\n\
        0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0.25 0.25 0.75 0.25 0.25 0.75\n";
    for text in [per_vertex, per_face] {
        fs::write(&path, text).unwrap();
        let mesh = read(&path, &Options::default()).unwrap().mesh;
        // v points up: the lower row is the picture's last.
        assert_eq!(bytes(&mesh), [[0, 100, 0], [100, 100, 0], [0, 0, 0]]);
    }
    let bare = per_face.replace("6 0.25 0.25 0.75 0.25 0.25 0.75", "2 0.25 0.25");
    fs::write(&path, bare).unwrap();
    let message = read(&path, &Options::default()).unwrap_err().to_string();
    assert!(message.contains("face 0: 2 numbers of texcoord"), "{message}");
    fs::write(&path, per_vertex.replace("skin.png", "none.png")).unwrap();
    let message = read(&path, &Options::default()).unwrap_err().to_string();
    assert!(message.contains("none.png: No such file"), "{message}");
}

#[test]
fn a_scan_without_colour_needs_one() {
    let stl = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n\
               endloop\nendfacet\nendsolid a\n";
    refused("a.stl", stl, &Options::default(), "an STL file has no colours");
    let turned = Options { frame: Frame::new("z".parse().unwrap(), None).unwrap(), ..grey() };
    let mesh = parse_as("a.stl", stl.as_bytes(), &turned).unwrap();
    assert_eq!(mesh.points, [[0., 0., 0.], [1., 0., 0.], [0., 0., -1.]]);
    assert_eq!(mesh.colors, [GREY; 3]);
    let obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\nf 1 2 3\n";
    refused("a.obj", obj, &Options::default(), "has no vertex colours and no texture");
    assert_eq!(parse_as("a.obj", obj.as_bytes(), &grey()).unwrap().colors, [GREY; 4]);
    let one = obj.replace("v 1 0 0", "v 1 0 0 0.2 0.2 0.2");
    refused("a.obj", one, &Options::default(), "2 of 3 vertices have no colour");
    let loose = "v 0 0 0 0 0 0\nv 1 0 0 0 0 0\nv 0 1 0 1 1 1\nv 9 9 9\nf 1 2 3\n";
    let mesh = parse_as("a.obj", loose.as_bytes(), &Options::default()).unwrap();
    assert_eq!(mesh.colors[3], [1.0 / 3.0; 3], "no triangle shows it");
    refused("a.obj", "hello", &grey(), "no vertices");
    refused("a.obj", "v 0 0 0", &grey(), "has no faces");
}

#[test]
fn what_may_be_left_out_of_a_document_may_be() {
    for change in [
        |d: &mut Value| d["scenes"] = json!([{}]),
        |d: &mut Value| {
            d["animations"] = json!([{ "samplers": [], "channels": [{ "sampler": 0,
                "target": { "path": "pointer" } }] }]);
        },
        |d: &mut Value| d["meshes"][0]["primitives"][0]["attributes"]["_PRESSURE"] = 0.into(),
        |d: &mut Value| {
            d["extensionsUsed"] = json!(["EXT_texture_webp", "KHR_draco_mesh_compression"]);
            d["nodes"][0]["extras"] = json!({ "a": [1, "b"] });
        },
        |d: &mut Value| {
            let zeros = json!({ "componentType": 5126, "type": "VEC3", "count": 3 });
            d["accessors"].as_array_mut().unwrap().push(zeros);
            d["meshes"][0]["primitives"][0]["targets"] = json!([{ "POSITION": 2 }]);
            d["meshes"][0]["weights"] = json!([1.0]);
        },
    ] {
        let mesh = read_document(&triangle_document(change), &grey()).unwrap();
        assert_eq!(mesh.points, TRIANGLE);
    }
}

#[test]
fn morph_targets_have_their_default_weights() {
    let mut draft = Draft::default();
    draft.floats(&TRIANGLE);
    draft.floats(&[[0.0, 0.0, 4.0], [0.0; 3], [0.0; 3]]);
    // Of the second target only the last vertex moves.
    draft.view(bytemuck::cast_slice(&[0.0_f32, 8.0, 0.0]));
    draft.view(&[2, 0, 0, 0]);
    draft.accessors.push(json!({ "componentType": 5126, "type": "VEC3", "count": 3, "sparse": {
        "count": 1, "indices": { "bufferView": 3, "componentType": 5121 },
        "values": { "bufferView": 2 } } }));
    let document = |weights: Value, node: Value| {
        let primitive = json!({ "attributes": { "POSITION": 0 }, "targets": [{ "POSITION": 1 }, { "POSITION": 2 }] });
        draft.document(json!({
            "scenes": [{ "nodes": [0] }], "nodes": [node],
            "meshes": [{ "primitives": [primitive], "weights": weights }],
        }))
    };
    let moved = |z, y| [[0., 0., z], [1., 0., 0.], [0., y, 0.]];
    let own = document(json!([0.5, 0.25]), json!({ "mesh": 0 }));
    assert_eq!(read_document(&own, &grey()).unwrap().points, moved(2.0, 3.0));
    let node = document(json!([0.5, 0.25]), json!({ "mesh": 0, "weights": [0, 1] }));
    assert_eq!(read_document(&node, &grey()).unwrap().points, moved(0.0, 9.0));
}

#[test]
fn a_colour_of_ones_own_fills_only_what_has_none() {
    let parts = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 0 1 1\nv 0 0 2\nv 1 0 2\nv 0 1 2\n\
                 mtllib a.mtl\nusemtl red\nf 1 2 3\nusemtl blue\nf 4 5 6\nusemtl none\nf 7 8 9\n";
    let place = tempdir().unwrap();
    let path = place.path().join("a.obj");
    let read = |materials: &str| {
        fs::write(place.path().join("a.mtl"), materials).unwrap();
        bytes(&parse_as(path.to_str().unwrap(), parts.as_bytes(), &grey()).unwrap())
    };
    let found = read("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\nnewmtl none\n");
    assert_eq!([found[0], found[3], found[6]], [[255, 0, 0], [0, 0, 255], [128; 3]]);
    // One flat colour all over is what programs write for none.
    let found = read("newmtl red\nKd 0.8 0.8 0.8\nnewmtl blue\nKd 0.8 0.8 0.8\nnewmtl none\n");
    assert_eq!(found, [[128; 3]; 9]);
}

#[test]
fn seven_numbers_are_a_weight_or_an_opacity() {
    let read = |[a, b, c]: [&str; 3]| {
        let text = format!("v 0 0 0 {a}\nv 1 0 0 {b}\nv 0 1 0 {c}\nf 1 2 3\n");
        parse_as("a.obj", text.as_bytes(), &Options::default())
    };
    let weighted = read(["1 0.2 0.4 0.6", "1.0 0 0 0", "1 1 1 1"]).unwrap();
    assert_eq!(weighted.colors, [[0.2, 0.4, 0.6], [0.0; 3], [1.0; 3]]);
    let opaque = read(["0.2 0.4 0.6 1", "0 0 0 1", "1 1 1 1"]).unwrap();
    assert_eq!(opaque.colors, weighted.colors);
    let message = read(["0.2 0.4 0.6 1", "0 0 0 0.5", "1 1 1 1"]).unwrap_err().to_string();
    assert!(message.contains("seven numbers"), "{message}");
}

#[test]
fn each_texture_of_a_ply_lies_where_it_says_and_faces_may_be_coloured() {
    let place = tempdir().unwrap();
    for (name, color) in [("a.png", [200, 0, 0]), ("b.png", [0, 0, 100])] {
        Picture::filled(2, 2, color).write_png(&place.path().join(name)).unwrap();
    }
    let path = place.path().join("scan.ply");
    let path = path.to_str().unwrap();
    let text = "ply\nformat ascii 1.0\ncomment TextureFile a.png\ncomment TextureFile b.png\n\
        element vertex 6\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n\
        property list uchar int vertex_indices\nproperty list uchar float texcoord\n\
        property int texnumber\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 0 1\n0 1 1\n\
        3 0 1 2 6 0 0 1 0 0 1 0\n3 3 4 5 6 0 0 1 0 0 1 1\n";
    let mesh = parse_as(path, text.as_bytes(), &Options::default()).unwrap();
    assert_eq!([bytes(&mesh)[1], bytes(&mesh)[4]], [[200, 0, 0], [0, 0, 100]]);
    let unnumbered = text.replace("int texnumber", "int other");
    refused(path, &unnumbered, &Options::default(), "names 2 textures");
    let painted = text
        .replace("comment TextureFile a.png\ncomment TextureFile b.png\n", "")
        .replace(
            "property list uchar float texcoord\nproperty int texnumber\n",
            "property uchar red\nproperty uchar green\nproperty uchar blue\n",
        )
        .replace("6 0 0 1 0 0 1 0", "255 0 51")
        .replace("6 0 0 1 0 0 1 1", "0 0 255");
    let mesh = parse_as(path, painted.as_bytes(), &Options::default()).unwrap();
    assert_eq!([bytes(&mesh)[1], bytes(&mesh)[4]], [[255, 0, 51], [0, 0, 255]]);
}

#[test]
fn coordinates_of_maps_keep_their_digits() {
    let at = |x: f64| format!("{} {} 2", 500_000.0 + x, 4_600_000.0 - x);
    let corners = [at(0.0), at(0.01), at(0.03)];
    let ply = format!(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n\
         property double z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n\
         {}\n3 0 1 2\n",
        corners.join("\n")
    );
    let obj = format!("v {}\nf 1 2 3\n", corners.join("\nv "));
    let stl = format!("solid a\nvertex {}\nendfacet\nendsolid\n", corners.join("\nvertex "));
    for (name, text) in [("a.ply", ply), ("a.obj", obj), ("a.stl", stl)] {
        let path = Path::new(name);
        let format = Format::of(path, text.as_bytes()).unwrap();
        let scan = parse(path, text.as_bytes(), format, &grey()).unwrap();
        for (p, x) in scan.mesh.points.iter().zip([0.0, 0.01, 0.03]) {
            let back = f64::from(p[0]) + scan.origin[0] - 500_000.0;
            assert!((back - x).abs() < 1e-8, "{name}: {back} for {x}");
        }
        assert!(
            scan.notes[0].contains("500000.015 4599999.985 2 was subtracted"),
            "{:?}",
            scan.notes
        );
    }
}

/// A whole file of each format.
fn files() -> Vec<(&'static str, Vec<u8>)> {
    let mesh = Mesh {
        points: TRIANGLE.to_vec(),
        colors: vec![[0.1; 3], [0.5; 3], [0.9; 3]],
        triangles: vec![[0, 1, 2]],
    };
    let mut stl = vec![b' '; 80];
    stl.extend(1_u32.to_le_bytes());
    stl.extend([0; 50]);
    stl[130] = 9;
    vec![
        ("a.glb", glb::encode(&mesh, "a").unwrap()),
        (
            "a.gltf",
            textured_square(&json!({ "baseColorTexture": { "index": 0 } })).to_string().into(),
        ),
        ("a.obj", b"v 0 0 0 1 1 1\nv 1 0 0 1 1 1\nv 0 1 0 1 1 1\nvt 0 1\nf 1/1 2/1 -1/-1\n".into()),
        ("a.stl", stl),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn damaged_files_never_panic(
        kind in 0..4_usize,
        places in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut: bool,
    ) {
        let (name, mut bytes) = files().swap_remove(kind);
        for (at, value) in places {
            let at = at.index(bytes.len());
            // Digits for digits keep a text readable, and let its numbers be wrong.
            bytes[at] = if bytes[at].is_ascii_digit() { b'0' + value % 10 } else { value };
            if cut && value % 8 == 0 {
                bytes.truncate(at.max(1));
            }
        }
        if let Ok(mesh) = parse_as(name, &bytes, &grey()) {
            prop_assert_eq!(mesh.points.len(), mesh.colors.len());
            prop_assert!(mesh.triangles.as_flattened().iter().all(|&v| (v as usize) < mesh.points.len()));
            Findings::of(&mesh, 1.0);
            crate::scan::doctor::mend(&mesh, true);
        }
    }
}

/// A square of two triangles, with stripes that its four corners do not have.
fn striped() -> (Mesh, Skin) {
    let mesh = Mesh {
        points: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
        colors: vec![GREY; 4],
        triangles: vec![[0, 1, 2], [0, 2, 3]],
    };
    let stripes = Picture::from_fn(64, 64, |x, _| [if x / 8 % 2 == 0 { 40 } else { 220 }; 3]);
    let uvs = vec![[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]];
    let colors = Colors::Texture(Texture::new(uvs, stripes).unwrap());
    (mesh, Skin { colors, lit: true })
}

#[test]
fn a_split_mesh_takes_its_new_colours_from_the_texture() {
    let place = tempdir().unwrap();
    let (mesh, skin) = striped();
    let write = |name: &str, bytes: &[u8]| fs::write(place.path().join(name), bytes).unwrap();
    for (name, bytes) in obj::files(&mesh, &skin, "fish") {
        write(&name, &bytes);
    }
    write("fish.glb", &glb::encode_with(&mesh, &skin, "fish").unwrap());
    let ply = "ply\nformat ascii 1.0\ncomment TextureFile fish.png\nelement vertex 4\n\
               property float x\nproperty float y\nproperty float z\n\
               property float s\nproperty float t\nelement face 1\n\
               property list uchar int vertex_indices\nend_header\n\
               0 0 0 0 0\n1 0 0 1 0\n1 1 0 1 1\n0 1 0 0 1\n4 0 1 2 3\n";
    write("fish.ply", ply.as_bytes());
    for name in ["fish.obj", "fish.glb", "fish.ply"] {
        let path = place.path().join(name);
        let coarse = read(&path, &Options::default()).unwrap();
        assert_eq!(coarse.mesh.points.len(), 4, "{name}");
        let [note] = &coarse.notes[..] else { panic!("{name}: {:?}", coarse.notes) };
        assert!(note.contains("2048 pixels to a triangle"), "{name}: {note}");
        assert!(note.contains("--subdivide 5"), "{name}: {note}");
        let width = coarse.mesh.points[1][0];
        let scale = Scale::Size(1000.0);
        for how in [Subdivision::Times(5), Subdivision::Edge(45.0)] {
            let options = Options { subdivision: Some(how), scale, ..Options::default() };
            let fine = read(&path, &options).unwrap();
            assert_eq!(fine.notes, Vec::<String>::new(), "{name}: {how:?}");
            assert_eq!(fine.mesh.points[..4], coarse.mesh.points, "landmarks remain");
            for (point, color) in fine.mesh.points.iter().zip(&fine.mesh.colors) {
                let stripe = 8.0 * point[0] / width;
                if (0.2..0.8).contains(&stripe.fract()) {
                    let expected =
                        if (stripe as u32).is_multiple_of(2) { 40.0 } else { 220.0 } / 255.0;
                    assert!(
                        (color[0] - expected).abs() < 0.01,
                        "{name}: {how:?} {point:?} {color:?}"
                    );
                }
            }
        }
    }
}

#[test]
fn a_size_stands_for_the_unit() {
    let scale = Scale::Size(300.0);
    let text = "v 0 0 0 1 0 0\nv 2 0 0 1 0 0\nv 0 0.5 0 1 0 0\nf 1 2 3\n";
    let read = |options: &Options| parse(Path::new("a.obj"), text.as_bytes(), Format::Obj, options);
    assert_eq!(read(&Options { scale, ..Options::default() }).unwrap().millimetres, 150.0);
    let edge = Some(Subdivision::Edge(100.0));
    let split = read(&Options { scale, subdivision: edge, ..Options::default() }).unwrap();
    assert!(split.mesh.points.len() > 3 && split.mesh.points[1] == [2.0, 0.0, 0.0]);
    let flat = "v 1 0 0 1 0 0\nv 1 0 0 1 0 0\nv 1 0 0 1 0 0\nf 1 2 3\n";
    let options = Options { scale, ..Options::default() };
    let error = parse(Path::new("a.obj"), flat.as_bytes(), Format::Obj, &options).unwrap_err();
    assert!(error.to_string().contains("does not suit"), "{error}");
}

#[test]
fn files_of_other_programs_are_refused_by_name() {
    let place = tempdir().unwrap();
    for (name, bytes, part) in [
        ("a.fbx", &b"Kaydara FBX Binary"[..], "FBX, which is not read"),
        ("a.bin", b"Kaydara FBX Binary", "FBX, which is not read"),
        ("a.blend", b"BLENDER", "Blender"),
        ("a.drc", b"DRACO", "compressed by Draco"),
        ("a.xyz", b"1 2 3", "not a mesh this program reads"),
    ] {
        let path = place.path().join(name);
        fs::write(&path, bytes).unwrap();
        let error = read(&path, &Options::default()).unwrap_err().to_string();
        assert!(error.contains(part) && error.contains("export it as PLY"), "{name}: {error}");
        assert!(error.contains(name), "{error}");
    }
    assert!(read(&place.path().join("none.obj"), &Options::default()).is_err());
}
