//! The outside of a packet: header, directory, checksums (sections 2 and 13).

use crate::bytes::{crc32, Reader};
use crate::refusal::{must, Result};

pub const HEADER_BYTES: usize = 44;
pub const KEY: u8 = 0;

/// Chunk kinds.
pub mod chunk {
    pub const HEADER: u8 = 0;
    pub const WEIGHTS: u8 = 1;
    pub const GEOMETRY: u8 = 2;
    pub const BASE: u8 = 3;
    pub const CHANGE: u8 = 4;
    pub const REMOVED: u8 = 5;
    pub const ADDED: u8 = 6;
    pub const HASH: u8 = 7;
    pub const METADATA: u8 = 12;
}

/// The most that a decoder takes; a complexity level of section 13.
#[derive(Clone, Copy, Debug)]
pub struct Limits {
    pub packet_bytes: usize,
    pub rows: u64,
    pub gaussians: u64,
    pub state_bytes: u64,
}

impl Limits {
    pub const SMALL: Limits = Limits { packet_bytes: 16 << 20, rows: 1 << 16, gaussians: 1 << 19, state_bytes: 16 << 20 };
    pub const MAIN: Limits = Limits { packet_bytes: 16 << 20, rows: 1 << 18, gaussians: 1 << 21, state_bytes: 64 << 20 };
    pub const LARGE: Limits = Limits { packet_bytes: 16 << 20, rows: 1 << 20, gaussians: 1 << 24, state_bytes: 256 << 20 };
}

#[derive(Clone, Copy, Debug)]
pub struct Fields {
    pub profile: u8,
    pub kind: u8,
    pub keyframe: u32,
    pub from_version: u32,
    pub to_version: u32,
    pub time_ns: u64,
    pub mask: u16,
    pub identifier: u64,
}

pub struct Packet<'a> {
    pub fields: Fields,
    chunks: Vec<(u8, &'a [u8], u32)>, // level << 4 | kind, content, checksum
}

impl<'a> Packet<'a> {
    pub fn chunk(&self, level: usize, kind: u8) -> Option<&'a [u8]> {
        let place = (level as u8) << 4 | kind;
        self.chunks.iter().find(|found| found.0 == place).map(|found| found.1)
    }

    /// Levels that the packet speaks for, coarse to fine.
    pub fn levels(&self) -> impl Iterator<Item = usize> + '_ {
        (0..16).filter(|level| self.fields.mask >> level & 1 == 1)
    }

    /// Length of all chunks of a level.
    pub fn level_bytes(&self, level: usize) -> u64 {
        self.chunks.iter().filter(|found| usize::from(found.0 >> 4) == level).map(|found| found.1.len() as u64).sum()
    }
}

/// Take a packet apart, without looking at chunk checksums: points 1 and 2 of section 13.
pub fn envelope(bytes: &[u8], most: usize) -> Result<Packet<'_>> {
    must(bytes.len() <= most, "too_large")?;
    must(bytes.len() >= HEADER_BYTES, "truncated")?;
    let mut reader = Reader::new(bytes, "truncated");
    must(reader.take(4)? == b"SLPK", "bad_magic")?;
    must(reader.u8()? == 1, "unsupported_version")?;
    let (profile, kind, reserved) = (reader.u8()?, reader.u8()?, reader.u8()?);
    must(profile <= 1, "unsupported_profile")?;
    let (keyframe, from_version, to_version) = (reader.u32()?, reader.u32()?, reader.u32()?);
    let (time_ns, mask, count) = (reader.u64()?, reader.u16()?, usize::from(reader.u16()?));
    let (identifier, checksum) = (reader.u64()?, reader.u32()?);
    let directory = reader.take(8 * count)?;
    must(crc32(directory, crc32(&bytes[..40], 0)) == checksum, "bad_checksum")?;
    let ordered = match kind {
        KEY => keyframe == from_version && from_version == to_version,
        _ => keyframe <= from_version && from_version < to_version,
    };
    must(reserved == 0 && kind <= 1 && mask != 0 && time_ns < 1 << 63 && ordered, "bad_header")?;
    let mut entries = Vec::with_capacity(count);
    let mut listed = Reader::new(directory, "truncated");
    for _ in 0..count {
        let (word, checksum) = (listed.u32()?, listed.u32()?);
        entries.push(((word >> 24) as u8, (word & 0xff_ffff) as usize, checksum));
    }
    check_directory(kind, mask, &entries)?;
    let total: usize = entries.iter().map(|entry| entry.1).sum();
    must(total <= reader.rest.len(), "truncated")?;
    must(total == reader.rest.len(), "trailing_bytes")?;
    let mut chunks = Vec::with_capacity(count);
    for (place, length, checksum) in entries {
        chunks.push((place, reader.take(length)?, checksum));
    }
    let fields = Fields { profile, kind, keyframe, from_version, to_version, time_ns, mask, identifier };
    Ok(Packet { fields, chunks })
}

/// Take a packet apart and compare all checksums.
pub fn parse(bytes: &[u8], most: usize) -> Result<Packet<'_>> {
    let packet = envelope(bytes, most)?;
    for (_, content, checksum) in &packet.chunks {
        must(crc32(content, 0) == *checksum, "bad_checksum")?;
    }
    Ok(packet)
}

fn check_directory(kind: u8, mask: u16, entries: &[(u8, usize, u32)]) -> Result<()> {
    let mut present = [false; 256];
    for (i, &(place, ..)) in entries.iter().enumerate() {
        let (level, own) = (place >> 4, place & 15);
        let known = match own {
            0..=3 => kind == KEY,
            4..=6 => kind != KEY,
            7 => true,
            _ => own >= 12,
        };
        let ascends = i == 0 || entries[i - 1].0 < place;
        must(ascends && known && mask >> level & 1 == 1 && (own > chunk::WEIGHTS || level == 0), "bad_directory")?;
        present[usize::from(place)] = true;
    }
    must(present[0] == present[1], "missing_chunk")?;
    must((0..16).all(|level| present[level << 4 | 2] == present[level << 4 | 3]), "missing_chunk")
}
