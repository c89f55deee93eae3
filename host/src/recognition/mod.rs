//! Who is it? Faces compared by what fits have found of them (paper, section "Face recognition").
//!
//! | room | holds |
//! |---|---|
//! | [`scores`] | how alike two fitted faces are |
//! | [`statistics`] | ranks, how often the first is right, how far apart scores of the same and of others are |
//! | [`fits`] | fits of photos and of directories of them, made or read |
//! | [`output`] | what a recognition leaves behind |

pub mod fits;
pub mod output;
pub mod scores;
pub mod statistics;
