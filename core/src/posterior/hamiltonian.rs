//! Hamiltonian Monte Carlo about a normal distribution.
//!
//! The density is `exp(−½‖v‖² − Φ(v))`, near a standard normal. A trajectory turns position and
//! momentum by an angle, which is the exact motion in the normal part, and between turns kicks the
//! momentum by `−∇Φ` (Beskos, Pinski, Sanz-Serna & Stuart 2011): directions in which `Φ` is
//! constant, those that the prior decides, cost no accuracy, however many they are. The force need
//! not be a gradient: with any function of the position in its place a trajectory keeps volumes and can be
//! gone back, and the test at the end, `exp(H − H')` with `H = E + ½‖p‖²`, makes up for the difference.

use super::Unknowns;
use crate::math;
use crate::metropolis::{Drawn, Factor, Moves, New, Target};
use crate::rng::Rng;

/// A density with a force.
pub trait Field {
    /// `E(v) = −ln π(v)` up to a constant, and `−∇E` into `force`; `None` where the density is
    /// nought.
    fn energy(&mut self, position: &[f32], force: &mut [f32]) -> Option<f64>;
}

/// A state.
#[derive(Clone, Debug)]
pub struct State {
    /// `v`.
    pub position: Unknowns,
    /// `−∇E` there.
    pub force: Unknowns,
    /// `E` there.
    pub energy: f64,
}

impl State {
    /// Computes energy and force of the position; whether the density is more than nought there.
    pub(super) fn look(&mut self, field: &mut impl Field) -> bool {
        let Self { position, force, energy } = self;
        let found = field.energy(position, force);
        *energy = found.unwrap_or(f64::INFINITY);
        found.is_some()
    }
}

/// The density of a [`Field`], for [`crate::metropolis::step`].
pub struct Density<F>(pub F);

impl<F: Field> Target for Density<F> {
    type State = State;
    type Touched = ();
    type Density = [f64; 1];
    const FACTORS: &'static [Factor] = &[Factor::cheap("posterior")];

    fn ln_factor(&mut self, _: usize, new: &New<'_, Self>, _: f64, _: f64) -> Option<f64> {
        Some(-new.to.energy)
    }
}

/// A trajectory: so many turns by this angle.
#[derive(Clone, Copy, Debug)]
pub struct Trajectory {
    /// Angle of a turn, radians, below a quarter turn.
    pub angle: f64,
    /// Turns.
    pub turns: u32,
}

impl Trajectory {
    /// `p ← p − tan(δ/2) ∇Φ`, `∇Φ = −force − v`.
    fn kick(&self, state: &State, momentum: &mut [f32]) {
        let k = self.half();
        for ((p, f), v) in momentum.iter_mut().zip(&state.force).zip(&state.position) {
            *p += k * (f + v);
        }
    }

    fn half(&self) -> f32 {
        let (sin, cos) = math::sin_cos((0.5 * self.angle) as f32);
        sin / cos
    }

    fn turn(&self, state: &mut State, momentum: &mut [f32]) {
        let (sin, cos) = math::sin_cos(self.angle as f32);
        for (v, p) in state.position.iter_mut().zip(momentum) {
            (*v, *p) = (cos * *v + sin * *p, cos * *p - sin * *v);
        }
    }
}

fn half_square(values: &[f32]) -> f64 {
    0.5 * values.iter().map(|&x| f64::from(x) * f64::from(x)).sum::<f64>()
}

impl<F: Field> Moves<Density<F>> for Trajectory {
    fn draw(
        &mut self,
        _: usize,
        target: &mut Density<F>,
        state: &mut State,
        rng: &mut Rng,
    ) -> Option<Drawn<()>> {
        let mut momentum = state.position.clone();
        for p in &mut momentum {
            *p = rng.normal() as f32;
        }
        let before = half_square(&momentum);
        for _ in 0..self.turns {
            self.kick(state, &mut momentum);
            self.turn(state, &mut momentum);
            let State { position, force, energy } = state;
            *energy = target.0.energy(position, force)?;
            self.kick(state, &mut momentum);
        }
        Some(Drawn { touched: (), ln_ratio: before - half_square(&momentum), due: 0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metropolis;

    /// `Φ = 1.5 (1 − cos(1.3x + y)) + 0.3 (x² − y)²`, whose force is off by a swirl that is nobody's
    /// gradient.
    struct Wavy {
        swirl: f32,
    }

    fn ripple(v: &[f32]) -> f64 {
        let (x, y) = (f64::from(v[0]), f64::from(v[1]));
        1.5 * (1.0 - (1.3 * x + y).cos()) + 0.3 * (x * x - y) * (x * x - y)
    }

    impl Field for Wavy {
        fn energy(&mut self, v: &[f32], force: &mut [f32]) -> Option<f64> {
            let (x, y) = (v[0], v[1]);
            let (wave, bend) = (1.5 * (1.3 * x + y).sin(), 0.6 * (x * x - y));
            force[0] = -x - 1.3 * wave - 2.0 * x * bend + self.swirl * y;
            force[1] = -y - wave + bend - self.swirl * x;
            // The space has an end.
            (x > -3.0).then(|| half_square(v) + ripple(v))
        }
    }

    /// An exact draw: normal numbers, kept by chance `exp −Φ`.
    fn draw(field: &mut Wavy, rng: &mut Rng) -> State {
        loop {
            let position: Unknowns = (0..2).map(|_| rng.normal() as f32).collect();
            let mut force = position.clone();
            if let Some(energy) = field.energy(&position, &mut force)
                && rng.uniform().ln() < -ripple(&position)
            {
                return State { position, force, energy };
            }
        }
    }

    /// Trajectories whose kinetic energy is forgotten.
    struct Forgetful(Trajectory);

    impl Moves<Density<Wavy>> for Forgetful {
        fn draw(
            &mut self,
            leaf: usize,
            target: &mut Density<Wavy>,
            state: &mut State,
            rng: &mut Rng,
        ) -> Option<Drawn<()>> {
            let drawn = self.0.draw(leaf, target, state, rng)?;
            Some(Drawn { ln_ratio: 0.0, ..drawn })
        }
    }

    /// The largest drift of some statistics from exact draws on, in standard errors.
    fn drift(moves: &mut impl Moves<Density<Wavy>>, swirl: f32) -> f64 {
        const REPLICATES: usize = 20_000;
        let mut target = Density(Wavy { swirl });
        let mut rng = Rng::new(11, 0);
        let statistics = |v: &[f32]| {
            let (x, y) = (f64::from(v[0]), f64::from(v[1]));
            [x, y, x * x, y * y, x * y, ripple(v), x * x * x]
        };
        let mut sums = [[0.0; 2]; 7];
        for _ in 0..REPLICATES {
            let mut state = draw(&mut target.0, &mut rng);
            let before = statistics(&state.position);
            let mut density = [-state.energy];
            for _ in 0..3 {
                metropolis::step(&mut target, moves, 0, 1, &mut state, &mut density, &mut rng);
            }
            let after = statistics(&state.position);
            for (sum, (after, before)) in sums.iter_mut().zip(after.into_iter().zip(before)) {
                let change = after - before;
                *sum = [sum[0] + change, sum[1] + change * change];
            }
        }
        let z = |[sum, squares]: [f64; 2]| {
            let n = REPLICATES as f64;
            let variance = squares / n - (sum / n) * (sum / n);
            (sum / n).abs() / (variance / n).sqrt()
        };
        sums.into_iter().map(z).fold(0.0, f64::max)
    }

    /// Of the 42 statistics one is beyond 4.5 by chance in 3,500 runs.
    #[test]
    fn the_density_stays_whatever_the_force() {
        for swirl in [0.0, 0.4] {
            for (angle, turns) in [(0.3, 4), (0.8, 2), (0.1, 1)] {
                let z = drift(&mut Trajectory { angle, turns }, swirl);
                assert!(z < 4.5, "swirl {swirl}, {turns} × {angle}: {z}");
            }
        }
    }

    #[test]
    fn a_forgotten_energy_is_found() {
        let z = drift(&mut Forgetful(Trajectory { angle: 0.8, turns: 2 }), 0.4);
        assert!(z > 8.0, "{z}");
    }

    #[test]
    fn in_the_normal_part_nothing_is_rejected() {
        struct Normal;
        impl Field for Normal {
            fn energy(&mut self, v: &[f32], force: &mut [f32]) -> Option<f64> {
                for (f, v) in force.iter_mut().zip(v) {
                    *f = -v;
                }
                Some(half_square(v))
            }
        }
        let mut target = Density(Normal);
        let mut rng = Rng::new(3, 0);
        let position: Unknowns = (0..400).map(|_| rng.normal() as f32).collect();
        let force = position.iter().map(|v| -v).collect();
        let mut state = State { force, energy: half_square(&position), position };
        for _ in 0..20 {
            let before = state.energy;
            let mut moves = Trajectory { angle: 0.35, turns: 4 };
            let drawn = moves.draw(0, &mut target, &mut state, &mut rng).unwrap();
            let gain = before - state.energy + drawn.ln_ratio;
            assert!(gain.abs() < 1e-3, "{gain}");
        }
    }
}
