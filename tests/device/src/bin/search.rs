//! The firmware that searches for the mode.

#![no_std]
#![no_main]

use cortex_m::singleton;
use cortex_m_rt::entry;
use onescan_case::{HALF_SIDE, SEARCH_WORDS, half_picture, search, write_search};
use onescan_core::draw::show;
use onescan_core::engine::Engine;
use onescan_device::{Screen, firmware, save, screen_bytes, timed};

type Display = Screen<HALF_SIDE, { screen_bytes(HALF_SIDE) }>;

#[entry]
fn main() -> ! {
    firmware(|out| {
        let memory = singleton!(: [u32; SEARCH_WORDS] = [0; SEARCH_WORDS])?;
        let screen = singleton!(: Display = Display::new())?;
        let found = timed(out, "search", || search(memory, Engine::PORTABLE))?;
        write_search(out, &found).ok()?;
        // Cannot fail: the screen is memory.
        half_picture(memory, &found.scene, |colors| {
            let Ok(()) = show(colors, HALF_SIDE, screen);
        })?;
        save(screen, out)
    })
}
