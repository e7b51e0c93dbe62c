//! What a decoder holds (section 1), the scene header (section 4) and the weights (section 5).

use crate::bytes::{crc32, Reader};
use crate::packet::Limits;
use crate::refusal::{must, Refusal, Result};

pub const LATENTS: usize = 24;
pub const SCALINGS: usize = 6;
const HIDDEN: usize = 32;
const MAX_LENGTH: f64 = 1e9;
const MIN_LENGTH: f64 = 1e-6;

#[derive(Clone, Debug)]
pub struct Camera {
    pub name: String,
    pub width: u32,
    pub height: u32,
    /// 3x3, row-major.
    pub intrinsics: Vec<f64>,
    /// The upper three rows of 4x4, row-major.
    pub world_to_camera: Vec<f64>,
    pub distortion: Vec<f64>,
}

#[derive(Clone, Debug)]
pub struct Header {
    pub levels: usize,
    /// Gaussians of an anchor, K.
    pub slots: usize,
    /// F
    pub features: usize,
    pub view_dependent: bool,
    pub origin: [f64; 3],
    pub root_cell: f64,
    pub reference_distance: f64,
    pub fps: f64,
    pub background: Vec<f32>,
    pub position_steps: Vec<f32>,
    pub feature_steps: Vec<f32>,
    pub offset_steps: Vec<f32>,
    pub scaling_steps: Vec<f32>,
    pub cameras: Vec<Camera>,
}

#[derive(Clone, Debug)]
pub struct Weights {
    /// [I,32], row-major, like all others.
    pub hidden_weight: Vec<f32>,
    pub hidden_bias: Vec<f32>,
    /// [32,11K]
    pub output_weight: Vec<f32>,
    pub output_bias: Vec<f32>,
    /// [12,F]
    pub feature_decoder: Vec<f32>,
    /// [12,3K]
    pub offset_decoder: Vec<f32>,
}

/// Anchors of one level, each column row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Level {
    pub voxel: Vec<[i32; 3]>,
    pub feature: Vec<i16>,
    pub offset: Vec<i16>,
    pub scaling: Vec<i16>,
    pub extra_level: Vec<i16>,
    pub position: Vec<[i32; 3]>,
    pub latent: Vec<[i16; LATENTS]>,
    pub alive: Vec<bool>,
}

impl Level {
    pub fn len(&self) -> usize {
        self.voxel.len()
    }

    pub fn is_empty(&self) -> bool {
        self.voxel.is_empty()
    }

    /// Give `take` the bytes of section 11, in pieces.
    pub fn each_byte(&self, mut take: impl FnMut(&[u8])) {
        self.voxel.iter().flatten().for_each(|x| take(&x.to_le_bytes()));
        for column in [&self.feature, &self.offset, &self.scaling, &self.extra_level] {
            column.iter().for_each(|x| take(&x.to_le_bytes()));
        }
        self.position.iter().flatten().for_each(|x| take(&x.to_le_bytes()));
        self.latent.iter().flatten().for_each(|x| take(&x.to_le_bytes()));
        self.alive.iter().for_each(|&x| take(&[x.into()]));
    }

    /// The state hash of section 11.
    pub fn hash(&self) -> u32 {
        let mut crc = 0;
        self.each_byte(|bytes| crc = crc32(bytes, crc));
        crc
    }

    pub fn append(&mut self, other: &Level) {
        self.voxel.extend_from_slice(&other.voxel);
        self.feature.extend_from_slice(&other.feature);
        self.offset.extend_from_slice(&other.offset);
        self.scaling.extend_from_slice(&other.scaling);
        self.extra_level.extend_from_slice(&other.extra_level);
        self.position.extend_from_slice(&other.position);
        self.latent.extend_from_slice(&other.latent);
        self.alive.extend_from_slice(&other.alive);
    }
}

#[derive(Clone, Debug)]
pub struct Scene {
    pub header: Header,
    pub weights: Weights,
    pub levels: Vec<Level>,
    /// Version of each level, -1 where it is absent.
    pub versions: Vec<i64>,
    pub keyframe: u32,
    pub identifier: u64,
    /// The METADATA chunk (section 2.1), empty without one.
    pub metadata: Vec<u8>,
}

impl Header {
    pub fn read(bytes: &[u8]) -> Result<Header> {
        const CODE: &str = "bad_scene_header";
        let mut reader = Reader::new(bytes, CODE);
        let counts = reader.take(8)?;
        let [levels, slots, features] = [0, 1, 2].map(|i| usize::from(counts[i]));
        must(levels <= 16 && slots <= 16 && features <= 64, "limit_exceeded")?;
        let flags = counts[3] <= 1 && counts[5..].iter().all(|&reserved| reserved == 0);
        must(levels > 0 && slots > 0 && features > 0 && flags, CODE)?;
        let origin = [reader.f64()?, reader.f64()?, reader.f64()?];
        must(origin.iter().all(|x| x.abs() <= MAX_LENGTH), CODE)?;
        let (root_cell, reference_distance, fps) = (reader.f64()?, reader.f64()?, reader.f64()?);
        must([root_cell, reference_distance].iter().all(|x| (MIN_LENGTH..=MAX_LENGTH).contains(x)), CODE)?;
        must((0.001..=10_000.0).contains(&fps), CODE)?;
        let background = reader.f32s(3)?;
        must(background.iter().all(|x| (0.0..=1.0).contains(x)), CODE)?;
        let mut steps = Vec::new();
        for count in [levels, features, 3 * slots, SCALINGS] {
            let own = reader.f32s(count)?;
            must(own.iter().all(|&x| x > 0.0 && f64::from(x) <= MAX_LENGTH), CODE)?;
            steps.push(own);
        }
        let cameras = (0..counts[4]).map(|_| Camera::read(&mut reader)).collect::<Result<_>>()?;
        reader.end()?;
        let mut steps = steps.into_iter();
        let mut next = || steps.next().unwrap_or_default();
        Ok(Header {
            levels,
            slots,
            features,
            view_dependent: counts[3] == 1,
            origin,
            root_cell,
            reference_distance,
            fps,
            background,
            position_steps: next(),
            feature_steps: next(),
            offset_steps: next(),
            scaling_steps: next(),
            cameras,
        })
    }

    /// Channels of BASE.
    pub fn base_channels(&self) -> usize {
        self.features + 3 * self.slots + SCALINGS + 1 + 3
    }

    /// The most rows of all levels together.
    pub fn most_rows(&self, limits: &Limits) -> u64 {
        let row_bytes = 87 + 2 * self.features as u64 + 6 * self.slots as u64;
        limits.rows.min(limits.gaussians / self.slots as u64).min(limits.state_bytes / row_bytes)
    }
}

impl Camera {
    fn read(reader: &mut Reader) -> Result<Camera> {
        const CODE: &str = "bad_scene_header";
        let length = usize::from(reader.u8()?);
        must(length <= 64, CODE)?;
        let name = std::str::from_utf8(reader.take(length)?).map_err(|_| Refusal(CODE))?.to_owned();
        let (width, height) = (reader.u32()?, reader.u32()?);
        must((1..=65535).contains(&width) && (1..=65535).contains(&height), CODE)?;
        let (intrinsics, world_to_camera, distortion) = (reader.f64s(9)?, reader.f64s(12)?, reader.f64s(5)?);
        let mut numbers = intrinsics.iter().chain(&world_to_camera).chain(&distortion);
        must(numbers.all(|x| x.abs() <= 1e12) && intrinsics[0] > 0.0 && intrinsics[4] > 0.0, CODE)?;
        let r = |i: usize, j: usize| world_to_camera[4 * i + j];
        for i in 0..3 {
            for j in 0..3 {
                let product: f64 = (0..3).map(|k| r(i, k) * r(j, k)).sum();
                must((product - if i == j { 1.0 } else { 0.0 }).abs() <= 1e-3, CODE)?;
            }
        }
        let minor = |a: usize, b: usize| r(1, a) * r(2, b) - r(1, b) * r(2, a);
        must(r(0, 0) * minor(1, 2) - r(0, 1) * minor(0, 2) + r(0, 2) * minor(0, 1) > 0.0, CODE)?;
        Ok(Camera { name, width, height, intrinsics, world_to_camera, distortion })
    }
}

impl Weights {
    pub fn read(bytes: &[u8], header: &Header) -> Result<Weights> {
        let mut reader = Reader::new(bytes, "bad_weights");
        let inputs = header.features + if header.view_dependent { 4 } else { 0 };
        let (outputs, offsets) = (11 * header.slots, 3 * header.slots);
        let weights = Weights {
            hidden_weight: reader.f16s(inputs * HIDDEN)?,
            hidden_bias: reader.f16s(HIDDEN)?,
            output_weight: reader.f16s(HIDDEN * outputs)?,
            output_bias: reader.f16s(outputs)?,
            feature_decoder: reader.f16s(12 * header.features)?,
            offset_decoder: reader.f16s(12 * offsets)?,
        };
        reader.end()?;
        let all = [
            &weights.hidden_weight,
            &weights.hidden_bias,
            &weights.output_weight,
            &weights.output_bias,
            &weights.feature_decoder,
            &weights.offset_decoder,
        ];
        must(all.iter().all(|part| part.iter().all(|x| x.is_finite())), "bad_weights")?;
        Ok(weights)
    }
}
