//! The paper's experiments, on this project's own faces.
//!
//! | room | experiment |
//! |---|---|
//! | [`faces`] | the faces they are made on |

pub mod faces;
