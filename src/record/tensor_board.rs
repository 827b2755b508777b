//! TensorBoard event files; supports only scalars.
//!
//! An event file is a sequence of framed records (`length: u64`, masked CRC-32C of the length, the
//! data, masked CRC-32C of the data; little endian). Each record is an `Event` protocol buffer, of
//! which only the time, the step, the file version, the mark of a restart and scalar summaries are
//! written. For the field numbers see `tensorflow/core/util/event.proto`,
//! `tensorflow/core/framework/summary.proto` and the TFRecord format.

use std::fs::OpenOptions;
use std::io;
use std::path::Path;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::{Appender, Error};

/// Writer of scalars into a TensorBoard event file.
#[derive(Debug)]
pub struct TensorBoard {
    appender: Appender,
}

impl TensorBoard {
    /// Creates a new event file in `folder`, which must exist.
    ///
    /// A run that is resumed after step `k` passes `resumed_after: Some(k)`. Its folder then
    /// contains several event files, and TensorBoard discards what the earlier ones recorded for
    /// steps after `k`.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be created or written.
    pub fn create(folder: &Path, resumed_after: Option<u64>) -> Result<Self, Error> {
        let mut now = now();
        // TensorBoard recognises event files by `tfevents` in their names and reads them in the
        // order of their names.
        let appender = loop {
            let path = folder.join(format!(
                "events.out.tfevents.{:010}.{:09}.iwol",
                now.as_secs(),
                now.subsec_nanos()
            ));
            match Appender::open(&path, OpenOptions::new().create_new(true), None) {
                Err(Error::Io { source, .. }) if source.kind() == io::ErrorKind::AlreadyExists => {
                    now += Duration::from_nanos(1);
                }
                opened => break opened?,
            }
        };
        let mut board = Self { appender };
        board.event(0, FILE_VERSION, b"brain.Event:2")?;
        if let Some(step) = resumed_after {
            let mut session = Vec::new();
            put_varint_field(&mut session, SESSION_STATUS, SESSION_START);
            board.event(step + 1, SESSION_LOG, &session)?;
        }
        Ok(board)
    }

    /// Writes scalars of one step under their tags, such as `loss/policy`. TensorBoard stores
    /// 32-bit floats.
    ///
    /// # Errors
    /// [`Error::Io`] if the record cannot be written; the file then ends with the previous record.
    pub fn write<'a>(
        &mut self,
        step: u64,
        scalars: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> Result<(), Error> {
        let mut summary = Vec::new();
        for (tag, value) in scalars {
            let mut entry = Vec::with_capacity(tag.len() + 16);
            put_bytes_field(&mut entry, VALUE_TAG, tag.as_bytes());
            put_key(&mut entry, VALUE_SIMPLE, WIRE_32_BIT);
            entry.extend_from_slice(&(value as f32).to_le_bytes());
            put_bytes_field(&mut summary, SUMMARY_VALUE, &entry);
        }
        self.event(step, SUMMARY, &summary)
    }

    /// Writes an event whose field `field` contains `content`.
    fn event(&mut self, step: u64, field: u32, content: &[u8]) -> Result<(), Error> {
        let mut event = Vec::with_capacity(content.len() + 32);
        put_key(&mut event, EVENT_WALL_TIME, WIRE_64_BIT);
        event.extend_from_slice(&now().as_secs_f64().to_le_bytes());
        put_varint_field(&mut event, EVENT_STEP, step);
        put_bytes_field(&mut event, field, content);
        self.appender.append(&frame(&event))
    }
}

// Field numbers of `Event`, `SessionLog`, `Summary` and `Summary.Value`.
const EVENT_WALL_TIME: u32 = 1;
const EVENT_STEP: u32 = 2;
const FILE_VERSION: u32 = 3;
const SUMMARY: u32 = 5;
const SESSION_LOG: u32 = 7;
const SESSION_STATUS: u32 = 1;
const SESSION_START: u64 = 1;
const SUMMARY_VALUE: u32 = 1;
const VALUE_TAG: u32 = 1;
const VALUE_SIMPLE: u32 = 2;

// Wire types of protocol buffers.
const WIRE_VARINT: u32 = 0;
const WIRE_64_BIT: u32 = 1;
const WIRE_LENGTH: u32 = 2;
const WIRE_32_BIT: u32 = 5;

fn now() -> Duration {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

fn put_varint(out: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        out.push(value as u8 | 0x80);
        value >>= 7;
    }
    out.push(value as u8);
}

fn put_key(out: &mut Vec<u8>, field: u32, wire: u32) {
    put_varint(out, u64::from(field << 3 | wire));
}

fn put_varint_field(out: &mut Vec<u8>, field: u32, value: u64) {
    put_key(out, field, WIRE_VARINT);
    put_varint(out, value);
}

fn put_bytes_field(out: &mut Vec<u8>, field: u32, bytes: &[u8]) {
    put_key(out, field, WIRE_LENGTH);
    put_varint(out, bytes.len() as u64);
    out.extend_from_slice(bytes);
}

/// Returns the data as a framed record.
fn frame(data: &[u8]) -> Vec<u8> {
    let length = (data.len() as u64).to_le_bytes();
    let mut out = Vec::with_capacity(data.len() + 16);
    out.extend_from_slice(&length);
    out.extend_from_slice(&masked_crc(&length).to_le_bytes());
    out.extend_from_slice(data);
    out.extend_from_slice(&masked_crc(data).to_le_bytes());
    out
}

/// Returns the checksum as the format stores it: rotated and offset, so that checksums of data that
/// contain checksums stay effective.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c(bytes).rotate_right(15).wrapping_add(0xa282_ead8)
}

/// CRC-32C (Castagnoli), bits reflected, bit by bit: records are short.
fn crc32c(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ ((crc & 1) * 0x82f6_3b78);
        }
    }
    !crc
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::PathBuf;

    use super::*;

    /// Splits a file into its records and checks both checksums of each.
    fn records(path: &Path) -> Vec<Vec<u8>> {
        let bytes = fs::read(path).unwrap();
        let mut rest = &bytes[..];
        let mut found = Vec::new();
        let unmask = |b: &[u8]| {
            u32::from_le_bytes(b.try_into().unwrap()).wrapping_sub(0xa282_ead8).rotate_left(15)
        };
        while !rest.is_empty() {
            assert_eq!(unmask(&rest[8..12]), crc32c(&rest[..8]));
            let length = u64::from_le_bytes(rest[..8].try_into().unwrap()) as usize;
            let data = &rest[12..12 + length];
            assert_eq!(unmask(&rest[12 + length..16 + length]), crc32c(data));
            found.push(data.to_vec());
            rest = &rest[16 + length..];
        }
        found
    }

    fn event_files(folder: &Path) -> Vec<PathBuf> {
        let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
        paths.sort();
        paths
    }

    #[test]
    fn checksum_matches_the_published_check_values() {
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
        assert_eq!(crc32c(&[0; 32]), 0x8a91_36aa); // RFC 3720, B.4
        assert_eq!(crc32c(b""), 0);
    }

    #[test]
    fn varints_follow_the_protocol_buffer_encoding() {
        for (value, expected) in
            [(0, &[0][..]), (127, &[127]), (128, &[0x80, 1]), (300, &[0xac, 2])]
        {
            let mut out = Vec::new();
            put_varint(&mut out, value);
            assert_eq!(out, expected);
        }
        let mut out = Vec::new();
        put_varint(&mut out, u64::MAX);
        assert_eq!(out, [&[0xff; 9][..], &[1]].concat());
    }

    #[test]
    fn events_have_exactly_the_bytes_of_the_format() {
        let folder = tempfile::tempdir().unwrap();
        let before = now().as_secs_f64();
        let mut board = TensorBoard::create(folder.path(), None).unwrap();
        board.write(300, [("a", 1.5), ("loss/b", -2.0)]).unwrap();
        let files = event_files(folder.path());
        assert_eq!(files.len(), 1);
        let records = records(&files[0]);
        assert_eq!(records.len(), 2);
        for record in &records {
            assert_eq!(record[0], 0x09); // wall time, 64 bits
            let time = f64::from_le_bytes(record[1..9].try_into().unwrap());
            assert!((before..=now().as_secs_f64()).contains(&time));
        }
        assert_eq!(records[0][9..], *b"\x10\x00\x1a\x0dbrain.Event:2");
        let expected =
            b"\x10\xac\x02\x2a\x19\x0a\x08\x0a\x01a\x15\x00\x00\xc0\x3f\x0a\x0d\x0a\x06loss/b\x15\x00\x00\x00\xc0";
        assert_eq!(records[1][9..], *expected);
    }

    #[test]
    fn a_resumed_run_marks_where_it_starts_again_in_a_later_file() {
        let folder = tempfile::tempdir().unwrap();
        for resumed_after in [None, Some(5), Some(7)] {
            TensorBoard::create(folder.path(), resumed_after).unwrap();
        }
        let starts: Vec<Vec<u8>> = event_files(folder.path())
            .iter()
            .map(|p| records(p).get(1).map_or(vec![], |r| r[9..].to_vec()))
            .collect();
        assert_eq!(starts, [&b""[..], b"\x10\x06\x3a\x02\x08\x01", b"\x10\x08\x3a\x02\x08\x01"]);
    }
}
