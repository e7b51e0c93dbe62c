//! The streamlod bitstream, version 1, decoded from codec/FORMAT.md alone; sections are those of that document.
//!
//! `Decoder::push` takes packets, `File` reads `.slod` files. Without dependencies and without `unsafe`.

#![forbid(unsafe_code)]

pub mod bytes;
mod change;
pub mod decoder;
pub mod file;
mod inflate;
pub mod packet;
mod rans;
pub mod refusal;
mod rows;
pub mod scene;
pub mod sha256;
mod tables;

pub use decoder::Decoder;
pub use file::File;
pub use packet::Limits;
pub use refusal::Refusal;
