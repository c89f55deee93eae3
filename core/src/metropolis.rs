//! One Metropolis–Hastings step, whatever is sampled.
//!
//! A [`Target`] is a product of factors, a proposal passes one test per factor, the cheapest first:
//! test `k` accepts with probability `min(1, (f_k(x')/f_k(x))^(1/T_k))`, `T_k` the factor's
//! temperature. The product of the tests satisfies detailed balance for the product of the factors,
//! and a bad proposal seldom costs what the last factor costs.
//!
//! What corrects for the way the proposal was drawn, `q(x' → x)·|J| / q(x → x')`, belongs as a
//! whole to one test: the test is then symmetric under exchange of `x` and `x'`. Halves of it at
//! two tests would balance neither.
//!
//! ```
//! use onescan_core::metropolis::{Drawn, Factor, Moves, New, Outcome, Target, step};
//! use onescan_core::rng::Rng;
//!
//! /// A number near 3, known to be positive.
//! struct Toy;
//!
//! impl Target for Toy {
//!     type State = f64;
//!     type Touched = ();
//!     type Density = [f64; 2];
//!     const FACTORS: &'static [Factor] = &[Factor::cheap("sign"), Factor::costly("distance")];
//!
//!     fn ln_factor(&mut self, k: usize, new: &New<'_, Self>, _: f64, floor: f64) -> Option<f64> {
//!         let ln = match k {
//!             0 if *new.to > 0.0 => 0.0,
//!             0 => f64::NEG_INFINITY,
//!             _ => -0.5 * (new.to - 3.0) * (new.to - 3.0),
//!         };
//!         (ln >= floor).then_some(ln)
//!     }
//! }
//!
//! /// The only leaf: a random walk.
//! struct Walk;
//!
//! impl Moves<Toy> for Walk {
//!     fn draw(&mut self, _: usize, _: &mut Toy, x: &mut f64, rng: &mut Rng) -> Option<Drawn<()>> {
//!         *x += rng.normal();
//!         Some(Drawn { touched: (), ln_ratio: 0.0, due: 0 })
//!     }
//! }
//!
//! let (mut state, mut density) = (3.0, [0.0, 0.0]);
//! let mut rng = Rng::new(7, 0);
//! let mut sum = 0.0;
//! for _ in 0..20_000 {
//!     let outcome = step(&mut Toy, &mut Walk, 0, 0b11, &mut state, &mut density, &mut rng);
//!     assert!(state > 0.0 && outcome != Outcome::Failed);
//!     sum += state / 20_000.0;
//! }
//! assert!((sum - 3.0).abs() < 0.05);
//! ```

use crate::math;
use crate::rng::Rng;

/// Which factors are looked at: bit `k` is factor `k` of [`Target::FACTORS`].
pub type Factors = u8;

/// One factor of a target.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Factor {
    /// What reports call it.
    pub name: &'static str,
    /// Whether the test's threshold is drawn before the factor is evaluated, so that the evaluation may be
    /// given up midway. For a cheap factor it is drawn afterwards, and only if it decides.
    pub costly: bool,
}

impl Factor {
    /// A factor that is always evaluated to the end.
    pub const fn cheap(name: &'static str) -> Self {
        Self { name, costly: false }
    }

    /// A factor whose evaluation may be given up midway.
    pub const fn costly(name: &'static str) -> Self {
        Self { name, costly: true }
    }
}

/// A hypothesis on its way to be the next state.
pub struct New<'s, T: Target + ?Sized> {
    /// The current state.
    pub from: &'s T::State,
    /// The proposal.
    pub to: &'s T::State,
    /// What of it differs from the current state.
    pub touched: T::Touched,
}

/// What is sampled: a product of factors, with the buffers to evaluate it in.
///
/// Implement it for a new kind of fit; for new evidence about the same kind of state, add a factor.
pub trait Target {
    /// A hypothesis.
    type State: Clone;
    /// Parts of a hypothesis that a move may change.
    type Touched: Copy;
    /// `log f_k` of a state, number by number: `[f64; N]` for `N` [`Target::FACTORS`].
    type Density: Copy + AsRef<[f64]> + AsMut<[f64]>;
    /// The factors, the cheapest first; at most eight.
    const FACTORS: &'static [Factor];

    /// The factor counts to the power `1/temperature`.
    fn temperature(&self, _k: usize) -> f64 {
        1.0
    }

    /// Computes what factor `k` looks at, where it does not disturb what the current state has.
    fn prepare(&mut self, _k: usize, _new: &New<'_, Self>) {}

    /// `log f_k` of the proposal, prepared before; `now` is the current state's. `None` if it is
    /// below `floor`, which is −∞ for cheap factors.
    fn ln_factor(&mut self, k: usize, new: &New<'_, Self>, now: f64, floor: f64) -> Option<f64>;

    /// Makes what was computed for the proposal the current state's: what [`Target::prepare`] did
    /// for the factors looked at, and whatever else is kept of a state.
    fn accept(&mut self, _new: &New<'_, Self>, _looked_at: Factors) {}
}

/// What a move did.
#[derive(Clone, Copy, Debug)]
pub struct Drawn<U> {
    /// What it changed.
    pub touched: U,
    /// `log [q(x' → x)·|J| / q(x → x')]`. Of a late move only `−log q(x → x')`: the rest is
    /// [`Moves::ln_back`].
    pub ln_ratio: f64,
    /// The factor whose test the ratio belongs to; if that factor is not looked at, the next one that is.
    /// Late moves name the first factor that prepares what they need of the proposal.
    pub due: usize,
}

/// Ways to propose, numbered.
pub trait Moves<T: Target> {
    /// Changes a copy of the current state. `None` if the move has nowhere to go; that counts as
    /// rejected.
    fn draw(
        &mut self,
        leaf: usize,
        target: &mut T,
        state: &mut T::State,
        rng: &mut Rng,
    ) -> Option<Drawn<T::Touched>>;

    /// `log q(x' → x)` of a late move, whose proposal is prepared by now: for one that looks at the
    /// gradient or the metric at both ends.
    fn ln_back(&mut self, _leaf: usize, _target: &mut T, _new: &New<'_, T>) -> Option<f64> {
        Some(0.0)
    }
}

/// What became of a proposal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// It is the new state.
    Accepted,
    /// The test of this factor turned it down; the state stays.
    Rejected(usize),
    /// The move had nowhere to go; the state stays.
    Failed,
}

/// Makes one step with the given leaf. `density` holds `log f_k` of `state`; factors not looked at
/// keep theirs.
pub fn step<T: Target, M: Moves<T>>(
    target: &mut T,
    moves: &mut M,
    leaf: usize,
    factors: Factors,
    state: &mut T::State,
    density: &mut T::Density,
    rng: &mut Rng,
) -> Outcome {
    let mut to = state.clone();
    let Some(drawn) = moves.draw(leaf, target, &mut to, rng) else {
        return Outcome::Failed;
    };
    let new = New { from: &*state, to: &to, touched: drawn.touched };
    let mut next = *density;
    let mut is_due = true;
    let values = next.as_mut().iter_mut().zip(density.as_ref());
    for (k, (factor, (next, &now))) in T::FACTORS.iter().zip(values).enumerate() {
        if factors >> k & 1 == 0 {
            continue;
        }
        let ln_threshold = if factor.costly { math::ln(rng.uniform()) } else { 0.0 };
        target.prepare(k, &new);
        let mut ln_ratio = 0.0;
        if is_due && drawn.due <= k {
            let Some(back) = moves.ln_back(leaf, target, &new) else { return Outcome::Failed };
            ln_ratio = drawn.ln_ratio + back;
            is_due = false;
        }
        let temperature = target.temperature(k);
        if factor.costly {
            let floor = now + temperature * (ln_threshold - ln_ratio);
            match target.ln_factor(k, &new, now, floor) {
                Some(value) => *next = value,
                None => return Outcome::Rejected(k),
            }
        } else {
            let none = f64::NEG_INFINITY;
            *next = target.ln_factor(k, &new, now, none).unwrap_or(none);
            if !passes((*next - now) / temperature + ln_ratio, rng) {
                return Outcome::Rejected(k);
            }
        }
    }
    target.accept(&new, factors);
    *state = to;
    *density = next;
    Outcome::Accepted
}

/// Accepts with probability `min(1, eᵍ)`. Draws a number only when it decides. `−∞ − (−∞)` is
/// NaN: a state without density may be left for another without density.
fn passes(gain: f64, rng: &mut Rng) -> bool {
    gain >= 0.0 || gain.is_nan() || math::ln(rng.uniform()) < gain
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A plane under a standard normal prior and a costly banana.
    struct Banana;

    fn banana([x, y]: [f64; 2]) -> f64 {
        -2.0 * (y - 0.7 * x * x) * (y - 0.7 * x * x) - 0.5 * (x - 0.8) * (x - 0.8)
    }

    /// Log factors of a state.
    fn factors([x, y]: [f64; 2]) -> [f64; 2] {
        [-0.5 * (x * x + y * y), banana([x, y])]
    }

    /// Gradient of the sum of the factors.
    fn gradient([x, y]: [f64; 2]) -> [f64; 2] {
        let r = y - 0.7 * x * x;
        [-x + 5.6 * r * x - (x - 0.8), -y - 4.0 * r]
    }

    impl Target for Banana {
        type State = [f64; 2];
        type Touched = ();
        type Density = [f64; 2];
        const FACTORS: &'static [Factor] = &[Factor::cheap("prior"), Factor::costly("banana")];

        fn ln_factor(&mut self, k: usize, new: &New<'_, Self>, _: f64, floor: f64) -> Option<f64> {
            let value = factors(*new.to)[k];
            (value >= floor).then_some(value)
        }
    }

    const WALK: usize = 0;
    const SCALE: usize = 1;
    const LANGEVIN: usize = 2;

    /// A random walk; a scaling of `x` with its Jacobian at the first test; Langevin's move, whose
    /// ratio is known only where the gradient at the proposal is.
    struct Kernels;

    const H: f64 = 0.35;

    /// Log density, but for a constant, of Langevin's move.
    fn ln_q(from: [f64; 2], to: [f64; 2]) -> f64 {
        let g = gradient(from);
        let square = |i: usize| (to[i] - from[i] - 0.5 * H * g[i]).powi(2);
        -(square(0) + square(1)) / (2.0 * H)
    }

    fn langevin(from: [f64; 2], rng: &mut Rng) -> [f64; 2] {
        let g = gradient(from);
        [0, 1].map(|i| from[i] + 0.5 * H * g[i] + H.sqrt() * rng.normal())
    }

    impl Moves<Banana> for Kernels {
        fn draw(
            &mut self,
            leaf: usize,
            _: &mut Banana,
            state: &mut [f64; 2],
            rng: &mut Rng,
        ) -> Option<Drawn<()>> {
            let from = *state;
            let (ln_ratio, due) = match leaf {
                WALK => {
                    *state = state.map(|x| x + 0.7 * rng.normal());
                    (0.0, 0)
                }
                SCALE => {
                    let z = 0.5 * rng.normal();
                    state[0] *= z.exp();
                    (z, 0)
                }
                _ => {
                    *state = langevin(from, rng);
                    (-ln_q(from, *state), 1)
                }
            };
            Some(Drawn { touched: (), ln_ratio, due })
        }

        fn ln_back(&mut self, leaf: usize, _: &mut Banana, new: &New<'_, Banana>) -> Option<f64> {
            Some(if leaf == LANGEVIN { ln_q(*new.to, *new.from) } else { 0.0 })
        }
    }

    const STEPS: usize = 400_000;

    fn moments([x, y]: [f64; 2]) -> [f64; 4] {
        [x, y, x * x, y * y]
    }

    /// Mean moments over a chain.
    fn sampled(mut next: impl FnMut(usize, [f64; 2]) -> [f64; 2]) -> [f64; 4] {
        let mut state = [0.3, 0.2];
        let mut sums = [0.0; 4];
        for i in 0..STEPS {
            state = next(i, state);
            for (sum, moment) in sums.iter_mut().zip(moments(state)) {
                *sum += moment / STEPS as f64;
            }
        }
        sums
    }

    fn by_steps(leaves: &[usize], looked_at: Factors) -> [f64; 4] {
        let mut rng = Rng::new(3, 0);
        sampled(|i, mut state| {
            let mut density = factors(state);
            let leaf = leaves[i % leaves.len()];
            step(&mut Banana, &mut Kernels, leaf, looked_at, &mut state, &mut density, &mut rng);
            assert!(looked_at != 0b11 || density == factors(state));
            state
        })
    }

    /// By quadrature; `ln` is the log density.
    fn exact(ln: impl Fn([f64; 2]) -> f64) -> [f64; 4] {
        let (mut total, mut sums) = (0.0, [0.0; 4]);
        for i in -300..=300 {
            for j in -300..=300 {
                let state = [0.02 * f64::from(i), 0.02 * f64::from(j)];
                let p = ln(state).exp();
                total += p;
                for (sum, moment) in sums.iter_mut().zip(moments(state)) {
                    *sum += p * moment;
                }
            }
        }
        sums.map(|sum| sum / total)
    }

    /// The largest error of a moment.
    fn error(found: [f64; 4], expected: [f64; 4]) -> f64 {
        let errors = found.iter().zip(expected).map(|(f, e)| (f - e).abs());
        errors.fold(0.0, f64::max)
    }

    #[test]
    fn every_kind_of_move_leaves_the_target_invariant() {
        let truth = exact(|state| factors(state).iter().sum());
        for leaves in [&[WALK][..], &[WALK, SCALE], &[LANGEVIN], &[WALK, SCALE, LANGEVIN]] {
            let error = error(by_steps(leaves, 0b11), truth);
            assert!(error < 0.015, "{leaves:?}: {error}");
        }
    }

    #[test]
    fn a_factor_not_looked_at_does_not_count() {
        let prior = exact(|state| factors(state)[0]);
        // The scaling's Jacobian is due at a test that is there.
        assert!(error(by_steps(&[WALK, SCALE], 0b01), prior) < 0.02);
        // And here at the next one: x ~ N(0.8, 1), y ~ N(0.7 x², ¼). Of y² chains of this length
        // know no more than 3.8 ± 0.1.
        let [x, y, xx, _] = by_steps(&[WALK, SCALE], 0b10);
        assert!(error([x, y, xx, 0.0], [0.8, 1.148, 1.64, 0.0]) < 0.05, "{x} {y} {xx}");
    }

    #[test]
    fn halves_of_a_ratio_at_two_tests_are_wrong() {
        let truth = exact(|state| factors(state).iter().sum());
        let mut rng = Rng::new(3, 0);
        let split = sampled(|_, x| {
            let y = langevin(x, &mut rng);
            let (fx, fy) = (factors(x), factors(y));
            let first = passes(fy[0] - fx[0] - ln_q(x, y), &mut rng);
            if first && passes(fy[1] - fx[1] + ln_q(y, x), &mut rng) { y } else { x }
        });
        assert!(error(split, truth) > 0.05);
    }
}
