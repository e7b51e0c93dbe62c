//! The entropy decoder: items, adaptive flags, values by frozen tables, columns in classes (sections 6.2 to 6.4).

use crate::refusal::{sound, Result};
use crate::tables::{FREQUENCIES, SCALES, THRESHOLDS};

const LEAST: u64 = 1 << 16; // of a lane's state

pub struct Rans<'a> {
    words: std::slice::ChunksExact<'a, u8>,
    states: Vec<u64>,
    item: usize,
}

/// Two counters, of zeros and ones.
#[derive(Clone, Copy)]
pub struct Model([u32; 2]);

impl Model {
    pub const NEW: Model = Model([1, 1]);
}

impl<'a> Rans<'a> {
    pub fn new(bytes: &'a [u8], lanes: u8) -> Result<Self> {
        sound(bytes.len() % 2 == 0)?;
        let mut coder = Rans { words: bytes.chunks_exact(2), states: Vec::new(), item: 0 };
        for _ in 0..lanes {
            let state = coder.word()? | coder.word()? << 16;
            coder.states.push(state);
        }
        sound(coder.states.iter().all(|&state| state >= LEAST))?;
        Ok(coder)
    }

    fn word(&mut self) -> Result<u64> {
        let word = self.words.next();
        sound(word.is_some())?;
        Ok(word.map_or(0, |pair| u64::from(pair[0]) | u64::from(pair[1]) << 8))
    }

    fn slot(&self) -> u64 {
        self.states[self.item % self.states.len()] & 4095
    }

    /// Leave the interval in which the slot lies.
    fn advance(&mut self, start: u64, freq: u64) -> Result<()> {
        let lane = self.item % self.states.len();
        self.item += 1;
        let state = self.states[lane];
        let mut state = freq * (state >> 12) + (state & 4095) - start;
        if state < LEAST {
            state = state << 16 | self.word()?;
        }
        self.states[lane] = state;
        Ok(())
    }

    fn bits(&mut self, width: u32) -> Result<u64> {
        let (freq, value) = (1 << (12 - width), self.slot() >> (12 - width));
        self.advance(value * freq, freq)?;
        Ok(value)
    }

    fn raw(&mut self, width: u32) -> Result<u64> {
        let (mut value, mut shift) = (0, 0);
        while shift < width {
            let group = (width - shift).min(12);
            value |= self.bits(group)? << shift;
            shift += group;
        }
        Ok(value)
    }

    pub fn flag(&mut self, model: &mut Model) -> Result<usize> {
        let [zeros, ones] = model.0;
        let split = u64::from((4096 * zeros / (zeros + ones)).clamp(1, 4095));
        let bit = usize::from(self.slot() >= split);
        if bit == 0 { self.advance(0, split)? } else { self.advance(split, 4096 - split)? }
        model.0[bit] += 2;
        if model.0[0] + model.0[1] > 1020 {
            model.0 = model.0.map(|count| (count + 1) >> 1);
        }
        Ok(bit)
    }

    pub fn value(&mut self, bin: i64) -> Result<i64> {
        let (mut b, mut shift) = (bin.clamp(0, 120) as usize, 0);
        if b > 30 {
            shift = (b as u32 - 27) >> 2;
            b -= 4 * shift as usize;
        }
        let (slot, row) = (self.slot(), &FREQUENCIES[b]);
        let (mut start, mut symbol) = (0, 0);
        while start + u64::from(row[symbol]) <= slot {
            start += u64::from(row[symbol]);
            symbol += 1;
        }
        self.advance(start, u64::from(row[symbol]))?;
        let mut z = symbol as i64;
        if symbol == 16 {
            let mut width = 0;
            while self.bits(1)? == 1 {
                width += 1;
                sound(width <= 30)?;
            }
            z = 15 + (1 << width) + self.raw(width)? as i64;
        }
        let high = if z % 2 == 0 { z / 2 } else { -(z + 1) / 2 };
        let half = (1i64 << shift) >> 1;
        let value = (high << shift) - half + self.raw(shift)? as i64;
        sound(value.abs() < 1 << 30)?;
        Ok(value)
    }

    pub fn finish(&mut self) -> Result<()> {
        sound(self.words.next().is_none() && self.states.iter().all(|&state| state == LEAST))
    }
}

/// The bin of a magnitude in 1/256.
pub fn bin(magnitude: u64) -> i64 {
    let (mut e, mut k) = (magnitude, 0);
    while e >= 790 {
        e >>= 1;
        k += 4;
    }
    k + THRESHOLDS.iter().filter(|&&threshold| threshold <= e).count() as i64
}

/// The scale of each channel, in 1/256, 0 for those that are not coded; and what follows the side fields.
pub fn scales(bytes: &[u8], channels: usize) -> Result<(Vec<u32>, &[u8])> {
    sound(!bytes.is_empty())?;
    let (first, rest) = (usize::from(bytes[0]), &bytes[1..]);
    if first >= 192 {
        return Ok((vec![SCALES[first - 192 + 16]; channels], rest));
    }
    let packed = channels.div_ceil(2);
    sound(rest.len() >= packed)?;
    let mut nibbles = rest[..packed].iter().flat_map(|byte| [byte & 15, byte >> 4]);
    let mut found = Vec::with_capacity(channels);
    for nibble in nibbles.by_ref().take(channels) {
        let index = first + 4 * usize::from(nibble.saturating_sub(1));
        sound(nibble == 0 || index < SCALES.len())?;
        found.push(if nibble == 0 { 0 } else { SCALES[index] });
    }
    sound(nibbles.all(|unused| unused == 0))?;
    Ok((found, &rest[packed..]))
}

/// Decode the `rows` of `values` [N, C] one after the other (section 6.3).
pub fn columns(coder: &mut Rans, values: &mut [i32], rows: &[usize], scale: &[u32]) -> Result<()> {
    let bins: Vec<i64> = scale.iter().map(|&m| bin(m.into())).collect();
    let weight: Vec<u64> = scale.iter().map(|&m| if m == 0 { 0 } else { 65536 / (256 + u64::from(m)) }).collect();
    let expected: Vec<u64> =
        scale.iter().zip(&weight).map(|(&m, w)| if m == 0 { 0 } else { ((w * u64::from(m) + 128) >> 8).max(1) }).collect();
    let total: u64 = expected.iter().sum();
    if total == 0 {
        return Ok(());
    }
    let mut mean = total as i64;
    for &row in rows {
        let (mut energy, mut seen, mut gain) = (0u64, 0, 0);
        for c in 0..scale.len() {
            if c % 2 == 0 {
                gain = bin(256 * (mean as u64 + 2 * energy) / (total + 2 * seen)) - 24;
            }
            if scale[c] > 0 {
                let value = coder.value(bins[c] + gain)?;
                values[row * scale.len() + c] = value as i32;
                energy += weight[c] * value.unsigned_abs().min(65535);
                seen += expected[c];
            }
        }
        mean += (energy as i64 - mean) >> 3;
    }
    Ok(())
}

/// Decode `count` rows in classes of precision (section 6.4): the numbers, and the shift of each row.
pub fn classed(bytes: &[u8], lanes: u8, count: usize, channels: usize) -> Result<(Vec<i32>, Vec<u32>)> {
    sound(!bytes.is_empty() && bytes[0] != 0)?;
    let shifts: Vec<u32> = (0..8).filter(|s| bytes[0] >> s & 1 == 1).collect();
    let (mut rest, mut each) = (&bytes[1..], Vec::new());
    for _ in &shifts {
        let (scale, behind) = scales(rest, channels)?;
        each.push(scale);
        rest = behind;
    }
    let mut coder = Rans::new(rest, lanes)?;
    let (mut models, mut classes) = ([Model::NEW; 8], vec![0usize; count]);
    for class in &mut classes {
        while *class < shifts.len() - 1 && coder.flag(&mut models[*class])? == 0 {
            *class += 1;
        }
    }
    let mut values = vec![0i32; count * channels];
    for (k, scale) in each.iter().enumerate() {
        let rows: Vec<usize> = (0..count).filter(|&row| classes[row] == k).collect();
        columns(&mut coder, &mut values, &rows, scale)?;
    }
    coder.finish()?;
    Ok((values, classes.into_iter().map(|k| shifts[k]).collect()))
}
