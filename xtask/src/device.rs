//! `cargo xtask device`: the firmwares of tests/device on an emulated Cortex-M7. They must compute
//! the golden bits within its memory, and hold nothing that could panic or allocate; what they show
//! is saved as target/device-chain.png and target/device-search.png.

use crate::golden::{Case, FITS};
use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::targets::{BARE, Cross, install};
use crate::{Outcome, no_arguments};
use object::{Object as _, ObjectSymbol as _};
use std::fs;
use std::path::Path;

const TARGET: &str = "thumbv7em-none-eabihf";
const EMULATOR: &str = "qemu-system-arm";
/// The board, its console, and time that counts instructions: one a nanosecond.
const MACHINE: [&str; 8] = [
    "-M",
    "mps2-an500",
    "-nographic",
    "-icount",
    "shift=0",
    "-semihosting-config",
    "enable=on,target=native",
    "-kernel",
];

/// The command.
pub(crate) fn run(arguments: &[String]) -> Outcome {
    no_arguments(arguments)?;
    check()
}

/// Builds, runs, compares.
pub(crate) fn check() -> Outcome {
    let built = target().join("device");
    let crate_ = root().join("tests/device");
    // Not of the workspace, so no other stage looks at it.
    sh(cargo(["fmt", "--check"]).current_dir(&crate_))?;
    let firmware = Cross {
        target: TARGET,
        crate_: &crate_,
        arguments: &["build", "--release"],
        std: BARE,
        flags: "-C link-arg=-Tlink.x -C target-cpu=cortex-m7",
        debian_flags: "-C linker=ld.lld-19 -C linker-flavor=ld.lld",
    };
    firmware.build(&built).map_err(|e| {
        format!(
            "{e}\nif a_panic_is_reachable is what the linker misses, tests/device/src/lib.rs says \
             how to find out from where"
        )
    })?;
    if output(&mut command(EMULATOR, ["--version"])).is_err() {
        install(&[EMULATOR])?;
    }
    for (name, fingerprint) in ["chain", "search"].into_iter().zip(FITS) {
        let program = built.join(TARGET).join("release").join(name);
        without_panic_and_heap(&program)?;
        let printed = output(command(EMULATOR, MACHINE).arg(program))?;
        let (mut lines, mut rows) = (Vec::new(), Vec::new());
        for line in printed.lines() {
            match line.strip_prefix("row ") {
                Some(row) => rows.push(row),
                None if line.ends_with(" B") || line.ends_with(" instructions") => {
                    println!("{line}");
                }
                None => lines.push(line),
            }
        }
        Case::Small.compare("Cortex-M7", &[fingerprint], &lines.join("\n"))?;
        save(&rows, &target().join(format!("device-{name}.png")))?;
    }
    Ok(())
}

/// Looks at what was linked: no panic handler, nothing that would call it, no allocator. The
/// linker has refused a panic handler already; this tells it from one that was only renamed.
fn without_panic_and_heap(program: &Path) -> Outcome {
    let fault = |e: &dyn std::fmt::Display| format!("{}: {e}", program.display());
    let bytes = fs::read(program).map_err(|e| fault(&e))?;
    let file = object::File::parse(&*bytes).map_err(|e| fault(&e))?;
    let names: Vec<&str> = file.symbols().filter_map(|symbol| symbol.name().ok()).collect();
    // A stripped program would prove nothing.
    if !names.contains(&"Reset") {
        return Err(fault(&"no symbol Reset, so its symbols say nothing"));
    }
    let forbidden =
        ["panic", "rust_begin_unwind", "__rust_alloc", "__rust_realloc", "__rdl_", "__rg_"];
    if let Some(name) = names.iter().find(|name| forbidden.iter().any(|word| name.contains(word))) {
        return Err(fault(&format!("{name} is linked, but nothing in it may panic or allocate")));
    }
    println!("of {} symbols none belongs to a panic or an allocator", names.len());
    Ok(())
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
