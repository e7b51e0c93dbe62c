//! Tables of rows: GEOMETRY, BASE, ADDED, REMOVED, and how many rows a chunk may have (sections 6 to 8 and 10).

use crate::bytes::Reader;
use crate::inflate::inflate;
use crate::packet::Limits;
use crate::rans::{classed, Model, Rans};
use crate::refusal::{must, sound, Result};
use crate::scene::{Header, Level, LATENTS, SCALINGS};

/// What the chunks of one level may still describe.
pub struct Room {
    pub rows: u64,
    pub level_bytes: u64,
}

impl Room {
    pub fn new(header: &Header, limits: &Limits, levels: &[Level], level_bytes: u64) -> Room {
        let held: u64 = levels.iter().map(|level| level.len() as u64).sum();
        Room { rows: header.most_rows(limits).saturating_sub(held), level_bytes }
    }

    pub fn check(&self, rows: usize, columns: usize) -> Result<()> {
        must(rows as u64 * columns as u64 <= 64 * self.level_bytes, "limit_exceeded")
    }

    fn check_added(&self, rows: usize, columns: usize) -> Result<()> {
        must(rows as u64 <= self.rows, "limit_exceeded")?;
        self.check(rows, columns)
    }
}

/// The coding of a chunk: 0, 1 or 4.
pub fn coding(chunk: &[u8], profile: u8, only_plain: bool) -> Result<u8> {
    sound(!chunk.is_empty())?;
    let known = chunk[0] == 0 || (profile > 0 && !only_plain && (chunk[0] == 1 || chunk[0] == 4));
    must(known, "unsupported_profile")?;
    Ok(chunk[0])
}

/// The row count behind the coding.
pub fn row_count(chunk: &[u8]) -> Result<usize> {
    let mut reader = Reader::new(chunk, "corrupt_chunk");
    reader.u8()?;
    let count = reader.u32()? as usize;
    sound(count > 0)?;
    Ok(count)
}

/// Coding 0: row-major numbers out of columns.
pub fn plain(chunk: &[u8], rows: usize, channels: usize) -> Result<Vec<i32>> {
    let bytes = inflate(&chunk[5..], 4 * rows * channels)?;
    let mut values = vec![0; rows * channels];
    for (at, four) in bytes.chunks_exact(4).enumerate() {
        values[at % rows * channels + at / rows] = i32::from_le_bytes([four[0], four[1], four[2], four[3]]);
    }
    Ok(values)
}

/// Numbers of coding 1 or 4, `bytes` beginning with the modes; `shifted` channels are in the precision of their row.
fn coded(bytes: &[u8], lanes: u8, rows: usize, channels: usize, first: usize, shifted: usize) -> Result<Vec<i32>> {
    let packed = channels.div_ceil(4);
    sound(bytes.len() >= packed)?;
    let mode = |c: usize| bytes[c / 4] >> (2 * (c % 4)) & 3;
    sound((0..4 * packed).all(|c| if c < channels { mode(c) <= 2 } else { mode(c) == 0 }))?;
    let mut reader = Reader::new(&bytes[packed..], "corrupt_chunk");
    let mut centres = vec![0i64; channels];
    for (c, centre) in centres.iter_mut().enumerate() {
        if mode(c) == 1 {
            *centre = reader.i32()?.into();
        }
    }
    let (mut values, shifts) = classed(reader.rest, lanes, rows, channels)?;
    let mut totals = vec![0i64; channels];
    for row in 0..rows {
        for c in 0..channels {
            let shift = if (first..first + shifted).contains(&c) { shifts[row] } else { 0 };
            let number = &mut values[row * channels + c];
            let mut value = (i64::from(*number) << shift) + centres[c];
            if mode(c) == 2 {
                value += (((totals[c] >> 3) + ((1i64 << shift) >> 1)) >> shift) << shift;
                totals[c] += value - (totals[c] >> 3);
            }
            *number = narrowed(value)?;
        }
    }
    Ok(values)
}

/// A number of a column, or `overflow`.
pub fn narrowed<T: TryFrom<i64>>(value: i64) -> Result<T> {
    T::try_from(value).map_err(|_| crate::refusal::Refusal("overflow"))
}

pub fn geometry(chunk: &[u8], profile: u8, room: &Room) -> Result<Vec<[i32; 3]>> {
    let lanes = coding(chunk, profile, false)?;
    let count = row_count(chunk)?;
    if lanes > 0 {
        return octree(chunk, lanes, count, room);
    }
    room.check_added(count, 3)?;
    let steps = plain(chunk, count, 3)?;
    let (mut voxels, mut last) = (Vec::with_capacity(count), [0i32; 3]);
    for step in steps.chunks_exact(3) {
        for axis in 0..3 {
            last[axis] = last[axis].wrapping_add(step[axis]);
        }
        voxels.push(last);
    }
    Ok(voxels)
}

fn octree(chunk: &[u8], lanes: u8, count: usize, room: &Room) -> Result<Vec<[i32; 3]>> {
    let mut reader = Reader::new(&chunk[5..], "corrupt_chunk");
    let minimum = [reader.i32()?, reader.i32()?, reader.i32()?];
    let depth = usize::from(reader.u8()?);
    sound(depth <= 21)?;
    room.check_added(count, depth.max(3))?;
    let mut coder = Rans::new(reader.rest, lanes)?;
    let mut models = vec![Model::NEW; 16 * 256];
    let mut nodes = vec![([0u32; 3], 0usize)]; // and the class of the parent
    for d in 0..depth {
        let (near, mut next) = ((depth - 1 - d).min(3), Vec::new());
        for &([x, y, z], parent) in &nodes {
            let (mut prefix, born) = (1, next.len());
            for j in 0..8u32 {
                let sure = j == 7 && prefix == 1 << 7;
                let bit = if sure { 1 } else { coder.flag(&mut models[(near * 4 + parent) << 8 | prefix])? };
                prefix = 2 * prefix + bit;
                if bit == 1 {
                    next.push(([2 * x + (j >> 2), 2 * y + (j >> 1 & 1), 2 * z + (j & 1)], 0));
                }
            }
            let class = [0, 0, 1, 2, 2, 3, 3, 3, 3][next.len() - born];
            next[born..].iter_mut().for_each(|child| child.1 = class);
            sound(next.len() <= count)?;
        }
        nodes = next;
    }
    coder.finish()?;
    sound(nodes.len() == count)?;
    let greatest = nodes.iter().flat_map(|node| node.0).max().unwrap_or(0);
    sound((0..3).all(|axis| nodes.iter().any(|node| node.0[axis] == 0)) && (32 - greatest.leading_zeros()) as usize == depth)?;
    let place = |node: [u32; 3], axis: usize| narrowed(i64::from(node[axis]) + i64::from(minimum[axis]));
    nodes.into_iter().map(|(node, _)| Ok([place(node, 0)?, place(node, 1)?, place(node, 2)?])).collect()
}

pub fn base(chunk: &[u8], profile: u8, header: &Header, voxel: Vec<[i32; 3]>, room: &Room) -> Result<Level> {
    let (lanes, channels, rows) = (coding(chunk, profile, false)?, header.base_channels(), voxel.len());
    sound(lanes > 0 || row_count(chunk)? == rows)?;
    room.check(rows, channels)?;
    let values = match lanes {
        0 => plain(chunk, rows, channels)?,
        _ => coded(&chunk[1..], lanes, rows, channels, 0, channels - 4)?,
    };
    let mut level = Level { voxel, ..Level::default() };
    for row in values.chunks_exact(channels) {
        push_base(&mut level, row, header)?;
        level.latent.push([0; LATENTS]);
        level.alive.push(true);
    }
    Ok(level)
}

/// Append the columns of BASE of one row.
fn push_base(level: &mut Level, row: &[i32], header: &Header) -> Result<()> {
    let (features, offsets) = (header.features, 3 * header.slots);
    let (mut column, mut at) = (0, 0);
    for count in [features, offsets, SCALINGS, 1] {
        let target = [&mut level.feature, &mut level.offset, &mut level.scaling, &mut level.extra_level];
        for &value in &row[at..at + count] {
            target[column].push(narrowed(value.into())?);
        }
        at += count;
        column += 1;
    }
    level.position.push([row[at], row[at + 1], row[at + 2]]);
    Ok(())
}

pub fn added(chunk: &[u8], profile: u8, header: &Header, room: &Room) -> Result<Level> {
    let lanes = coding(chunk, profile, false)?;
    let (rows, base) = (row_count(chunk)?, header.base_channels());
    let channels = 3 + base + LATENTS + 1;
    room.check_added(rows, channels)?;
    let values = match lanes {
        0 => plain(chunk, rows, channels)?,
        _ => coded(&chunk[5..], lanes, rows, channels, 3, base - 4)?,
    };
    let mut level = Level::default();
    for row in values.chunks_exact(channels) {
        level.voxel.push([row[0], row[1], row[2]]);
        push_base(&mut level, &row[3..], header)?;
        let mut latent = [0; LATENTS];
        for (to, &from) in latent.iter_mut().zip(&row[3 + base..]) {
            *to = narrowed(from.into())?;
        }
        level.latent.push(latent);
        must(matches!(row[channels - 1], 0 | 1), "overflow")?;
        level.alive.push(row[channels - 1] == 1);
    }
    Ok(level)
}

/// Row numbers out of gaps, ascending below `count`.
pub fn ascending(gaps: impl Iterator<Item = i32>, count: usize) -> Result<Vec<usize>> {
    let (mut rows, mut at) = (Vec::new(), 0i64);
    for gap in gaps {
        at += i64::from(gap);
        sound((gap > 0 || (rows.is_empty() && gap == 0)) && at < count as i64)?;
        rows.push(at as usize);
    }
    Ok(rows)
}

/// The row count of a table of rows that the level has.
pub fn existing(chunk: &[u8], channels: usize, held: usize, room: &Room) -> Result<usize> {
    let rows = row_count(chunk)?;
    sound(rows <= held)?;
    room.check(rows, channels)?;
    Ok(rows)
}

pub fn removed(chunk: &[u8], profile: u8, level: &Level, room: &Room) -> Result<Vec<usize>> {
    coding(chunk, profile, true)?;
    let count = existing(chunk, 1, level.len(), room)?;
    let rows = ascending(plain(chunk, count, 1)?.into_iter(), level.len())?;
    sound(rows.iter().all(|&row| level.alive[row]))?;
    Ok(rows)
}
