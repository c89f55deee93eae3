//! `cargo xtask device`: the firmware of tests/device on an emulated Cortex-M7. It must compute
//! the golden bits within its memory; what it shows is saved as target/device.png.

use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::{Outcome, no_arguments};
use std::fs;
use std::path::Path;

const TARGET: &str = "thumbv7em-none-eabihf";
const EMULATOR: &str = "qemu-system-arm";
const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_LINKER: &str = "/usr/bin/ld.lld-19";

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds, runs, compares.
pub(crate) fn check() -> Outcome {
    let built = target().join("device");
    build(&built)?;
    if output(&mut command(EMULATOR, ["--version"])).is_err() {
        install(&[EMULATOR])?;
    }
    let program = built.join(TARGET).join("release/onescan-device");
    let machine = ["-M", "mps2-an500", "-nographic", "-semihosting-config"];
    let printed = output(
        command(EMULATOR, machine).args(["enable=on,target=native", "-kernel"]).arg(program),
    )?;

    let golden = root().join("fixtures/golden/device.txt");
    let golden = fs::read_to_string(&golden).map_err(|e| format!("{}: {e}", golden.display()))?;
    let mut rows = Vec::new();
    let mut found = printed.lines();
    for expected in golden.lines() {
        let line = found.next().unwrap_or("nothing");
        if line != expected {
            return Err(format!("the device computes {line}, every other target {expected}"));
        }
    }
    println!("the device computes the golden bits: {}", golden.lines().last().unwrap_or_default());
    for line in found {
        match line.strip_prefix("row ") {
            Some(row) => rows.push(row),
            None => println!("{line} bytes"),
        }
    }
    save(&rows, &target().join("device.png"))
}

/// Compiles the firmware with rustup's target or, where rustup has none and cannot load it, with
/// Debian's compiler and a core library built on the spot.
fn build(place: &Path) -> Outcome {
    let arguments = ["build", "--quiet", "--release", "--target", TARGET, "--target-dir"];
    let firmware = root().join("tests/device");
    // Not of the workspace, so no other stage looks at it.
    sh(cargo(["fmt", "--check"]).current_dir(&firmware))?;
    let has = || {
        let installed = output(&mut command("rustup", ["target", "list", "--installed"]));
        installed.is_ok_and(|list| list.lines().any(|line| line == TARGET))
    };
    if has() || sh(&mut command("rustup", ["target", "add", TARGET])).is_ok() && has() {
        return sh(cargo(arguments).arg(place).current_dir(firmware));
    }
    println!("rustup cannot load {TARGET}: trying Debian's compiler");
    if !Path::new(DEBIAN_RUSTC).exists() || !Path::new(DEBIAN_LINKER).exists() {
        install(&["rustc-web", "cargo-web", "rust-web-src", "lld-19"])?;
    }
    sh(command(DEBIAN_CARGO, arguments)
        .arg(place)
        .args(["-Z", "build-std=core,alloc,compiler_builtins"])
        .current_dir(firmware)
        .env_remove("RUSTUP_TOOLCHAIN")
        .env("RUSTC", DEBIAN_RUSTC)
        .env("RUSTC_BOOTSTRAP", "1")
        .env(
            "RUSTFLAGS",
            "-C link-arg=-Tlink.x -C target-cpu=cortex-m7 -C linker=ld.lld-19 \
             -C linker-flavor=ld.lld",
        ))
}

/// Installs Debian packages, or says what to install.
fn install(packages: &[&str]) -> Outcome {
    let names = packages.join(" ");
    sh(&mut command("apt-get", ["update"]))
        .and_then(|()| {
            let install = ["install", "--yes", "--no-install-recommends"];
            sh(command("apt-get", install).args(packages))
        })
        .map_err(|e| format!("{e}\ninstall by hand what Debian calls {names}"))
}

/// Rows of hexadecimal RGB565, little-endian, as a PNG, four times as large.
fn save(rows: &[&str], path: &Path) -> Outcome {
    const ZOOM: usize = 4;
    let mut pixels = Vec::new();
    for row in rows {
        let bytes: Result<Vec<u8>, _> =
            (0..row.len() / 2).map(|i| u8::from_str_radix(&row[2 * i..2 * i + 2], 16)).collect();
        let bytes = bytes.map_err(|e| format!("row {row}: {e}"))?;
        let row: Vec<u8> = bytes
            .chunks_exact(2)
            .map(|b| u16::from_le_bytes([b[0], b[1]]))
            .map(|v| [v >> 11 << 3, (v >> 5 & 63) << 2, (v & 31) << 3].map(|c| c as u8))
            .flat_map(|pixel| pixel.repeat(ZOOM))
            .collect();
        pixels.extend(row.repeat(ZOOM));
    }
    let height = ZOOM * rows.len();
    let width = pixels.len() / (3 * height.max(1));
    let fault = |e: &dyn std::fmt::Display| format!("{}: {e}", path.display());
    let file = fs::File::create(path).map_err(|e| fault(&e))?;
    let mut encoder = png::Encoder::new(file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder
        .write_header()
        .and_then(|mut writer| writer.write_image_data(&pixels))
        .map_err(|e| fault(&e))?;
    println!("it shows {}", path.display());
    Ok(())
}
