//! Firmwares that fit a face: the model read from flash in place, all memory static, the result
//! drawn into a framebuffer. They print what every target prints, then what it cost. There are two,
//! since the chain's stack and the search's memory have no room side by side.

#![no_std]

use core::fmt::Write as _;
use cortex_m_semihosting::debug;
use cortex_m_semihosting::hio::{self, HostStream};
use embedded_graphics::framebuffer::{Framebuffer, buffer_size};
use embedded_graphics::pixelcolor::Rgb565;
use embedded_graphics::pixelcolor::raw::{LittleEndian, RawU16};

/// A display of `SIDE` × `SIDE` pixels in `N` bytes.
pub type Screen<const SIDE: usize, const N: usize> =
    Framebuffer<Rgb565, RawU16, LittleEndian, SIDE, SIDE, N>;

/// Bytes of a [`Screen`].
pub const fn screen_bytes(side: usize) -> usize {
    buffer_size::<Rgb565>(side, side)
}

/// Does what a firmware is for, says what it cost and ends the emulation. `run` gives `None` if
/// anything does not fit together.
pub fn firmware(run: impl FnOnce(&mut HostStream) -> Option<()>) -> ! {
    let unused = paint();
    start_timer();
    let done = hio::hstdout().ok().and_then(|mut out| run(&mut out));
    let deepest = unused.and_then(used);
    let status = match (done, deepest, hio::hstdout()) {
        (Some(()), Some(deepest), Ok(mut out)) => {
            let [data, flash] = sizes();
            let _ = writeln!(out, "flash {flash} B, static {data} B, stack {deepest} B");
            debug::EXIT_SUCCESS
        }
        _ => debug::EXIT_FAILURE,
    };
    loop {
        debug::exit(status);
    }
}

/// Computes, and prints how many instructions it took.
pub fn timed<T>(out: &mut HostStream, what: &str, compute: impl FnOnce() -> T) -> T {
    let before = ticks();
    let result = compute();
    let spent = u64::from(before.wrapping_sub(ticks())) * INSTRUCTIONS_PER_TICK;
    let _ = writeln!(out, "{what} {} million instructions", spent / 1_000_000);
    result
}

/// The board's first timer: control, value, reload.
const TIMER: *mut u32 = 0x4000_0000 as *mut u32;
/// It counts down at 25 MHz; the emulator runs an instruction per nanosecond.
const INSTRUCTIONS_PER_TICK: u64 = 40;

fn start_timer() {
    for (register, value) in [(2, u32::MAX), (1, u32::MAX), (0, 1)] {
        // SAFETY: a register of the board, which nobody else uses.
        unsafe { TIMER.add(register).write_volatile(value) };
    }
}

fn ticks() -> u32 {
    // SAFETY: as in `start_timer`.
    unsafe { TIMER.add(1).read_volatile() }
}

/// Sends the screen to the host, a line of hexadecimal RGB565 per row.
pub fn save<const SIDE: usize, const N: usize>(
    screen: &Screen<SIDE, N>,
    out: &mut HostStream,
) -> Option<()> {
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
