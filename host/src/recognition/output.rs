//! What a recognition leaves behind.
