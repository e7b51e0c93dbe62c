//! `streamlod-decode FILE.slod` prints what the file decodes to; `streamlod-decode --batch FILE` decodes many streams.
//!
//! All output is JSON, states as in tests/vectors (section 16). A batch is, for each stream, a u32 count, then so many
//! times a u32 size and a packet; for each stream its last packet's refusal and the state behind it are printed.

use std::io::Write;
use std::process::ExitCode;

use streamlod_decode::bytes::Reader;
use streamlod_decode::refusal::Result;
use streamlod_decode::scene::Level;
use streamlod_decode::sha256::Sha256;
use streamlod_decode::{Decoder, File, Limits};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (batch, path) = match arguments.as_slice() {
        [path] => (false, path),
        [option, path] if option == "--batch" => (true, path),
        _ => return failed("usage: streamlod-decode [--batch] FILE"),
    };
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) => return failed(&format!("{path}: {error}")),
    };
    let report = if batch { streams(&bytes) } else { file(&bytes) };
    match report {
        Ok(text) if std::io::stdout().write_all(text.as_bytes()).is_ok() => ExitCode::SUCCESS,
        Ok(_) => ExitCode::FAILURE,
        Err(refusal) => failed(&format!("{path}: {}", refusal.0)),
    }
}

fn failed(text: &str) -> ExitCode {
    eprintln!("{text}");
    ExitCode::FAILURE
}

fn streams(bytes: &[u8]) -> Result<String> {
    let (mut reader, mut lines) = (Reader::new(bytes, "truncated"), Vec::new());
    while !reader.rest.is_empty() {
        let (mut decoder, mut code) = (Decoder::new(Limits::MAIN), "");
        for _ in 0..reader.u32()? {
            let size = reader.u32()? as usize;
            code = decoder.push(reader.take(size)?).err().map_or("", |refusal| refusal.0);
        }
        lines.push(format!("[\"{code}\",{{{}}}]", state(&decoder)));
    }
    Ok(format!("[{}]\n", lines.join(",\n")))
}

fn file(bytes: &[u8]) -> Result<String> {
    let file = File::new(bytes)?;
    let mut versions: Vec<u32> = file.entries.iter().map(|entry| entry.to_version).collect();
    versions.sort_unstable();
    versions.dedup();
    let ways: Vec<String> = versions
        .into_iter()
        .map(|version| match file.way(version) {
            Some(numbers) => format!("\"{version}\":{{\"numbers\":{numbers:?},{}}}", decoded(&file, &numbers)),
            None => format!("\"{version}\":null"),
        })
        .collect();
    let all: Vec<usize> = (0..file.entries.len()).collect();
    let (indexed, count) = (file.indexed, file.entries.len());
    let in_order = decoded(&file, &all);
    let head = format!("\"indexed\":{indexed},\"packets\":{count},\"in_order\":{{{in_order}}}");
    Ok(format!("{{{head},\"ways\":{{{}}}}}\n", ways.join(",")))
}

/// The state after these packets, passing over those that are there to seek with, or the first other refusal.
fn decoded(file: &File, numbers: &[usize]) -> String {
    let mut decoder = Decoder::new(Limits::MAIN);
    for &number in numbers {
        if let Err(refusal) = file.packet(number).and_then(|packet| decoder.push(packet)) {
            if refusal.0 != "version_mismatch" {
                return format!("\"refused\":\"{}\",\"packet\":{number}", refusal.0);
            }
        }
    }
    state(&decoder)
}

fn state(decoder: &Decoder) -> String {
    let Some(scene) = &decoder.scene else { return "\"versions\":[],\"levels\":[]".to_owned() };
    let levels: Vec<String> = scene.levels.iter().map(digest).collect();
    format!("\"versions\":{:?},\"levels\":{levels:?}", scene.versions)
}

fn digest(level: &Level) -> String {
    let mut sum = Sha256::default();
    level.each_byte(|bytes| sum.update(bytes));
    sum.hex()
}
