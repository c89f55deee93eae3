//! The firmware that runs the chain.

#![no_std]
#![no_main]

use cortex_m::singleton;
use cortex_m_rt::entry;
use onescan_case::{SIDE, WORDS, fit, picture, stages, write_chain};
use onescan_core::draw::show;
use onescan_core::engine::Engine;
use onescan_device::{Screen, firmware, save, screen_bytes, timed};

type Display = Screen<SIDE, { screen_bytes(SIDE) }>;

#[entry]
fn main() -> ! {
    firmware(|out| {
        let memory = singleton!(: [u32; WORDS] = [0; WORDS])?;
        let screen = singleton!(: Display = Display::new())?;
        let hashes = stages(memory, Engine::PORTABLE)?;
        let fitted = timed(out, "chain", || fit(memory, Engine::PORTABLE, true))?;
        write_chain(out, &hashes, fitted.fingerprint).ok()?;
        // Cannot fail: the screen is memory.
        picture(memory, &fitted.scene, |colors| {
            let Ok(()) = show(colors, SIDE, screen);
        })?;
        save(screen, out)
    })
}
