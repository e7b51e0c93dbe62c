//! `.slod` files: index, walking without one, and the way to a version (section 15).

use std::collections::HashMap;

use crate::bytes::{crc32, Reader};
use crate::packet::{envelope, HEADER_BYTES, KEY};
use crate::refusal::{must, Refusal, Result};

const MOST: usize = 16 << 20; // bytes of a packet
const HEAD: usize = 8;
const FOOTER: usize = 16;

#[derive(Clone, Copy, Debug)]
pub struct Entry {
    pub offset: usize,
    pub size: usize,
    pub keyframe: u32,
    pub from_version: u32,
    pub to_version: u32,
    pub time_ns: u64,
    pub kind: u8,
    pub mask: u16,
}

/// A file in memory.
pub struct File<'a> {
    bytes: &'a [u8],
    pub entries: Vec<Entry>,
    /// Whether the index was believed.
    pub indexed: bool,
}

impl<'a> File<'a> {
    pub fn new(bytes: &'a [u8]) -> Result<File<'a>> {
        must(bytes.len() >= HEAD && &bytes[..4] == b"SLOD", "bad_file")?;
        must(bytes[4] == 1, "unsupported_version")?;
        must(bytes[5..HEAD] == [0; 3], "bad_file")?;
        let index = index(bytes);
        let indexed = index.is_some();
        Ok(File { bytes, entries: index.unwrap_or_else(|| walk(bytes)), indexed })
    }

    /// A packet; refused where the index contradicts it.
    pub fn packet(&self, number: usize) -> Result<&'a [u8]> {
        let e = self.entries[number];
        let packet = &self.bytes[e.offset..e.offset + e.size];
        must(packet.len() >= HEADER_BYTES, "bad_file")?;
        let mut fields = Vec::with_capacity(22);
        for number in [e.keyframe, e.from_version, e.to_version] {
            fields.extend_from_slice(&number.to_le_bytes());
        }
        fields.extend_from_slice(&e.time_ns.to_le_bytes());
        fields.extend_from_slice(&e.mask.to_le_bytes());
        must(packet[6] == e.kind && packet[8..30] == fields, "bad_file")?;
        Ok(packet)
    }

    /// Numbers of the packets that lead from nothing to `version` at the fewest bytes; None where none do.
    pub fn way(&self, version: u32) -> Option<Vec<usize>> {
        let is_key = |e: &Entry| e.kind == KEY && e.to_version <= version;
        let keyframe = self.entries.iter().filter(|e| is_key(e)).map(|e| e.keyframe).max()?;
        let numbered = self.entries.iter().enumerate();
        let keys: Vec<usize> = numbered.filter(|(_, e)| is_key(e) && e.keyframe == keyframe).map(|(n, _)| n).collect();
        let mask = keys.iter().fold(0, |mask, &n| mask | self.entries[n].mask);
        let mut steps = self.steps(keyframe, mask);
        steps.sort_by_key(|step| step.to);
        let mut best = HashMap::from([(keyframe, (0, None))]); // bytes to a version, and the last step there
        for (i, step) in steps.iter().enumerate() {
            if let Some(&(before, _)) = best.get(&step.from) {
                let bytes = before + step.bytes;
                if best.get(&step.to).is_none_or(|known| bytes < known.0) {
                    best.insert(step.to, (bytes, Some(i)));
                }
            }
        }
        let (mut at, mut path) = (version, Vec::new());
        while let Some(i) = best.get(&at)?.1 {
            let step: &Step = &steps[i];
            path.push(&step.numbers);
            at = step.from;
        }
        Some(keys.into_iter().chain(path.into_iter().rev().flatten().copied()).collect())
    }

    fn steps(&self, keyframe: u32, mask: u16) -> Vec<Step> {
        let (mut whole, mut partial) = (Vec::new(), Vec::<Step>::new());
        let mut known = HashMap::new();
        for (number, e) in self.entries.iter().enumerate() {
            if e.kind == KEY || e.keyframe != keyframe || e.from_version >= e.to_version {
                continue;
            }
            let (from, to) = (e.from_version, e.to_version);
            if e.mask & mask == mask {
                whole.push(Step { from, to, bytes: e.size, numbers: vec![number], mask });
                continue;
            }
            let at = *known.entry((from, to)).or_insert(partial.len());
            if at == partial.len() {
                partial.push(Step { from, to, bytes: 0, numbers: Vec::new(), mask: 0 });
            }
            let step = &mut partial[at];
            if e.mask & mask & !step.mask != 0 {
                step.mask |= e.mask;
                step.bytes += e.size;
                step.numbers.push(number);
            }
        }
        whole.extend(partial.into_iter().filter(|step| step.mask & mask == mask));
        whole
    }
}

/// Packets that together lead all levels from one version to another.
struct Step {
    from: u32,
    to: u32,
    bytes: usize,
    numbers: Vec<usize>,
    mask: u16,
}

fn index(bytes: &[u8]) -> Option<Vec<Entry>> {
    let footer_at = bytes.len().checked_sub(FOOTER)?;
    let mut footer = Reader::new(&bytes[footer_at..], "bad_file");
    let (start, checksum) = (usize::try_from(footer.u64().ok()?).ok()?, footer.u32().ok()?);
    if footer.rest != b"SLIX" || start < HEAD || start > footer_at {
        return None;
    }
    let index = &bytes[start..footer_at];
    let mut reader = Reader::new(index, "bad_file");
    let (mark, count) = (reader.u32().ok()?, reader.u32().ok()?);
    if crc32(index, 0) != checksum || mark != u32::MAX || reader.rest.len() as u64 != 40 * u64::from(count) {
        return None;
    }
    let (mut entries, mut at) = (Vec::new(), HEAD);
    while !reader.rest.is_empty() {
        let entry = entry(&mut reader).ok()?;
        if entry.offset < at.checked_add(4)? || entry.size > MOST || entry.kind > 1 {
            return None;
        }
        at = entry.offset.checked_add(entry.size)?;
        entries.push(entry);
    }
    (at <= start).then_some(entries)
}

fn entry(reader: &mut Reader) -> Result<Entry> {
    let (offset, size) = (reader.u64()?, reader.u32()?);
    let (keyframe, from_version, to_version) = (reader.u32()?, reader.u32()?, reader.u32()?);
    let (time_ns, kind, _, mask, _) = (reader.u64()?, reader.u8()?, reader.u8()?, reader.u16()?, reader.u32()?);
    let offset = usize::try_from(offset).map_err(|_| Refusal("bad_file"))?;
    Ok(Entry { offset, size: size as usize, keyframe, from_version, to_version, time_ns, kind, mask })
}

fn walk(bytes: &[u8]) -> Vec<Entry> {
    let (mut entries, mut reader) = (Vec::new(), Reader::new(&bytes[HEAD..], "bad_file"));
    while let Ok(size) = reader.u32() {
        let offset = bytes.len() - reader.rest.len();
        let Ok(packet) = reader.take(size as usize) else { break };
        let Ok(packet) = envelope(packet, MOST) else { break };
        let f = packet.fields;
        entries.push(Entry {
            offset,
            size: size as usize,
            keyframe: f.keyframe,
            from_version: f.from_version,
            to_version: f.to_version,
            time_ns: f.time_ns,
            kind: f.kind,
            mask: f.mask,
        });
    }
    entries
}
