//! Random streams: one 64-bit seed, one independent stream per chain.

use crate::math;
use rand_core::{Rng as _, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};

/// A stream of uniform and normal deviates; where it stands is part of a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Position", into = "Position")]
pub struct Rng {
    generator: Xoshiro256PlusPlus,
    position: Position,
}

/// Where a stream stands. (The generator's crate can write its state only with std's serde.)
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Position {
    seed: u64,
    stream: u32,
    /// Numbers drawn so far.
    drawn: u64,
    /// The second deviate of the last accepted pair of [`Rng::normal`].
    spare: Option<f64>,
}

/// Positions beyond these are refused: a chain does not get there, and the way would take minutes. Chosen,
/// not measured.
const MAX_DRAWN: u64 = 1 << 36;
const MAX_STREAM: u32 = 1 << 20;

impl TryFrom<Position> for Rng {
    type Error = &'static str;

    fn try_from(position: Position) -> Result<Self, Self::Error> {
        if position.drawn > MAX_DRAWN || position.stream > MAX_STREAM {
            return Err("random stream out of range");
        }
        let mut rng = Self::new(position.seed, position.stream);
        for _ in 0..position.drawn {
            rng.generator.next_u64();
        }
        Ok(Self { position, ..rng })
    }
}

impl From<Rng> for Position {
    fn from(rng: Rng) -> Self {
        rng.position
    }
}

impl Rng {
    /// Stream number `stream` of a seed: xoshiro256++ seeded by `SplitMix64`, then `stream` jumps
    /// of 2¹²⁸ numbers each, so that streams never overlap.
    pub fn new(seed: u64, stream: u32) -> Self {
        let mut generator = Xoshiro256PlusPlus::seed_from_u64(seed);
        for _ in 0..stream {
            generator.jump();
        }
        Self { generator, position: Position { seed, stream, drawn: 0, spare: None } }
    }

    fn next(&mut self) -> u64 {
        self.position.drawn += 1;
        self.generator.next_u64()
    }

    /// Uniform in `[0, 1)`, 53 bits.
    pub fn uniform(&mut self) -> f64 {
        (self.next() >> 11) as f64 * (1.0 / (1_u64 << 53) as f64)
    }

    /// Uniform in `0..n`; 0 when `n` is 0. The bias of the multiply-shift is below `n·2⁻³²`.
    pub fn below(&mut self, n: u32) -> u32 {
        let high = self.next() >> 32;
        ((high * u64::from(n)) >> 32) as u32
    }

    /// Standard normal deviate, by Marsaglia's polar method in double precision.
    pub fn normal(&mut self) -> f64 {
        if let Some(z) = self.position.spare.take() {
            return z;
        }
        loop {
            let u = 2.0 * self.uniform() - 1.0;
            let v = 2.0 * self.uniform() - 1.0;
            let s = u * u + v * v;
            if s > 0.0 && s < 1.0 {
                let k = math::sqrt_f64(-2.0 * math::ln(s) / s);
                self.position.spare = Some(v * k);
                return u * k;
            }
        }
    }

    /// Normal deviate with mean 0 and the given standard deviation.
    pub fn normal_sd(&mut self, sd: f32) -> f32 {
        (self.normal() * f64::from(sd)) as f32
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn normal_has_normal_moments_and_tails() {
        let mut rng = Rng::new(1, 0);
        let n = 200_000;
        let (mut m1, mut m2, mut m4, mut beyond2) = (0.0, 0.0, 0.0, 0);
        for _ in 0..n {
            let z = rng.normal();
            m1 += z;
            m2 += z * z;
            m4 += z.powi(4);
            beyond2 += i32::from(z.abs() > 2.0);
        }
        let n = f64::from(n);
        assert!((m1 / n).abs() < 0.01);
        assert!((m2 / n - 1.0).abs() < 0.015);
        assert!((m4 / n - 3.0).abs() < 0.1);
        assert!((f64::from(beyond2) / n - 0.0455).abs() < 0.002);
    }

    #[test]
    fn streams_differ_and_repeat() {
        let first = |seed, stream| Rng::new(seed, stream).uniform().to_bits();
        assert_eq!(first(7, 2), first(7, 2));
        assert_ne!(first(7, 0), first(7, 1));
        assert_ne!(first(7, 0), first(8, 0));
    }
}
