//! A firmware that fits a face: the model read from flash in place, all memory static, the result
//! drawn into a framebuffer. It prints what every target prints, then what it cost.

#![no_std]
#![no_main]

use core::fmt::Write as _;
use cortex_m::singleton;
use cortex_m_rt::entry;
use cortex_m_semihosting::debug;
use cortex_m_semihosting::hio::{self, HostStream};
use embedded_graphics::framebuffer::{Framebuffer, buffer_size};
use embedded_graphics::pixelcolor::Rgb565;
use embedded_graphics::pixelcolor::raw::{LittleEndian, RawU16};
use onescan_case::{SIDE, WORDS, fit, picture, stages, write_golden};
use onescan_core::draw::show;
use onescan_core::engine::Engine;

type Screen =
    Framebuffer<Rgb565, RawU16, LittleEndian, SIDE, SIDE, { buffer_size::<Rgb565>(SIDE, SIDE) }>;

#[entry]
fn main() -> ! {
    let unused = paint();
    let done = run();
    let deepest = unused.and_then(used);
    let status = match (done, deepest, hio::hstdout()) {
        (Some(()), Some(deepest), Ok(mut out)) => {
            let [data, flash] = sizes();
            let _ = writeln!(out, "flash {flash}\nstatic {data}\nstack {deepest}");
            debug::EXIT_SUCCESS
        }
        _ => debug::EXIT_FAILURE,
    };
    loop {
        debug::exit(status);
    }
}

/// The whole fit; `None` if anything does not fit together.
fn run() -> Option<()> {
    let memory = singleton!(: [u32; WORDS] = [0; WORDS])?;
    let screen = singleton!(: Screen = Screen::new())?;
    let mut out = hio::hstdout().ok()?;
    let hashes = stages(memory, &Engine::PORTABLE)?;
    let fitted = fit(memory, &Engine::PORTABLE, true)?;
    write_golden(&mut out, &hashes, fitted.fingerprint).ok()?;
    // Cannot fail: the screen is memory.
    picture(memory, &fitted.scene, |colors| {
        let Ok(()) = show(colors, SIDE, screen);
    })?;
    save(screen, &mut out)
}

/// Sends the screen to the host, a line of hexadecimal RGB565 per row.
fn save(screen: &Screen, out: &mut HostStream) -> Option<()> {
    for row in screen.data().chunks(2 * SIDE) {
        out.write_str("row ").ok()?;
        for byte in row {
            write!(out, "{byte:02x}").ok()?;
        }
        out.write_str("\n").ok()?;
    }
    Some(())
}

unsafe extern "C" {
    // Of cortex-m-rt's linker script: only their addresses mean anything.
    static __sidata: u32;
    static __sdata: u32;
    static __edata: u32;
    static __sheap: u32;
    static _stack_start: u32;
}

fn address(symbol: *const u32) -> usize {
    symbol as usize
}

/// Bytes of static memory, and of flash.
fn sizes() -> [usize; 2] {
    let [load, start, end, heap] =
        [&raw const __sidata, &raw const __sdata, &raw const __edata, &raw const __sheap]
            .map(address);
    [heap - start, load + (end - start)]
}

/// What unused stack is filled with.
const PAINT: u32 = 0xdead_5eed;
/// What `paint` itself may need below where it looks.
const MARGIN: usize = 512;

/// Fills the unused stack; the number of words of it.
#[inline(never)]
fn paint() -> Option<usize> {
    let (bottom, here) = (address(&raw const __sheap), cortex_m::register::msp::read() as usize);
    let words = here.checked_sub(bottom + MARGIN)? / 4;
    for i in 0..words {
        // SAFETY: between the statics and the stack pointer there is only unused memory.
        unsafe { (bottom as *mut u32).add(i).write_volatile(PAINT) };
    }
    Some(words)
}

/// Bytes of stack that were ever used, `painted` words having been filled; `None` if none of these is
/// left: the stack has grown into the statics.
fn used(painted: usize) -> Option<usize> {
    let bottom = address(&raw const __sheap) as *const u32;
    // SAFETY: as in `paint`; the memory is there, whoever has written to it.
    let clean = (0..painted).take_while(|&i| unsafe { bottom.add(i).read_volatile() } == PAINT);
    let clean = clean.count();
    let whole = address(&raw const _stack_start) - address(&raw const __sheap);
    (clean > 0).then_some(whole - 4 * clean)
}

unsafe extern "C" {
    /// Defined nowhere, and only the panic handler calls it: if anything left in the program could
    /// panic, the program does not link. Who that is says `arm-none-eabi-objdump -d` of what
    /// `-C link-arg=--defsym=a_panic_is_reachable=0` makes link: look for calls of `panic` and
    /// `fail`, and for their lines with `arm-none-eabi-addr2line -i`.
    fn a_panic_is_reachable() -> !;
}

/// Not linked, see [`a_panic_is_reachable`].
#[panic_handler]
fn panic(_: &core::panic::PanicInfo<'_>) -> ! {
    // SAFETY: never happens, there is no such function.
    unsafe { a_panic_is_reachable() }
}
