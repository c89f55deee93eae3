//! Whatever is wrong with a file, the answer is one line that names it, exit code 1, and nothing
//! left behind.

use onescan::photo::picture::Picture;
use onescan_tests::program::{Onescan, fixtures};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::time::Duration;
use tempfile::tempdir;

/// A bad file, and the command line that is given it.
struct Case {
    /// What is wrong.
    what: String,
    /// Name of the bad file in the working directory; the error must name it.
    file: &'static str,
    /// Its contents; none if it is missing.
    bytes: Option<Vec<u8>>,
    /// Words of the command line.
    line: &'static str,
    /// What the error must say.
    says: &'static str,
}

fn case(
    what: impl Into<String>,
    file: &'static str,
    bytes: impl Into<Vec<u8>>,
    line: &'static str,
    says: &'static str,
) -> Case {
    Case { what: what.into(), file, bytes: Some(bytes.into()), line, says }
}

fn fixture(name: &str) -> Vec<u8> {
    fs::read(fixtures().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// Every file and directory below `directory`.
fn listing(directory: &Path) -> BTreeSet<String> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir(directory).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(listing(&path));
        }
        found.insert(path.to_string_lossy().into_owned());
    }
    found
}

#[track_caller]
fn refuses(cases: Vec<Case>) {
    let mut faults = Vec::new();
    for case in cases {
        if let Err(fault) = refused(&case) {
            faults.push(format!("{} ({}): {fault}", case.what, case.line));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

fn refused(case: &Case) -> Result<(), String> {
    let place = tempdir().unwrap();
    if let Some(bytes) = &case.bytes {
        let path = place.path().join(case.file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
    let mut before = listing(place.path());
    let run = Onescan::new(place.path(), case.line).run();
    // An output directory may have been made, with nothing in it.
    before.insert(place.path().join("out").to_string_lossy().into_owned());
    let left: Vec<_> = listing(place.path()).difference(&before).cloned().collect();

    let lines: Vec<&str> = run.stderr.lines().collect();
    let [line] = lines[..] else { return Err(format!("not one line: {run:?}")) };
    let told = line.starts_with("onescan: ") && line.contains(case.file);
    match (run.code, told, line.contains(case.says)) {
        _ if line.contains("panicked") => Err(run.stderr),
        (Some(1), true, true) if left.is_empty() && run.stdout.is_empty() => Ok(()),
        (Some(1), true, true) => Err(format!("left behind: {left:?} {}", run.stdout)),
        (Some(1), _, _) => Err(format!("expected {:?}, {:?} in: {line}", case.file, case.says)),
        (code, ..) => Err(format!("exit code {code:?}: {line}")),
    }
}

/// A tetrahedron, faces and vertices as given.
fn tetrahedron(change: impl Fn(String) -> String) -> Vec<u8> {
    change(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n\
         property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
         element face 4\nproperty list uchar int vertex_indices\nend_header\n\
         0 0 0 200 150 120\n100 0 0 200 150 120\n0 100 0 200 150 120\n0 0 100 200 150 120\n\
         3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n"
            .into(),
    )
    .into_bytes()
}

#[test]
fn a_tetrahedron_is_good() {
    let place = tempdir().unwrap();
    fs::write(place.path().join("scan.ply"), tetrahedron(|text| text)).unwrap();
    Onescan::new(place.path(), "build scan.ply --rank 4 -o out.3dmm").succeed();
}

#[test]
fn scans() {
    const BUILD: &str = "build bad.ply --rank 4 -o out.3dmm";
    let bad = |what: &str, from: &str, to: &str, says| {
        let bytes = tetrahedron(|text| {
            assert!(text.contains(from), "{from}");
            text.replace(from, to)
        });
        case(what, "bad.ply", bytes, BUILD, says)
    };
    let template = fixture("face/template.ply");
    let mut cases = vec![
        Case { bytes: None, ..case("missing", "bad.ply", "", BUILD, "No such file") },
        case("no bytes", "bad.ply", "", BUILD, "not a PLY file"),
        case("another format", "bad.ply", "solid cube\n", BUILD, "not a PLY file"),
        bad("NaN vertex", "100 0 0", "nan 0 0", "line 14"),
        bad("infinite vertex", "100 0 0", "0 inf 0", "line 14"),
        bad("index out of range", "3 1 2 3", "3 1 2 4", "face 3: vertex index 4 is out of range"),
        bad("negative index", "3 1 2 3", "3 1 2 -1", "vertex index -1 is out of range"),
        bad("no colours", "property uchar red", "property uchar rod", "has no vertex colours"),
        bad("text for a number", "0 100 0", "0 ten 0", "damaged"),
        bad("a promise too many", "element vertex 4", "element vertex 400000000", "cannot fit"),
        bad("two corners", "3 1 2 3", "2 1 2", "face 3: 2 corners"),
        bad("cut short", "3 0 3 2\n3 1 2 3\n", "", "bad.ply"),
        case(
            "no vertices",
            "bad.ply",
            "ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n\
             property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
             element face 0\nproperty list uchar int vertex_indices\nend_header\n",
            BUILD,
            "the mesh is empty",
        ),
        bad(
            "no faces",
            "element face 4\nproperty list uchar int vertex_indices\n",
            "",
            "has no faces",
        ),
    ];
    for length in [3, 100, 330, 5_000, template.len() - 1] {
        let what = format!("binary, cut at {length}");
        cases.push(case(what, "bad.ply", &template[..length], BUILD, "bad.ply"));
    }
    // A face's count of corners: with another, everything after it is out of step.
    let mut corrupt = template.clone();
    let at = template.len() - 13 * 1000;
    corrupt[at] = 200;
    cases.push(case("binary, out of step", "bad.ply", corrupt, BUILD, "bad.ply"));
    refuses(cases);
}

#[test]
fn meshes_of_other_programs() {
    const OBJ: &str = "build bad.obj --rank 4 -o out.3dmm";
    const MEND: &str = "inspect bad.obj --mend out.ply";
    const GLTF: &str = "build bad.gltf --colour 200,150,120 --rank 4 -o out.3dmm";
    const GLB: &str = "build bad.glb --colour 200,150,120 --rank 4 -o out.3dmm";
    const STL: &str = "build bad.stl --colour #c09678 --rank 4 -o out.3dmm";
    let tetrahedron = "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 0 0 100\nf 1 3 2\nf 1 2 4\nf 1 4 3\n";
    let obj = |what: &str, more: &str, says| {
        case(what, "bad.obj", format!("{tetrahedron}{more}\n"), OBJ, says)
    };
    let document = |fields: &str| {
        let accessor = r#"{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": 3,
                           "min": [0, 0, 0], "max": [1, 1, 1]}"#;
        format!(
            r#"{{"asset": {{"version": "2.0"}}, "accessors": [{accessor}],
                "bufferViews": [{{"buffer": 0, "byteLength": 36}}],
                "meshes": [{{"primitives": [{{"attributes": {{"POSITION": 0}}}}]}}], {fields}}}"#
        )
    };
    let gltf =
        |what: &str, fields: &str, says| case(what, "bad.gltf", document(fields), GLTF, says);
    let embedded = r#""buffers": [{"byteLength": 36, "uri": "data:;base64,AAAA"}]"#;
    let absent = r#""buffers": [{"byteLength": 36, "uri": "mesh.bin"}]"#;
    let draco = format!(r#"{embedded}, "extensionsRequired": ["KHR_draco_mesh_compression"]"#);
    let absurd = document(absent).replace("\"count\": 3", "\"count\": 30000000000000000000");
    let mut vast = vec![b' '; 80];
    vast.extend([0xff; 70]);
    refuses(vec![
        Case { bytes: None, ..obj("missing", "", "No such file") },
        case("no bytes", "bad.obj", "", OBJ, "the mesh is empty"),
        obj("no colours", "", "has no vertex colours and no texture"),
        obj("no materials", "mtllib skin.mtl", "skin.mtl: No such file"),
        obj("NaN", "v nan 0 0", "line 8: `nan` is not a finite number"),
        obj("index out of range", "f 1 2 5", "line 8: vertex index 5 is out of range"),
        obj("two corners", "f 1 2", "line 8: 2 corners"),
        case("text for a number", "bad.obj", "v 0 zero 0\n", MEND, "line 1: `zero`"),
        case(
            "only a line",
            "bad.obj",
            "v 0 0 0\nv 1 1 1\nf 1 2 2\n",
            "inspect bad.obj \
             --colour 9,9,9 --mend out.ply",
            "no triangle has an area",
        ),
        case("no bytes", "bad.gltf", "", GLTF, "not a glTF file"),
        case("cut in half", "bad.gltf", &document(embedded)[..200], GLTF, "line"),
        case("an absurd count", "bad.gltf", absurd, GLTF, "bad.gltf"),
        gltf("no buffers", r#""buffers": []"#, "buffer"),
        gltf("a missing buffer", absent, "mesh.bin: No such file"),
        gltf("a short buffer", embedded, "has 3 bytes, 36 are promised"),
        gltf("compressed", &draco, "export without Draco compression"),
        case("no bytes", "bad.glb", "", GLB, "not a glTF file"),
        case("no length", "bad.glb", "glTF\u{2}\0\0\0", GLB, "0 bytes promised"),
        case("no bytes", "bad.stl", "", STL, "not an STL file"),
        case("a promise too many", "bad.stl", vast, STL, "4294967295 triangles do not fit"),
        case("cut short", "bad.stl", "solid a\nfacet normal 0 0 1\n", STL, "cut short"),
        case("no colour", "bad.stl", "solid a\n", "inspect bad.stl", "an STL file has no colours"),
        case("named", "bad.fbx", "Kaydara", "inspect bad.fbx", "FBX, which is not read"),
        case("unknown", "bad.xyz", "1 2 3", "inspect bad.xyz", "not a mesh this program reads"),
    ]);
}

#[test]
fn a_unit_that_can_be_none_of_a_face_is_asked_for() {
    let build = |scale: &str| {
        let scan = tetrahedron(|text| text.replace("100", scale));
        case(format!("{scale} long"), "bad.ply", scan, "build bad.ply --rank 4 -o out.3dmm", "")
    };
    refuses(vec![
        Case { says: "add --unit m, or if it is that small, --unit 1", ..build("0.1") },
        Case { says: "add --unit cm, ", ..build("10") },
    ]);
    let place = tempdir().unwrap();
    fs::write(place.path().join("scan.ply"), tetrahedron(|text| text.replace("100", "10")))
        .unwrap();
    Onescan::new(place.path(), "build scan.ply --rank 4 --unit mm -o out.3dmm").succeed();
}

#[test]
fn files_in_the_place_of_others() {
    const MARKED_ON_A_SCAN: &str =
        "fit @golden/small.3dmm @photos/astronaut.png --landmarks bad.json -o out";
    const NO_LANDMARKS: &str =
        "fit @golden/small.3dmm @photos/astronaut.png --landmarks bad.ply -o out";
    let (model, photo) = (fixture("golden/small.3dmm"), fixture("photos/astronaut.png"));
    let (scan, marks) = (fixture("face/template.ply"), fixture("photos/astronaut.tlms"));
    let places = fixture("face/landmarks.json");
    let misplaced = |file, bytes: &[u8], line, says| case("misplaced", file, bytes, line, says);
    refuses(vec![
        misplaced(
            "a.png",
            &photo,
            "fit a.png @golden/small.3dmm -o out",
            "a photo, in the place of a model",
        ),
        misplaced(
            "a.ply",
            &scan,
            "fit @golden/small.3dmm a.ply -o out",
            "a scan, in the place of a photo",
        ),
        misplaced(
            "a.ply",
            &scan,
            "register a.ply @golden/small.3dmm -o out",
            "in the place of a model",
        ),
        misplaced(
            "a.png",
            &photo,
            "register @golden/small.3dmm a.png -o out",
            "in the place of a scan",
        ),
        misplaced("a.ply", &scan, "info a.ply", "a scan, in the place of a model (.3dmm, .h5"),
        misplaced("a.3dmm", &model, "build a.3dmm -o out.3dmm", "a model, in the place of a scan"),
        misplaced(
            "a.tlms",
            &marks,
            "build @face/template.ply --landmarks a.tlms -o out.3dmm",
            "landmarks in a photo, in the place of landmarks on a scan",
        ),
        misplaced(
            "bad.json",
            &places,
            MARKED_ON_A_SCAN,
            "landmarks on a scan, in the place of landmarks in",
        ),
        misplaced("bad.ply", &scan, NO_LANDMARKS, "in the place of landmarks in a photo"),
        misplaced(
            "a.3dmm",
            &model,
            "recognise a.3dmm @photos/astronaut.png -o out",
            "neither a directory of photos or fits",
        ),
    ]);
}

#[test]
fn landmarks_of_a_scan() {
    const BUILD: &str = "build @face/template.ply --landmarks bad.json --rank 4 -o out.3dmm";
    let bad = |what: &str, text: &str, says| case(what, "bad.json", text, BUILD, says);
    let whole = fixture("face/landmarks.json");
    refuses(vec![
        Case { bytes: None, ..bad("missing", "", "No such file") },
        bad("no bytes", "", "line 1"),
        bad("an object", "{}", "JSON array"),
        bad("text for a vertex", r#"[{"id": "a", "vertex": "x"}]"#, "line 1"),
        bad("out of range", r#"[{"id": "a", "vertex": 8291}]"#, "vertex 8291 is out of range"),
        bad("huge", r#"[{"id": "a", "vertex": 18446744073709551615}]"#, "out of range"),
        bad("far away", r#"[{"id": "a", "coordinates": [0, 0, 900]}]"#, "mm away"),
        bad("neither", r#"[{"id": "a"}]"#, "give a vertex or coordinates"),
        bad("twice", r#"[{"id": "a", "vertex": 1}, {"id": "a", "vertex": 2}]"#, "must be unique"),
        case("cut short", "bad.json", &whole[..whole.len() / 2], BUILD, "line"),
        case("not text", "bad.json", [0xff, 0xfe, 0x00], BUILD, "UTF-8"),
    ]);
}

#[test]
fn models() {
    const INFO: &str = "info bad.3dmm";
    let whole = fixture("golden/small.3dmm");
    let flipped = |at: usize| {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x40;
        bytes
    };
    let mut cases = vec![
        Case { bytes: None, ..case("missing", "bad.3dmm", "", INFO, "No such file") },
        case("no bytes", "bad.3dmm", "", INFO, "bad.3dmm"),
        case("another format", "bad.3dmm", vec![b'x'; 400], INFO, "not a .3dmm model"),
        case("another version", "bad.3dmm", flipped(8), INFO, "version"),
        case("one byte more", "bad.3dmm", [&whole[..], &[0]].concat(), INFO, "bytes"),
    ];
    for length in [7, 191, 192, 1000, whole.len() / 2, whole.len() - 1] {
        let what = format!("cut at {length}");
        cases.push(case(what, "bad.3dmm", &whole[..length], INFO, "bad.3dmm"));
    }
    for at in [17, 40, 80, 300, whole.len() / 2, whole.len() - 1] {
        let what = format!("a bit of byte {at} flipped");
        cases.push(case(what, "bad.3dmm", flipped(at), INFO, "damaged"));
    }
    let cut = &whole[..whole.len() / 2];
    for line in [
        "sample bad.3dmm -o out",
        "render bad.3dmm -o out.png",
        "fit bad.3dmm @photos/astronaut.png --landmarks @photos/astronaut.tlms -o out",
    ] {
        cases.push(case("cut in half", "bad.3dmm", cut, line, "incomplete"));
    }
    refuses(cases);
}

#[test]
fn what_models_are_made_of() {
    const POSTERIOR: &str = "model posterior @golden/small.3dmm --landmarks bad.json -o out.3dmm";
    const REGION: &str = "model region @golden/small.3dmm --mask bad.txt -o out.3dmm";
    const OCCLUSION: &str = "model occlusion @golden/small.3dmm --map bad.txt -o out.3dmm";
    let other = fixture("face/template.ply");
    let mesh = |line| case("another topology", "bad.ply", &other[..], line, "vertices, ");
    refuses(vec![
        case("no positions", "bad.json", r#"[{"id": "a"}]"#, POSTERIOR, "missing field"),
        case(
            "a name of no landmark",
            "bad.json",
            r#"[{"id": "horn", "coordinates": [0, 0, 0]}]"#,
            POSTERIOR,
            "no landmark \"horn\"",
        ),
        case("a mask of words", "bad.txt", "0 1 yes", REGION, "line 3: \"yes\""),
        case("a short mask", "bad.txt", "0\n1\n", REGION, "has 2 lines"),
        mesh("model project @golden/small.3dmm bad.ply -o out.ply"),
        mesh("model recentre @golden/small.3dmm bad.ply -o out.3dmm"),
        mesh("model posterior @golden/small.3dmm --mesh bad.ply -o out.3dmm"),
        mesh("evaluate @golden/small.3dmm --meshes bad.ply -o out"),
        mesh("model occlusion @golden/small.3dmm --map bad.ply -o out.3dmm"),
        case(
            "a map of words",
            "bad.txt",
            "0 1 yes",
            OCCLUSION,
            "line 3: \"yes\", expected a number",
        ),
        case("not a probability", "bad.txt", "0 1.5", OCCLUSION, "line 2: \"1.5\""),
        case("a short map", "bad.txt", "0\n0.5\n", OCCLUSION, "has 2 lines"),
        Case {
            bytes: None,
            ..case(
                "a format that cannot carry it",
                "out.h5",
                "",
                "model occlusion @golden/small.3dmm --map bad.txt -o out.h5",
                "only .3dmm",
            )
        },
        case(
            "a mesh that is not registered",
            "bad.ply",
            tetrahedron(|text| text),
            "model pca @face/template.ply bad.ply -o out.3dmm",
            "other triangles",
        ),
        Case {
            bytes: None,
            ..case(
                "no fixtures",
                "face/scans/truths.bin",
                "",
                "experiment compactness -o out --fixtures .",
                "give --fixtures",
            )
        },
    ]);
}

#[test]
fn models_of_other_programs() {
    let place = tempdir().unwrap();
    let write = |name: &str| {
        Onescan::new(place.path(), &format!("convert @golden/small.3dmm -o {name}")).succeed();
        fs::read(place.path().join(name)).unwrap()
    };
    let (binary, json) = (write("good.h5"), write("good.h5.json"));
    let mut cases = Vec::new();
    for (file, line, whole) in [
        ("bad.h5", "info bad.h5", &binary),
        ("bad.h5.json", "info bad.h5.json", &json),
        ("bad.mat", "info bad.mat", &Vec::new()),
    ] {
        cases.push(Case { bytes: None, ..case("missing", file, "", line, "No such file") });
        cases.push(case("no bytes", file, "", line, file));
        cases.push(case("a photo", file, fixture("photos/astronaut.png"), line, file));
        for part in [1, 10, 50, 90, 99] {
            let what = format!("{part} % of it");
            cases.push(case(what, file, &whole[..whole.len() * part / 100], line, file));
        }
    }
    let missing = String::from_utf8(json.clone()).unwrap().replace("\"pcaBasis\"", "\"basis\"");
    for line in [
        "sample bad.h5.json -o out",
        "render bad.h5.json -o out.png",
        "export bad.h5.json -o out.3dmm",
        "convert bad.h5.json -o out.h5",
        "fit bad.h5.json @photos/astronaut.png --landmarks @photos/astronaut.tlms -o out",
    ] {
        cases.push(case("no basis", "bad.h5.json", &missing[..], line, "shape/model/pcaBasis: "));
    }
    for line in [
        "convert @golden/small.3dmm -o bad.mat",
        "build @face/template.ply --rank 4 -o bad.mat",
        "export @golden/small.3dmm -o bad.mat",
    ] {
        let only_read = case("only read", "bad.mat", "", line, "read, not written");
        cases.push(Case { bytes: None, ..only_read });
    }
    refuses(cases);
}

#[test]
fn a_model_without_landmarks_is_not_fitted() {
    let place = tempdir().unwrap();
    fs::write(place.path().join("scan.ply"), tetrahedron(|text| text)).unwrap();
    Onescan::new(place.path(), "build scan.ply --rank 4 -o out.3dmm").succeed();
    let model = fs::read(place.path().join("out.3dmm")).unwrap();
    let line = "fit bad.3dmm @photos/astronaut.png --landmarks @photos/astronaut.tlms -o out";
    refuses(vec![case("no landmarks", "bad.3dmm", model, line, "has no landmarks")]);
}

/// A PNG that claims a size, with correct checksums and a byte of pixels.
fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut header = b"IHDR".to_vec();
    header.extend(width.to_be_bytes());
    header.extend(height.to_be_bytes());
    header.extend([8, 2, 0, 0, 0]);
    let crc = |bytes: &[u8]| {
        !bytes.iter().fold(u32::MAX, |crc, &byte| {
            (0..8).fold(crc ^ u32::from(byte), |c, _| (c >> 1) ^ (0xedb8_8320 * (c & 1)))
        })
    };
    let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
    for chunk in [&header[..], b"IDAT\0", b"IEND"] {
        png.extend((chunk.len() as u32 - 4).to_be_bytes());
        png.extend(chunk);
        png.extend(crc(chunk).to_be_bytes());
    }
    png
}

/// The JPEG with another size in its frame header.
fn resized_jpeg(jpeg: &[u8], width: u16, height: u16) -> Vec<u8> {
    let mut bytes = jpeg.to_vec();
    let frame = jpeg.windows(2).position(|marker| marker == [0xff, 0xc0]).unwrap();
    bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

#[test]
fn photos() {
    const PNG: &str = "fit @golden/small.3dmm bad.png --landmarks @photos/astronaut.tlms -o out";
    const JPEG: &str =
        "fit @golden/small.3dmm bad.jpg --landmarks @photos/grace_hopper.tlms -o out";
    let png = fixture("photos/astronaut.png");
    let jpeg = fixture("photos/grace_hopper.jpg");
    let mut corrupt_png = png.clone();
    corrupt_png[png.len() / 2] ^= 0xff;
    // The tables that the picture is coded with.
    let mut corrupt_jpeg = jpeg.clone();
    let tables = jpeg.windows(2).position(|marker| marker == [0xff, 0xc4]).unwrap();
    corrupt_jpeg[tables + 4..tables + 40].fill(0xff);
    let mut cases = vec![
        Case { bytes: None, ..case("missing", "bad.png", "", PNG, "No such file") },
        case("no bytes", "bad.png", "", PNG, "PNG or JPEG"),
        case("another format", "bad.png", &b"GIF89a\x01\0\x01\0"[..], PNG, ".gif"),
        case("text", "bad.jpg", "a photo", JPEG, "PNG or JPEG"),
        case("flipped", "bad.png", corrupt_png, PNG, "save the picture again"),
        case("broken tables", "bad.jpg", corrupt_jpeg, JPEG, "save the picture again"),
        case("no width", "bad.png", png_header(0, 5), PNG, "bad.png"),
        case("no height", "bad.png", png_header(5, 0), PNG, "bad.png"),
        case("vast", "bad.png", png_header(100_000, 100_000), PNG, "100000×100000"),
        case("wide", "bad.png", png_header(100_000, 1), PNG, "100000×1"),
        case("high", "bad.png", png_header(1, 100_000), PNG, "1×100000"),
        case("pixels missing", "bad.png", png_header(500, 500), PNG, "bad.png"),
        case("no width", "bad.jpg", resized_jpeg(&jpeg, 0, 600), JPEG, "bad.jpg"),
        case("vast", "bad.jpg", resized_jpeg(&jpeg, 65_535, 65_535), JPEG, "65535×65535"),
    ];
    for length in [8, 33, 1000, png.len() / 2] {
        cases.push(case(format!("cut at {length}"), "bad.png", &png[..length], PNG, "bad.png"));
    }
    for length in [3, 300, jpeg.len() / 2] {
        cases.push(case(format!("cut at {length}"), "bad.jpg", &jpeg[..length], JPEG, "bad.jpg"));
    }
    refuses(cases);
}

#[test]
fn landmarks_of_a_photo() {
    const FIT: &str = "fit @golden/small.3dmm @photos/astronaut.png --landmarks bad.tlms -o out";
    const MESH: &str = "fit @golden/small.3dmm @photos/astronaut.png --landmarks bad.json -o out";
    const POINTS: &str = "fit @golden/small.3dmm @photos/astronaut.png --landmarks bad.pts -o out";
    let bad = |what: &str, text: &str, says| case(what, "bad.tlms", text, FIT, says);
    let eyes = "right.eye.corner_outer 1 193 101\nleft.eye.corner_outer 1 256 103\n\
                center.nose.tip 1 223 127\n";
    let with = |line: &str| format!("{eyes}{line}\n");
    refuses(vec![
        Case { bytes: None, ..bad("missing", "", "No such file") },
        bad("no bytes", "", "0 visible landmarks"),
        bad("too few", eyes, "3 visible landmarks"),
        bad("hidden", &with("center.chin.tip 0 220 175"), "3 visible landmarks"),
        bad("unknown", &with("center.chin.top 1 220 175"), "did you mean `center.chin.tip`"),
        bad("outside", &with("center.chin.tip 1 220 512"), "outside the 512×512 picture"),
        bad("negative", &with("center.chin.tip 1 -3 175"), "outside the 512×512 picture"),
        bad("NaN", &with("center.chin.tip 1 nan 175"), "line 4: x is `nan`"),
        bad("infinite", &with("center.chin.tip 1 220 inf"), "line 4: y is `inf`"),
        bad("cut short", &with("center.chin.tip 1 220"), "line 4: 3 fields"),
        bad("3-D", &with("center.chin.tip 1 220 175 10"), "line 4: 5 fields"),
        bad("twice", &with("center.nose.tip 1 220 175"), "line 4: landmark `center.nose.tip`"),
        bad("words", &with("center.chin.tip yes 220 175"), "line 4: visible is `yes`"),
        case("not text", "bad.tlms", [0xff, 0xfe, 0x00], FIT, "UTF-8"),
        case("no mesh", "bad.json", "[]", MESH, "0 meshes of a face"),
        case("other points", "bad.pts", "{\n1 2\n}", POINTS, "1 points"),
    ]);
}

/// The astronaut's landmarks, each changed: name, x and y.
fn changed(change: impl Fn(&str, f32, f32) -> (String, f32, f32)) -> String {
    let text = String::from_utf8(fixture("photos/astronaut.tlms")).unwrap();
    let lines = text.lines().map(|line| {
        let words: Vec<&str> = line.split_whitespace().collect();
        let (name, x, y) = change(words[0], words[2].parse().unwrap(), words[3].parse().unwrap());
        format!("{name} {} {x} {y}\n", words[1])
    });
    lines.collect()
}

#[test]
fn landmarks_that_mean_something_else() {
    const FIT: &str = "fit @golden/small.3dmm @photos/astronaut.png --landmarks bad.tlms -o out";
    const CHAIN: &str = "fit @golden/small.3dmm @photos/astronaut.png --landmarks bad.tlms \
                         --schedule paper -o out";
    let keep = |name: &str| name.to_string();
    let other_side = |name: &str| match name.split_once('.') {
        Some(("left", rest)) => format!("right.{rest}"),
        Some(("right", rest)) => format!("left.{rest}"),
        _ => name.to_string(),
    };
    let swapped = changed(|name, x, y| (other_side(name), x, y));
    refuses(vec![
        case("sides exchanged", "bad.tlms", &*swapped, FIT, "left and right are exchanged"),
        case("sides exchanged", "bad.tlms", swapped, CHAIN, "left and right are exchanged"),
        case(
            "y up",
            "bad.tlms",
            changed(|name, x, y| (keep(name), x, 511.0 - y)),
            FIT,
            "y seems to point up",
        ),
        case(
            "axes exchanged",
            "bad.tlms",
            changed(|name, x, y| (keep(name), y, x)),
            FIT,
            "are x and y exchanged",
        ),
        case(
            "parts of the sides",
            "bad.tlms",
            changed(|name, x, y| (keep(name), x / 512.0, y / 512.0)),
            FIT,
            "multiply x by 512 and y by 512",
        ),
        case(
            "one point",
            "bad.tlms",
            changed(|name, x, y| (keep(name), 220.0 + x / 512.0, 130.0 + y / 512.0)),
            FIT,
            "fall together",
        ),
        case(
            "on a line",
            "bad.tlms",
            changed(|name, x, _| (keep(name), x, 120.0)),
            FIT,
            "lie on a line",
        ),
    ]);
}

#[test]
fn masks_of_a_photo() {
    const FIT: &str = "fit @golden/small.3dmm @photos/astronaut.png \
                       --landmarks @photos/astronaut.tlms --mask bad.png -o out";
    const CHAIN: &str = "fit @golden/small.3dmm @photos/astronaut.png \
                         --landmarks @photos/astronaut.tlms --mask bad.png --schedule paper -o out";
    let picture = |side, color| Picture::filled(side, side, [color; 3]).to_png().unwrap();
    refuses(vec![
        Case { bytes: None, ..case("missing", "bad.png", "", FIT, "No such file") },
        case("no bytes", "bad.png", "", FIT, "PNG or JPEG"),
        case("another size", "bad.png", picture(256, 255), FIT, "256×256, the photo 512×512"),
        case("all hidden", "bad.png", picture(512, 0), FIT, "the mask hides all of it"),
        case("a chain", "bad.png", picture(512, 255), CHAIN, "a mask is for --schedule mode"),
    ]);
}

#[test]
fn parameters_of_a_fit() {
    const FIT: &str = "render @golden/small.3dmm --fit bad.json -o out.png";
    const RPS: &str = "render @golden/small.3dmm --rps bad.rps -o out.png";
    let place = tempdir().unwrap();
    let fit = "fit @golden/small.3dmm @photos/astronaut.png --landmarks @photos/astronaut.tlms \
               --schedule paper --landmark-samples 20 --samples 20 -o fit";
    Onescan::new(place.path(), fit).succeed();
    let text = |name: &str| fs::read_to_string(place.path().join("fit").join(name)).unwrap();
    let (json, rps) = (text("fit.json"), text("fit.rps"));
    let changed = |text: &str, field: &str, value: &str| {
        let at = text.find(&format!("\"{field}\":")).unwrap_or_else(|| panic!("no {field}"));
        let end = at + text[at..].find([',', '\n']).unwrap();
        format!("{}\"{field}\": {value}{}", &text[..at], &text[end..])
    };
    let bad = |what: &str, text: &str, says| case(what, "bad.json", text, FIT, says);
    let bad_rps = |what: &str, text: &str, says| case(what, "bad.rps", text, RPS, says);
    refuses(vec![
        Case { bytes: None, ..bad("missing", "", "No such file") },
        bad("no bytes", "", "line 1"),
        bad("cut in half", &json[..json.len() / 2], "line"),
        bad(
            "another model's",
            &changed(&json, "checksum", "\"0\" }, \"x\": {\"y\": 0"),
            "bad.json",
        ),
        bad("no seed", &json.replace("\"seed\"", "\"sead\""), "missing field `seed`"),
        bad("text", &changed(&json, "focal_length", "\"long\""), "focal_length"),
        bad("infinite", &changed(&json, "focal_length", "1e99"), "focal_length"),
        bad("no lens", &changed(&json, "focal_length", "0"), "focal length"),
        bad("null", &changed(&json, "roll", "null"), "roll"),
        Case { bytes: None, ..bad_rps("missing", "", "No such file") },
        bad_rps("no bytes", "", "line 1"),
        bad_rps("cut in half", &rps[..rps.len() / 2], "line"),
        bad_rps("another version", &rps.replace("V4.0", "V9.0"), "V9.0"),
        bad_rps("an older one", &rps.replace("V4.0", "V3.0"), "missing field `illumination`"),
        bad_rps("null", &changed(&rps, "roll", "null"), "roll"),
    ]);
}

#[test]
fn checkpoints() {
    const FIT: &str = "fit @golden/small.3dmm @photos/astronaut.png \
                       --landmarks @photos/astronaut.tlms --schedule paper -o out --resume";
    const FILE: &str = "out/checkpoint.bin";
    let place = tempdir().unwrap();
    let line = "fit @golden/small.3dmm @photos/astronaut.png \
                --landmarks @photos/astronaut.tlms --schedule paper --samples 1000000 -o out";
    let run = Onescan::new(place.path(), line).interrupt(Duration::from_secs(1));
    assert_eq!(run.code, Some(1), "{run:?}");
    let whole = fs::read(place.path().join(FILE)).unwrap();
    let mut flipped = whole.clone();
    flipped[whole.len() / 2] ^= 1;
    let mut newer = whole.clone();
    newer[7] = b'9';
    refuses(vec![
        Case { bytes: None, ..case("missing", FILE, "", FIT, "--resume") },
        case("no bytes", FILE, "", FIT, "damaged"),
        case("another job's", FILE, &whole[..], FIT, "another model, photo"),
        case("cut short", FILE, &whole[..whole.len() - 1], FIT, "damaged"),
        case("a bit flipped", FILE, flipped, FIT, "damaged"),
        case("another version", FILE, newer, FIT, "version"),
    ]);
}

#[test]
fn a_search_refuses_what_only_a_chain_can() {
    let place = tempdir().unwrap();
    for option in
        ["--samples 5", "--landmark-samples 5", "--shape-samples 5", "--chains 2", "--resume"]
    {
        let line = format!(
            "fit @golden/small.3dmm @photos/astronaut.png --landmarks @photos/astronaut.tlms \
             -o out {option}"
        );
        let run = Onescan::new(place.path(), &line).run();
        let name = option.split(' ').next().unwrap();
        assert_eq!((run.code, run.stderr.lines().count()), (Some(1), 1), "{run:?}");
        assert!(run.stderr.starts_with(&format!("onescan: {name} is for chains")), "{run:?}");
        assert!(run.stderr.contains("add --schedule paper"), "{run:?}");
    }
    assert!(listing(place.path()).is_empty());
}

#[test]
fn places_that_cannot_be_written() {
    const FIT: &str = "fit @golden/small.3dmm @photos/astronaut.png \
                       --landmarks @photos/astronaut.tlms -o taken";
    let taken = |line| case("a file for a directory", "taken", "mine", line, "cannot write");
    refuses(vec![
        taken(FIT),
        taken("sample @golden/small.3dmm -o taken"),
        taken("sample @golden/small.3dmm -o taken/deeper"),
        taken("demo --out taken"),
        taken("render @golden/small.3dmm -o taken/out.png"),
        taken("build @face/template.ply --rank 4 -o taken/out.3dmm"),
        Case {
            bytes: None,
            ..case(
                "no such directory",
                "nowhere/out.png",
                "",
                "render @golden/small.3dmm -o nowhere/out.png",
                "cannot write",
            )
        },
        Case {
            bytes: None,
            ..case("a directory", ".", "", "render @golden/small.3dmm -o .", "is a directory")
        },
    ]);
}

#[test]
fn mixtures_galleries_and_jobs_that_are_none() {
    const FIT: &str =
        "fit mix.toml @photos/astronaut.png --landmarks @photos/astronaut.tlms -o out";
    let mix = |what, bytes: &str, says| case(what, "mix.toml", bytes, FIT, says);
    let gallery = |what, file, bytes: Vec<u8>, line, says| case(what, file, bytes, line, says);
    let model = "[[component]]\nmodel = \"gone.3dmm\"\n";
    refuses(vec![
        mix("an empty mixture", "", "missing field `component`"),
        mix("a weight beyond adding", &format!("{model}weight = 1e308\n"), "expected a number"),
        mix("a weight of nothing", &format!("{model}weight = -1\n"), "expected a number above 0"),
        mix("no TOML", "[[component]\n", "line 1"),
        mix("a mixture in a mixture", "[[component]]\nmodel = \"a.toml\"\n", "name its models"),
        mix("a model of another field", &format!("{model}wieght = 1\n"), "line 3: unknown field"),
        case("a mixture for a model", "mix.toml", model, "info mix.toml", "is a mixture of models"),
        gallery(
            "a photo without a face",
            "anna.png",
            Picture::filled(64, 64, [90; 3]).to_png().unwrap(),
            "recognise . anna.png --model @golden/small.3dmm -o out",
            "anna.png: no face found",
        ),
        gallery(
            "a fit that is none",
            "anna.json",
            b"{\"fits\": 1}".to_vec(),
            "recognise . anna.json -o out",
            "fits: invalid type",
        ),
        gallery(
            "no fits",
            "anna.json",
            b"{\"fits\": []}".to_vec(),
            "recognise . anna.json -o out",
            "holds no fit",
        ),
    ]);
    let place = tempdir().unwrap();
    for (line, says) in [
        ("recognise . . -o out", "has no photos (.jpg, .png) and no fits"),
        ("recognise gone x.jpg -o out", "gone: "),
        ("recognise @rough @rough/05_15.jpg -o out", "say by which --model"),
        (
            "experiment recognition --models best -o out",
            "no model \"best\"; there are standard-full",
        ),
        ("experiment recognition --quick --job clean/me/00 -o out", "no job \"clean/me/00\""),
        ("experiment recognition --jobs --pictures gone -o out", "gone: "),
        ("model mix @golden/small.3dmm -o mix.3dmm", "its name must end in .toml"),
        ("model mix @golden/small.3dmm --weights 1 2 -o mix.toml", "1 models and 2 --weights"),
        (
            "fit @golden/small.3dmm @golden/small.3dmm @photos/astronaut.png --landmarks \
             @photos/astronaut.tlms -o out",
            "is named twice",
        ),
        (
            "fit @golden/small.3dmm @photos/astronaut.png @photos/astronaut.png -o out",
            "astronaut.png: is the same picture as",
        ),
        ("build @face/template.ply --subdivide 8 -o out.3dmm", "would be split into 1073086464"),
        ("inspect @face/template.ply --edge 0.001", "less by --subdivide or --edge"),
    ] {
        let run = Onescan::new(place.path(), line).run();
        assert_eq!(run.code, Some(1), "{line}: {run:?}");
        assert!(run.stderr.contains(says) && run.stderr.lines().count() <= 1, "{line}: {run:?}");
    }
}

#[test]
fn wrong_usage_is_told_apart() {
    let place = tempdir().unwrap();
    for line in [
        "fly",
        "build",
        "build scan.ply",
        "build scan.ply -o a.3dmm --rank 99999",
        "build scan.ply -o a.3dmm --rank 4 --variance 0.9",
        "build scan.ply -o a.3dmm --variance 2",
        "build scan.ply -o a.3dmm --kernels cubic",
        "build scan.ply -o a.3dmm --unit furlong",
        "build scan.ply -o a.3dmm --unit 0",
        "build scan.ply -o a.3dmm --up w",
        "build scan.ply -o a.3dmm --mirror sideways",
        "build scan.ply -o a.3dmm --mirror 0,0,0,1",
        "inspect scan.stl --colour 300,0,0",
        "inspect scan.ply --largest",
        "sample m.3dmm -o out -n 0",
        "render m.3dmm -o a.png --size 0x5",
        "render m.3dmm -o a.png --yaw east",
        "render m.3dmm -o a.png --pitch 1e30",
        "modes m.3dmm -o out --yaw nan",
        "modes m.3dmm -o out --deviations 1e300",
        "build scan.ply -o a.3dmm --mirror 1,0,0,1e38",
        "build scan.ply -o a.3dmm --mirror 1,0,nan,0",
        "build scan.ply -o a.3dmm --unit 1e38",
        "build scan.ply -o a.3dmm --variance nan",
        "register m.3dmm scan.ply -o out --width inf",
        "model project m.3dmm mesh.ply -o a.ply --noise nan",
        "fit m.3dmm p.png",
        "fit m.3dmm p.png -o out --face 0",
        "fit m.3dmm p.png --landmarks p.tlms -o out --face 1",
        "fit m.3dmm p.png --landmarks p.tlms -o out --chains 0",
        "fit m.3dmm p.png --landmarks p.tlms -o out --samples -1",
        "fit m.3dmm p.png --landmarks p.tlms -o out --schedule fastest",
    ] {
        let run = Onescan::new(place.path(), line).run();
        assert_eq!(run.code, Some(2), "{line}: {run:?}");
        assert!(run.stderr.contains("Usage") || run.stderr.contains("--help"), "{line}: {run:?}");
        assert!(!run.stderr.contains("panicked"), "{line}: {run:?}");
    }
    assert!(listing(place.path()).is_empty());
}
