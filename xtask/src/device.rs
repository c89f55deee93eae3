//! `cargo xtask device`: the firmwares of tests/device on emulated microcontrollers. They must compute
//! the golden bits within their memory, and hold nothing that could panic or allocate; what they show
//! is saved as target/device-*.png.

use crate::golden::{Case, FITS};
use crate::shell::{cargo, command, output, root, run as sh, target};
use crate::targets::{BARE, Cross, install};
use crate::{Outcome, no_arguments};
use object::{Object as _, ObjectSymbol as _};
use std::fs;
use std::path::Path;

/// A microcontroller, and which core runs on it.
struct Device {
    name: &'static str,
    target: &'static str,
    flags: &'static str,
    features: &'static [&'static str],
    /// The emulator's board.
    board: &'static str,
    /// Of [`FIRMWARES`], those that run.
    firmwares: &'static [Firmware],
    golden: Case,
}

/// A program, and of its golden lines the one that says most.
type Firmware = (&'static str, &'static str);

const FIRMWARES: [Firmware; 2] = [("chain", FITS[0]), ("search", FITS[1])];

/// With and without a unit for floating-point numbers. A Cortex-M3 computes each in dozens of
/// instructions, and ours take a minute to emulate, so there only the search runs.
const DEVICES: [Device; 3] = [
    Device {
        name: "Cortex-M7",
        target: "thumbv7em-none-eabihf",
        flags: "-C link-arg=-Tlink.x -C target-cpu=cortex-m7",
        features: &[],
        board: "mps2-an500",
        firmwares: &FIRMWARES,
        golden: Case::Small,
    },
    Device {
        name: "Cortex-M3",
        target: "thumbv7m-none-eabi",
        flags: "-C link-arg=-Tlink.x",
        features: &[],
        board: "mps2-an385",
        firmwares: &[FIRMWARES[1]],
        golden: Case::Small,
    },
    Device {
        name: "Cortex-M3 micromath",
        target: "thumbv7m-none-eabi",
        flags: "-C link-arg=-Tlink.x",
        features: &["--features", "micromath"],
        board: "mps2-an385",
        firmwares: &[FIRMWARES[1]],
        golden: Case::Micromath,
    },
];

const EMULATOR: &str = "qemu-system-arm";
/// The console, and time that counts instructions: one a nanosecond.
const MACHINE: [&str; 6] = [
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
    // Not of the workspace, so no other check looks at it.
    sh(cargo(["fmt", "--check"]).current_dir(root().join("tests/device")))?;
    if output(&mut command(EMULATOR, ["--version"])).is_err() {
        install(&[EMULATOR])?;
    }
    DEVICES.iter().try_for_each(Device::check)
}

impl Device {
    fn check(&self) -> Outcome {
        let &Self { name, target: triple, flags, features, board, firmwares, golden } = self;
        let built = target().join("device");
        let crate_ = root().join("tests/device");
        let firmware = Cross {
            target: triple,
            crate_: &crate_,
            arguments: &[&["build", "--release"], features].concat(),
            std: BARE,
            flags,
            debian_flags: "-C linker=ld.lld-19 -C linker-flavor=ld.lld",
        };
        firmware.build(&built).map_err(|e| {
            format!(
                "{e}\nif a_panic_is_reachable is what the linker misses, tests/device/src/lib.rs \
                 says how to find out from where"
            )
        })?;
        for (firmware, fingerprint) in firmwares {
            let program = built.join(triple).join("release").join(firmware);
            without_panic_and_heap(&program)?;
            let printed = output(command(EMULATOR, ["-M", board]).args(MACHINE).arg(program))?;
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
            golden.compare(name, &[fingerprint], &lines.join("\n"))?;
            let place = name.to_lowercase().replace(' ', "-");
            save(&rows, &target().join(format!("device-{place}-{firmware}.png")))?;
        }
        Ok(())
    }
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
