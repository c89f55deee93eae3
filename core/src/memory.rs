//! One slice of words, carved into typed buffers; and two buffers that change places.

use crate::lanes::{Planes, planes_words};

/// Splits typed buffers off one slice of words.
pub struct Carver<'w> {
    rest: &'w mut [u32],
}

impl<'w> Carver<'w> {
    /// Starts at the front of `memory`.
    pub fn new(memory: &'w mut [u32]) -> Self {
        Self { rest: memory }
    }

    /// The next `count` words; `None` if fewer are left.
    pub fn words(&mut self, count: usize) -> Option<&'w mut [u32]> {
        let (taken, rest) = core::mem::take(&mut self.rest).split_at_mut_checked(count)?;
        self.rest = rest;
        Some(taken)
    }

    /// A look at the next `count` words without taking them: memory for a passing need.
    pub fn scratch(&mut self, count: usize) -> Option<&mut [u32]> {
        self.rest.get_mut(..count)
    }

    /// The next `count` numbers.
    pub fn floats(&mut self, count: usize) -> Option<&'w mut [f32]> {
        bytemuck::try_cast_slice_mut(self.words(count)?).ok()
    }

    /// The bytes of the next `count` words.
    pub fn bytes(&mut self, count: usize) -> Option<&'w mut [u8]> {
        bytemuck::try_cast_slice_mut(self.words(count)?).ok()
    }

    /// The next `count` groups of `N` numbers.
    pub fn groups<const N: usize>(&mut self, count: usize) -> Option<&'w mut [[f32; N]]> {
        Some(self.floats(count.checked_mul(N)?)?.as_chunks_mut().0)
    }

    /// The next `count` quadruples of numbers.
    pub fn quads(&mut self, count: usize) -> Option<&'w mut [[f32; 4]]> {
        self.groups(count)
    }

    /// The next three numbers per pixel of a picture, chunk by chunk.
    pub fn planes(&mut self, width: usize, height: usize) -> Option<&'w mut [Planes]> {
        let (planes, _) = self.floats(planes_words(width, height))?.as_chunks_mut();
        Some(planes.as_chunks_mut().0)
    }
}

/// Two buffers of one kind: the current state's and the one a proposal is computed in. Accepting
/// swaps them; rejecting costs nothing. Or, to save memory, a single one for both: whoever writes
/// a proposal there has overwritten the current state's and must make it again.
pub(crate) struct Slots<T> {
    first: T,
    second: Option<T>,
    swapped: bool,
}

impl<T> Slots<T> {
    pub(crate) fn new(first: T, second: Option<T>) -> Self {
        Self { first, second, swapped: false }
    }

    /// The current buffer.
    pub(crate) fn get(&self) -> &T {
        self.pick(false)
    }

    /// The current buffer, or the other one if `proposed`.
    pub(crate) fn pick(&self, proposed: bool) -> &T {
        match &self.second {
            Some(second) if self.swapped != proposed => second,
            _ => &self.first,
        }
    }

    /// The buffer to compute a proposal in.
    pub(crate) fn spare(&mut self) -> &mut T {
        self.both().1
    }

    /// The current buffer, unless it is the same, and the one to compute a proposal in.
    pub(crate) fn both(&mut self) -> (Option<&T>, &mut T) {
        let Self { first, second, swapped } = self;
        match (second, *swapped) {
            (None, _) => (None, first),
            (Some(second), true) => (Some(second), first),
            (Some(second), false) => (Some(first), second),
        }
    }

    /// Makes the spare the current one.
    pub(crate) fn flip(&mut self) {
        self.swapped = !self.swapped;
    }
}
