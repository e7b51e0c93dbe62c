//! Raw deflate, RFC 1951, with the same streams refused as by zlib.

use crate::refusal::{sound, Result};

struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
    held: u32,
    count: u32,
}

impl Bits<'_> {
    fn take(&mut self, width: u32) -> Result<usize> {
        while self.count < width {
            sound(self.at < self.bytes.len())?;
            self.held |= u32::from(self.bytes[self.at]) << self.count;
            self.at += 1;
            self.count += 8;
        }
        let value = self.held & ((1 << width) - 1);
        self.held >>= width;
        self.count -= width;
        Ok(value as usize)
    }
}

/// A prefix code: how many codes of each length there are, and the symbols in order of their codes.
struct Codes {
    counts: [usize; 16],
    symbols: Vec<usize>,
}

impl Codes {
    /// `may_be_one`: whether a single code of one bit may leave the other unused.
    fn new(lengths: &[u8], may_be_one: bool) -> Result<Codes> {
        let mut counts = [0; 16];
        for &length in lengths {
            counts[usize::from(length)] += 1;
        }
        let used = lengths.len() - counts[0];
        counts[0] = 0;
        let mut left = 1i64;
        for &count in &counts[1..] {
            left = 2 * left - count as i64;
            sound(left >= 0)?;
        }
        sound(left == 0 || used == 0 || (may_be_one && used == 1 && counts[1] == 1))?;
        let mut symbols: Vec<usize> = (0..lengths.len()).filter(|&symbol| lengths[symbol] > 0).collect();
        symbols.sort_by_key(|&symbol| lengths[symbol]);
        Ok(Codes { counts, symbols })
    }

    fn read(&self, bits: &mut Bits) -> Result<usize> {
        let (mut code, mut first, mut index) = (0, 0, 0);
        for count in &self.counts[1..] {
            code |= bits.take(1)?;
            if code < first + count {
                return Ok(self.symbols[index + code - first]);
            }
            index += count;
            first = (first + count) << 1;
            code <<= 1;
        }
        sound(false)?;
        Ok(0)
    }
}

const ORDER: [usize; 19] = [16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15];

/// Inflate all of `bytes` into exactly `wanted` bytes.
pub fn inflate(bytes: &[u8], wanted: usize) -> Result<Vec<u8>> {
    let mut bits = Bits { bytes, at: 0, held: 0, count: 0 };
    let mut out = Vec::with_capacity(wanted);
    loop {
        let last = bits.take(1)?;
        match bits.take(2)? {
            0 => stored(&mut bits, &mut out, wanted)?,
            1 => {
                let lengths: Vec<u8> =
                    (0..288).map(|i| if i < 144 { 8 } else if i < 256 { 9 } else if i < 280 { 7 } else { 8 }).collect();
                block(&mut bits, &mut out, wanted, &Codes::new(&lengths, false)?, &Codes::new(&[5; 32], false)?)?;
            }
            2 => {
                let (literals, distances) = dynamic(&mut bits)?;
                block(&mut bits, &mut out, wanted, &literals, &distances)?;
            }
            _ => sound(false)?,
        }
        if last == 1 {
            break;
        }
    }
    sound(out.len() == wanted && bits.at == bytes.len())?;
    Ok(out)
}

fn stored(bits: &mut Bits, out: &mut Vec<u8>, wanted: usize) -> Result<()> {
    bits.take(bits.count & 7)?;
    let (size, check) = (bits.take(16)?, bits.take(16)?);
    sound(size ^ check == 0xffff && bits.at + size <= bits.bytes.len() && out.len() + size <= wanted)?;
    out.extend_from_slice(&bits.bytes[bits.at..bits.at + size]);
    bits.at += size;
    Ok(())
}

fn dynamic(bits: &mut Bits) -> Result<(Codes, Codes)> {
    let (literals, distances, coded) = (bits.take(5)? + 257, bits.take(5)? + 1, bits.take(4)? + 4);
    sound(literals <= 286 && distances <= 30)?;
    let mut order = [0u8; 19];
    for place in &ORDER[..coded] {
        order[*place] = bits.take(3)? as u8;
    }
    let codes = Codes::new(&order, false)?;
    let mut lengths: Vec<u8> = Vec::new();
    while lengths.len() < literals + distances {
        let symbol = codes.read(bits)?;
        let (length, times) = match symbol {
            16 => {
                sound(!lengths.is_empty())?;
                (lengths[lengths.len() - 1], 3 + bits.take(2)?)
            }
            17 => (0, 3 + bits.take(3)?),
            18 => (0, 11 + bits.take(7)?),
            _ => (symbol as u8, 1),
        };
        sound(lengths.len() + times <= literals + distances)?;
        lengths.resize(lengths.len() + times, length);
    }
    sound(lengths[256] > 0)?;
    Ok((Codes::new(&lengths[..literals], true)?, Codes::new(&lengths[literals..], true)?))
}

fn block(bits: &mut Bits, out: &mut Vec<u8>, wanted: usize, literals: &Codes, distances: &Codes) -> Result<()> {
    loop {
        let symbol = literals.read(bits)?;
        if symbol == 256 {
            return Ok(());
        }
        if symbol < 256 {
            sound(out.len() < wanted)?;
            out.push(symbol as u8);
            continue;
        }
        sound(symbol <= 285)?;
        let length = match symbol {
            285 => 258,
            _ => ranged(bits, symbol - 257, 4, 3)?,
        };
        let symbol = distances.read(bits)?;
        sound(symbol < 30)?;
        let distance = ranged(bits, symbol, 2, 1)?;
        sound(distance <= out.len() && out.len() + length <= wanted)?;
        for _ in 0..length {
            out.push(out[out.len() - distance]);
        }
    }
}

/// A length or distance: `each` symbols share a number of extra bits, two groups none; the first is `least`.
fn ranged(bits: &mut Bits, symbol: usize, each: usize, least: usize) -> Result<usize> {
    if symbol < 2 * each {
        return Ok(least + symbol);
    }
    let extra = symbol / each - 1;
    Ok(least + ((each + symbol % each) << extra) + bits.take(extra as u32)?)
}
