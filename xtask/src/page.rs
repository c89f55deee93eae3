//! `cargo xtask wasm`, `serve`, `browser`: the browser's shell and its page.

use crate::golden::Case;
use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::targets::{Cross, install};
use crate::{Outcome, no_arguments, notices, wasm};
use flate2::Compression;
use flate2::write::GzEncoder;
use std::fs;
use std::hash::{DefaultHasher, Hasher as _};
use std::io::Write as _;
use std::path::{Path, PathBuf};

const TARGET: &str = "wasm32-unknown-unknown";
/// Endings of the files that the page needs without a network.
const KEPT: [&str; 8] = [".html", ".js", ".css", ".svg", ".wasm", ".gz", ".tflite", ".txt"];

/// `cargo xtask wasm`.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    build()
}

/// `cargo xtask serve [PORT]`.
pub(crate) fn serve(arguments: &[String]) -> Outcome {
    let port = match arguments {
        [] => "8080",
        [port] if port.parse::<u16>().is_ok() => port,
        _ => return Err("expected one port number".into()),
    };
    build()?;
    let program = ["run", "--quiet", "--release", "--package", "onescan", "--"];
    sh(cargo(program).args(["serve", "--page", "wasm/dist", "--port", port]))
}

/// `cargo xtask browser`.
pub(crate) fn test(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds the page and tries it in a real browser.
pub(crate) fn check() -> Outcome {
    build()?;
    // That the page within the program compiles; its files have been made just now.
    sh(&mut cargo([
        "check",
        "--quiet",
        "--release",
        "--package",
        "onescan",
        "--features",
        "page",
    ]))?;
    if output(&mut command("chromium", ["--version"])).is_err() {
        install(&["chromium"])?;
    }
    sh(&mut cargo(["build", "--quiet", "--release", "--package", "onescan"]))?;
    let onescan = target().join("release/onescan");
    let place = target().join("browser");
    fs::create_dir_all(&place).map_err(|e| fault(&place, &e))?;
    let mut tests = command("node", ["--test", "wasm/tests"]);
    tests.env("ONESCAN", onescan).env("OUT", place).env("FULL", Case::Full.inputs()?);
    for (kind, flags) in wasm::KINDS {
        tests.env(format!("STAGES_{}", kind.to_uppercase()), wasm::stages(kind, flags)?);
    }
    sh(&mut tests)
}

/// Everything into wasm/dist: the page, and the npm package it is made of; and the page's model into
/// a package of its own, wasm/face.
fn build() -> Outcome {
    let wasm = root().join("wasm");
    let dist = wasm.join("dist");
    if dist.exists() {
        fs::remove_dir_all(&dist).map_err(|e| fault(&dist, &e))?;
    }
    packages(&wasm)?;
    let copy = |from: &Path, to: &str| {
        let to = dist.join(to);
        let directory = to.parent().unwrap_or(&dist);
        fs::create_dir_all(directory).map_err(|e| fault(directory, &e))?;
        fs::copy(from, &to).map(|_| ()).map_err(|e| fault(from, &e))
    };
    for directory in ["js", "page"] {
        for file in files(&wasm.join(directory))? {
            let name = file.file_name().unwrap_or_default().to_string_lossy();
            copy(&file, &format!("{directory}/{name}"))?;
        }
    }
    for name in ["index.html", "package.json", "README.md"] {
        copy(&wasm.join(name), name)?;
    }
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        copy(&root().join(name), name)?;
    }
    for file in files(&root().join("fixtures/face_mesh"))? {
        let name = file.file_name().unwrap_or_default().to_string_lossy();
        copy(&file, &format!("js/face_mesh/{name}"))?;
    }
    fs::write(dist.join("LICENSES.txt"), licences()?).map_err(|e| fault(&dist, &e))?;
    for photo in ["astronaut.png", "grace_hopper.jpg", "obama.jpg"] {
        let landmarks = Path::new(photo).with_extension("tlms");
        for name in [Path::new(photo), &landmarks] {
            let to = format!("samples/{}", name.display());
            copy(&root().join("fixtures/photos").join(name), &to)?;
        }
    }
    let made = target().join("page/program");
    for program in &PROGRAMS {
        program.build(&made)?;
        for end in [".d.ts", "_bg.wasm", "_bg.wasm.d.ts"] {
            let name = format!("{}{end}", program.name);
            copy(&made.join(&name), &format!("js/wasm/{name}"))?;
        }
    }
    // Checked, declared, and then without the comments, which are a quarter of the scripts.
    let compiler = wasm.join("node_modules/.bin/tsc");
    for configuration in ["tsconfig.json", "tsconfig.types.json", "tsconfig.page.json"] {
        sh(&mut command(&compiler, ["--project", &format!("wasm/{configuration}")]))?;
    }
    let plain = ["--allowJs", "--removeComments", "--target", "es2022", "--module", "es2022"];
    for Program { name, .. } in &PROGRAMS {
        let (from, to) = (made.join(format!("{name}.js")), dist.join("js/wasm"));
        sh(command(&compiler, plain).arg(from).arg("--outDir").arg(to))?;
    }
    let model = model()?;
    for (file, bytes) in
        [(wasm.join("face/face.3dmm"), &model), (dist.join("face.3dmm.gz"), &compressed(&model)?)]
    {
        fs::write(&file, bytes).map_err(|e| fault(&file, &e))?;
    }
    keeper(&wasm, &dist)?;
    println!("the page is in {}", dist.display());
    Ok(())
}

/// The script that keeps the page for days without a network: which files, and a hash of them all.
fn keeper(wasm: &Path, dist: &Path) -> Outcome {
    let mut hash = DefaultHasher::new();
    let mut names = vec![r#""./""#.to_owned()];
    for directory in ["", "page", "js", "js/wasm", "js/face_mesh"] {
        for file in files(&dist.join(directory))? {
            let name = file.strip_prefix(dist).unwrap_or(&file).to_string_lossy().into_owned();
            if KEPT.iter().any(|end| name.ends_with(end)) && !name.ends_with(".d.ts") {
                hash.write(name.as_bytes());
                hash.write(&fs::read(&file).map_err(|e| fault(&file, &e))?);
                names.push(format!("{name:?}"));
            }
        }
    }
    let source = wasm.join("sw.js");
    let script = fs::read_to_string(&source).map_err(|e| fault(&source, &e))?;
    hash.write(script.as_bytes());
    let (version, names) = (hash.finish(), names.join(", "));
    let text = format!("const VERSION = '{version:016x}';\nconst FILES = [{names}];\n{script}");
    fs::write(dist.join("sw.js"), text).map_err(|e| fault(dist, &e))
}

/// What the page is made of, and under which licences.
fn licences() -> Result<String, String> {
    Ok(format!(
        "onescan and this page: MIT (LICENSE-MIT) or Apache-2.0 (LICENSE-APACHE), at your option.\n\n\
         Landmarks are found by two networks of MediaPipe, Google: Apache-2.0\n\
         (js/face_mesh/LICENSE).\n\n\
         The face model is made from a scan that is in the public domain (CC0). The sample photos\n\
         are by NASA, the US Navy and the White House: in the public domain.\n\n\
         The programs contain these Rust crates:\n\n{}",
        notices::of(&["onescan-wasm", "onescan-faces"], TARGET)?
    ))
}

/// Node and what the page takes from npm.
fn packages(wasm: &Path) -> Outcome {
    if output(&mut command("npm", ["--version"])).is_err() {
        install(&["nodejs", "npm"])?;
    }
    let (lock, done) = (wasm.join("package-lock.json"), wasm.join("node_modules/.done"));
    let [wanted, had] = [&lock, &done].map(|path| fs::read(path).unwrap_or_default());
    if wanted == had {
        return Ok(());
    }
    sh(command("npm", ["ci", "--no-audit", "--no-fund"]).current_dir(wasm))?;
    fs::copy(&lock, &done).map(|_| ()).map_err(|e| fault(&done, &e))
}

/// A module for the browser.
struct Program {
    name: &'static str,
    folder: &'static str,
    profile: &'static str,
}

/// The fit, what reads photos, and what finds faces in them.
const PROGRAMS: [Program; 3] = [
    Program { name: "onescan_wasm", folder: "wasm", profile: "web" },
    Program { name: "onescan_photos", folder: "wasm/photos", profile: "web" },
    Program { name: "onescan_faces", folder: "wasm/faces", profile: "faces" },
];

impl Program {
    /// Makes the module and its glue.
    fn build(&self, place: &Path) -> Outcome {
        let &Self { name, folder, profile } = self;
        let crate_ = root().join(folder);
        let module = Cross {
            target: TARGET,
            crate_: &crate_,
            arguments: &["build", "--profile", profile],
            std: "std,panic_abort",
            flags: "-C target-feature=+simd128",
            debian_flags: "-C linker=wasm-ld-19",
        };
        let built = target().join("wasm/simd128");
        module.build(&built)?;
        let module = built.join(TARGET).join(profile).join(format!("{name}.wasm"));
        let tool = target().join("bindgen");
        let build = ["build", "--quiet", "--target-dir"];
        sh(cargo(build).arg(&tool).current_dir(root().join("wasm/bindgen")))?;
        sh(command(tool.join("debug/onescan-bindgen"), [module]).arg(place))
    }
}

/// The page's model.
fn model() -> Result<Vec<u8>, String> {
    let place = target().join("page");
    fs::create_dir_all(&place).map_err(|e| fault(&place, &e))?;
    let [full, small] = ["face.3dmm", "page.3dmm"].map(|name| place.join(name));
    let onescan = |arguments: &[&str], to: &Path| {
        let run = ["run", "--quiet", "--release", "--package", "onescan", "--", "--quiet"];
        sh(cargo(run).args(arguments).arg("-o").arg(to))
    };
    let scan = "fixtures/face/template.ply";
    onescan(&["build", scan, "--landmarks", "fixtures/face/landmarks.json"], &full)?;
    onescan(&["export", &full.to_string_lossy(), "--page"], &small)?;
    fs::read(&small).map_err(|e| fault(&small, &e))
}

fn compressed(bytes: &[u8]) -> Result<Vec<u8>, String> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::best());
    encoder.write_all(bytes).and_then(|()| encoder.finish()).map_err(|e| e.to_string())
}

/// The files, not the directories, of a directory.
fn files(directory: &Path) -> Result<Vec<PathBuf>, String> {
    let entries = fs::read_dir(directory).map_err(|e| fault(directory, &e))?;
    let paths = entries.map(|entry| entry.map(|entry| entry.path()));
    let mut paths: Vec<_> = paths.collect::<Result<_, _>>().map_err(|e| fault(directory, &e))?;
    paths.retain(|path| path.is_file());
    paths.sort();
    Ok(paths)
}

fn fault(path: &Path, error: &dyn std::fmt::Display) -> String {
    format!("{}: {error}", path.display())
}
