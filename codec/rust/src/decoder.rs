//! Packets into a scene (section 3). A packet that is refused changes nothing.

use crate::change::{change, Change};
use crate::packet::{chunk, parse, Limits, Packet, KEY};
use crate::refusal::{must, sound, Refusal, Result};
use crate::rows::{added, base, geometry, narrowed, removed, Room};
use crate::scene::{Header, Level, Scene, Weights, LATENTS};

/// Decodes the packets of one stream.
#[derive(Clone)]
pub struct Decoder {
    pub limits: Limits,
    pub scene: Option<Scene>,
}

impl Decoder {
    pub fn new(limits: Limits) -> Decoder {
        Decoder { limits, scene: None }
    }

    /// Decode one packet.
    pub fn push(&mut self, bytes: &[u8]) -> Result<()> {
        let packet = parse(bytes, self.limits.packet_bytes)?;
        if packet.fields.kind == KEY { self.key(&packet) } else { self.change(&packet) }
    }

    fn key(&mut self, packet: &Packet) -> Result<()> {
        let chunks = (packet.chunk(0, chunk::HEADER), packet.chunk(0, chunk::WEIGHTS));
        let fresh = match chunks {
            (Some(header), Some(weights)) => Some(new_scene(packet, header, weights)?),
            _ => None,
        };
        let held = match &fresh {
            Some(scene) => scene,
            None => self.held(packet)?,
        };
        must(u32::from(packet.fields.mask) >> held.levels.len() == 0, "bad_scene_header")?;
        let mut rooms: Vec<Level> = held.levels.clone(); // only their lengths count
        packet.levels().for_each(|level| rooms[level] = Level::default());
        for level in packet.levels() {
            let room = Room::new(&held.header, &self.limits, &rooms, packet.level_bytes(level));
            rooms[level] = key_level(packet, level, &held.header, &room)?;
        }
        let mut scene = match fresh {
            Some(scene) => scene,
            None => self.scene.take().ok_or(Refusal("no_keyframe"))?,
        };
        scene.levels = rooms;
        packet.levels().for_each(|level| scene.versions[level] = packet.fields.keyframe.into());
        self.scene = Some(scene);
        Ok(())
    }

    fn change(&mut self, packet: &Packet) -> Result<()> {
        let scene = self.held(packet)?;
        must(u32::from(packet.fields.mask) >> scene.levels.len() == 0, "bad_scene_header")?;
        let from = i64::from(packet.fields.from_version);
        let matching: Vec<usize> = packet.levels().filter(|&level| scene.versions[level] == from).collect();
        must(!matching.is_empty(), "version_mismatch")?;
        let mut levels = scene.levels.clone();
        for &level in &matching {
            let room = Room::new(&scene.header, &self.limits, &levels, packet.level_bytes(level));
            changed(packet, level, &scene.header, &mut levels[level], &room)?;
        }
        if let Some(scene) = &mut self.scene {
            scene.levels = levels;
            matching.iter().for_each(|&level| scene.versions[level] = packet.fields.to_version.into());
        }
        Ok(())
    }

    fn held(&self, packet: &Packet) -> Result<&Scene> {
        let scene = self.scene.as_ref().ok_or(Refusal("no_keyframe"))?;
        let same = (scene.keyframe, scene.identifier) == (packet.fields.keyframe, packet.fields.identifier);
        must(same, "unknown_keyframe")?;
        Ok(scene)
    }
}

fn new_scene(packet: &Packet, header: &[u8], weights: &[u8]) -> Result<Scene> {
    let header = Header::read(header)?;
    let weights = Weights::read(weights, &header)?;
    let count = header.levels;
    Ok(Scene {
        header,
        weights,
        levels: vec![Level::default(); count],
        versions: vec![-1; count],
        keyframe: packet.fields.keyframe,
        identifier: packet.fields.identifier,
        metadata: packet.chunk(0, chunk::METADATA).unwrap_or_default().to_vec(),
    })
}

fn key_level(packet: &Packet, number: usize, header: &Header, room: &Room) -> Result<Level> {
    let profile = packet.fields.profile;
    let level = match (packet.chunk(number, chunk::GEOMETRY), packet.chunk(number, chunk::BASE)) {
        (Some(voxels), Some(rest)) => base(rest, profile, header, geometry(voxels, profile, room)?, room)?,
        _ => Level::default(),
    };
    check_hash(packet, number, &level)?;
    Ok(level)
}

fn changed(packet: &Packet, number: usize, header: &Header, level: &mut Level, room: &Room) -> Result<()> {
    let fields = &packet.fields;
    let (age, span) = (fields.from_version - fields.keyframe, fields.to_version - fields.from_version);
    let moved = match packet.chunk(number, chunk::CHANGE) {
        Some(data) => change(data, fields.profile, level, age, span, room)?,
        None => Change::default(),
    };
    let dead = match packet.chunk(number, chunk::REMOVED) {
        Some(data) => removed(data, fields.profile, level, room)?,
        None => Vec::new(),
    };
    let more = match packet.chunk(number, chunk::ADDED) {
        Some(data) => added(data, fields.profile, header, room)?,
        None => Level::default(),
    };
    for (i, &row) in moved.rows.iter().enumerate() {
        for axis in 0..3 {
            let place = &mut level.position[row][axis];
            *place = narrowed(i64::from(*place) + moved.position[3 * i + axis])?;
        }
        for c in 0..LATENTS {
            let latent = &mut level.latent[row][c];
            *latent = narrowed(i64::from(*latent) + i64::from(moved.latent[LATENTS * i + c]))?;
        }
    }
    dead.into_iter().for_each(|row| level.alive[row] = false);
    level.append(&more);
    check_hash(packet, number, level)
}

fn check_hash(packet: &Packet, number: usize, level: &Level) -> Result<()> {
    let Some(hash) = packet.chunk(number, chunk::HASH) else { return Ok(()) };
    sound(hash.len() == 4)?;
    must(hash == level.hash().to_le_bytes(), "state_mismatch")
}
