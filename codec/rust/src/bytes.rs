//! Little-endian numbers out of bytes, one after the other.

use crate::refusal::{Refusal, Result};

pub struct Reader<'a> {
    pub rest: &'a [u8],
    code: &'static str,
}

macro_rules! numbers {
    ($($name:ident: $kind:ty),*) => {
        $(
            pub fn $name(&mut self) -> Result<$kind> {
                Ok(<$kind>::from_le_bytes(self.array()?))
            }
        )*
    };
}

impl<'a> Reader<'a> {
    /// Reads `bytes`; `code` is the refusal where they end too early.
    pub fn new(bytes: &'a [u8], code: &'static str) -> Self {
        Self { rest: bytes, code }
    }

    pub fn take(&mut self, count: usize) -> Result<&'a [u8]> {
        if count > self.rest.len() {
            return Err(Refusal(self.code));
        }
        let (taken, rest) = self.rest.split_at(count);
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let mut array = [0; N];
        array.copy_from_slice(self.take(N)?);
        Ok(array)
    }

    numbers!(u8: u8, u16: u16, u32: u32, u64: u64, i32: i32, f32: f32, f64: f64);

    pub fn f32s(&mut self, count: usize) -> Result<Vec<f32>> {
        (0..count).map(|_| self.f32()).collect()
    }

    pub fn f64s(&mut self, count: usize) -> Result<Vec<f64>> {
        (0..count).map(|_| self.f64()).collect()
    }

    /// Half precision, widened.
    pub fn f16s(&mut self, count: usize) -> Result<Vec<f32>> {
        (0..count).map(|_| Ok(widened(self.u16()?))).collect()
    }

    pub fn end(&self) -> Result<()> {
        if self.rest.is_empty() { Ok(()) } else { Err(Refusal(self.code)) }
    }
}

fn widened(half: u16) -> f32 {
    let (exponent, mantissa) = (i32::from(half >> 10 & 31), f32::from(half & 1023));
    let size = match exponent {
        0 => mantissa * 2f32.powi(-24),
        31 if mantissa == 0.0 => f32::INFINITY,
        31 => f32::NAN,
        _ => (1024.0 + mantissa) * 2f32.powi(exponent - 25),
    };
    if half >> 15 == 1 { -size } else { size }
}

/// CRC-32 of zlib and PNG, taken on from `before`.
pub fn crc32(bytes: &[u8], before: u32) -> u32 {
    !bytes.iter().fold(!before, |crc, &byte| CRC[((crc ^ u32::from(byte)) & 255) as usize] ^ crc >> 8)
}

const CRC: [u32; 256] = {
    let mut table = [0; 256];
    let mut i = 0;
    while i < 256 {
        let (mut crc, mut bit) = (i as u32, 0);
        while bit < 8 {
            crc = if crc & 1 == 1 { 0xedb8_8320 ^ crc >> 1 } else { crc >> 1 };
            bit += 1;
        }
        table[i] = crc;
        i += 1;
    }
    table
};
