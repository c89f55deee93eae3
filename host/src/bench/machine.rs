//! What bounds any program on this machine.

use crate::simd;
use serde::Serialize;
use std::hint::black_box;
use std::mem::size_of;
use std::time::{Duration, Instant};

/// Passes of [`simd::arithmetic`] timed together: some ten microseconds.
const PASSES: u32 = 2000;
/// Time spent on whatever is timed.
const BUDGET: Duration = Duration::from_millis(150);
/// Read to measure the bandwidth of the memory: more than the caches of common machines hold.
const MEMORY_BYTES: usize = 256 << 20;
/// Read to measure the bandwidth of the cache: more than one core's own, and about what the steps
/// of a fit read again and again (50 components of shape or albedo are 2.5 MB).
const CACHE_BYTES: usize = 8 << 20;

/// How fast this machine reads, one core, 10⁹ bytes per second.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Bandwidth {
    /// A buffer larger than the caches.
    pub memory: f64,
    /// A buffer of 8 MiB, about what the steps of a fit read again and again.
    pub cache: f64,
}

impl Bandwidth {
    pub(super) fn measure() -> Self {
        Self { memory: read_bandwidth(MEMORY_BYTES), cache: read_bandwidth(CACHE_BYTES) }
    }
}

/// The most single-precision operations of one core, 10⁹ per second, not fused.
pub(super) fn peak_gflops() -> f64 {
    let passes = fastest(|| simd::arithmetic(PASSES));
    simd::OPERATIONS as f64 * f64::from(PASSES) / passes / 1e9
}

/// Seconds of the fastest call within [`BUDGET`].
pub(super) fn fastest<T>(mut call: impl FnMut() -> T) -> f64 {
    let mut best = f64::INFINITY;
    let begin = Instant::now();
    while begin.elapsed() < BUDGET {
        let start = Instant::now();
        black_box(call());
        best = best.min(start.elapsed().as_secs_f64());
    }
    best
}

/// 10⁹ bytes per second of reading a buffer from front to back, again and again; each slice
/// counts with its fastest pass.
fn read_bandwidth(bytes: usize) -> f64 {
    const SLICE: usize = (1 << 20) / size_of::<u64>();
    // Not zeros: those the system would give as one and the same page.
    let buffer = black_box(vec![1_u64; bytes / size_of::<u64>()]);
    let mut times = vec![Duration::MAX; buffer.len().div_ceil(SLICE)];
    let begin = Instant::now();
    while begin.elapsed() < BUDGET {
        for (time, slice) in times.iter_mut().zip(buffer.chunks(SLICE)) {
            let start = Instant::now();
            black_box(slice.iter().fold(0_u64, |sum, x| sum.wrapping_add(*x)));
            *time = start.elapsed().min(*time);
        }
    }
    bytes as f64 / times.iter().sum::<Duration>().as_secs_f64() / 1e9
}
