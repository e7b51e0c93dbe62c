//! CHANGE: which rows differ, and by how much (section 9).

use crate::rans::{bin, columns, scales, Model, Rans};
use crate::refusal::{sound, Result};
use crate::rows::{ascending, coding, existing, plain, Room};
use crate::scene::{Level, LATENTS};
use crate::tables::SCALES;

const COLUMNS: usize = 1 + 3 + LATENTS;

#[derive(Default)]
pub struct Change {
    pub rows: Vec<usize>,
    /// [n,3] and [n,24], row-major.
    pub position: Vec<i64>,
    pub latent: Vec<i32>,
}

/// `age`: frames from the keyframe to the level before; `span`: from there to the level after.
pub fn change(chunk: &[u8], profile: u8, level: &Level, age: u32, span: u32, room: &Room) -> Result<Change> {
    let lanes = coding(chunk, profile, false)?;
    if lanes == 0 {
        let count = existing(chunk, COLUMNS, level.len(), room)?;
        let values = plain(chunk, count, COLUMNS)?;
        let rows = ascending(values.iter().step_by(COLUMNS).copied(), level.len())?;
        let part = |from: usize, to: usize| values.chunks_exact(COLUMNS).flat_map(move |row| row[from..to].to_vec());
        return Ok(Change { rows, position: part(1, 4).map(i64::from).collect(), latent: part(4, COLUMNS).collect() });
    }
    sound(chunk.len() >= 2 && usize::from(chunk[1]) < SCALES.len())?;
    let (scale, words) = scales(&chunk[2..], LATENTS)?;
    let mut coder = Rans::new(words, lanes)?;
    let rows = row_set(&mut coder, level)?;
    let position = positions(&mut coder, level, &rows, SCALES[usize::from(chunk[1])].into(), age, span)?;
    let (mut models, mut chosen) = ([Model::NEW; 2], Vec::new());
    for (i, &row) in rows.iter().enumerate() {
        if coder.flag(&mut models[usize::from(level.latent[row] != [0; LATENTS])])? == 1 {
            chosen.push(i);
        }
    }
    let mut latent = vec![0; LATENTS * rows.len()];
    columns(&mut coder, &mut latent, &chosen, &scale)?;
    coder.finish()?;
    sound(!rows.is_empty())?;
    Ok(Change { rows, position, latent })
}

fn row_set(coder: &mut Rans, level: &Level) -> Result<Vec<usize>> {
    let touched = |row: usize| level.position[row] != [0; 3] || level.latent[row] != [0; LATENTS];
    let (mut block_models, mut row_models) = ([Model::NEW; 8], [Model::NEW; 16]);
    let (mut rows, mut blocks, mut history) = (Vec::new(), 0, 0);
    for first in (0..level.len()).step_by(64) {
        let block = first..(first + 64).min(level.len());
        let any = usize::from(block.clone().any(touched));
        let used = coder.flag(&mut block_models[4 * any + blocks])?;
        blocks = used << 1 | blocks >> 1;
        if used == 0 {
            history = 0;
            continue;
        }
        for row in block {
            let bit = coder.flag(&mut row_models[8 * usize::from(touched(row)) + history])?;
            history = bit << 2 | history >> 1;
            if bit == 1 {
                rows.push(row);
            }
        }
    }
    Ok(rows)
}

fn positions(coder: &mut Rans, level: &Level, rows: &[usize], scale: i64, age: u32, span: u32) -> Result<Vec<i64>> {
    let (mut average, mut trend, mut found) = ([scale; 3], [0i64; 3], Vec::with_capacity(3 * rows.len()));
    let (mut before, mut mean) = (3 * scale, 3 * scale);
    let (age, span) = (i64::from(age), i64::from(span).min(age.into()).min(255));
    for &row in rows {
        let speed = |y: i32| if age == 0 { 0 } else { (128 * i64::from(y) * span).div_euclid(age) };
        let motion = level.position[row].map(speed);
        let steady: i64 = motion.iter().map(|v| v.abs()).sum();
        let mut within = 0;
        for axis in 0..3 {
            let context = 4 * average[axis] + 4 * steady + before + 3 * mean + 6 * within;
            let error = coder.value(bin((context / (18 + 6 * axis as i64)) as u64))?;
            let delta = error + ((motion[axis] + trend[axis] + 128) >> 8);
            sound(delta.abs() < 1 << 31)?;
            found.push(delta);
            let size = 256 * error.abs();
            average[axis] += (size - average[axis]) >> 6;
            trend[axis] += 16 * delta - (trend[axis] >> 2);
            within += size;
        }
        before = within;
        mean += (within - mean) >> 3;
    }
    Ok(found)
}
