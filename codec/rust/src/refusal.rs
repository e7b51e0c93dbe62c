//! Refusals: the codes of section 13.

/// Why a packet or file is refused; the state stays as it was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Refusal(pub &'static str);

pub type Result<T> = std::result::Result<T, Refusal>;

/// Refuse with `code` unless `condition` holds.
pub fn must(condition: bool, code: &'static str) -> Result<()> {
    if condition { Ok(()) } else { Err(Refusal(code)) }
}

/// Refuse a chunk whose content is not what its coding says, unless `condition` holds.
pub fn sound(condition: bool) -> Result<()> {
    must(condition, "corrupt_chunk")
}
