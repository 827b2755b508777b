//! Files with one JSON value per line (`metrics.jsonl`, `eval.jsonl`) that survive a kill and can
//! be resumed.

use std::fs::{self, OpenOptions};
use std::path::Path;

use serde::Serialize;
use serde::de::{DeserializeOwned, IgnoredAny};

use super::{Appender, Error, write_atomic};

/// A line as it is read: a JSON object.
pub type JsonObject = serde_json::Map<String, serde_json::Value>;

/// Writer that appends values to a JSON-lines file, one line each.
///
/// When [`append`](Self::append) returns, the line has been passed to the operating system. Numbers
/// that JSON cannot express (NaN, infinities) are written as `null`.
#[derive(Debug)]
pub struct JsonLines {
    appender: Appender,
    line: Vec<u8>,
}

impl JsonLines {
    /// Creates an empty file, or empties an existing one.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be created.
    pub fn create(path: &Path) -> Result<Self, Error> {
        Self::open(path, Some(0))
    }

    /// Opens a file to continue it, or creates it.
    ///
    /// An incomplete last line, left by a run that was killed, is removed.
    ///
    /// # Errors
    /// [`Error::Io`] if the file cannot be read or opened.
    pub fn resume(path: &Path) -> Result<Self, Error> {
        let mut resumed = Self::open(path, None)?;
        let text = fs::read(path).map_err(Error::io("read", path))?;
        let (complete, tail) = split_complete(&text);
        if is_object(tail) {
            // Only the newline is missing: an incomplete JSON object does not parse.
            resumed.appender.append(b"\n")?;
        } else if !tail.is_empty() {
            resumed = Self::open(path, Some(complete.len() as u64))?;
        }
        Ok(resumed)
    }

    fn open(path: &Path, keep: Option<u64>) -> Result<Self, Error> {
        let appender = Appender::open(path, OpenOptions::new().create(true), keep)?;
        Ok(Self { appender, line: Vec::new() })
    }

    /// Removes the lines for which `gone` returns true. A run that is resumed from a checkpoint
    /// thus does not record the steps after the checkpoint twice.
    ///
    /// # Errors
    /// [`Error::Line`] if a line is not a JSON object, [`Error::Io`] if the file cannot be
    /// rewritten; the file is then unchanged.
    pub fn remove_where(&mut self, gone: impl Fn(&JsonObject) -> bool) -> Result<(), Error> {
        let path = self.appender.path.clone();
        let text = fs::read(&path).map_err(Error::io("read", &path))?;
        let mut kept = Vec::with_capacity(text.len());
        for (index, line) in text.split_inclusive(|&b| b == b'\n').enumerate() {
            let object: JsonObject = serde_json::from_slice(line)
                .map_err(|source| Error::Line { path: path.clone(), line: index + 1, source })?;
            if !gone(&object) {
                kept.extend_from_slice(line);
            }
        }
        if kept.len() < text.len() {
            write_atomic(&path, &kept)?;
            *self = Self::open(&path, None)?;
        }
        Ok(())
    }

    /// Appends `value` as one line.
    ///
    /// # Errors
    /// [`Error::Encode`] if the value has no JSON form, [`Error::Io`] if the line cannot be
    /// written; the file then ends with the previous line.
    pub fn append(&mut self, value: &impl Serialize) -> Result<(), Error> {
        self.line.clear();
        serde_json::to_writer(&mut self.line, value)
            .map_err(|source| Error::Encode { path: self.appender.path.clone(), source })?;
        self.line.push(b'\n');
        self.appender.append(&self.line)
    }

    /// Forces all lines to disk; call it before writing a checkpoint that relies on them.
    ///
    /// # Errors
    /// [`Error::Io`] if the operating system reports an error.
    pub fn sync(&self) -> Result<(), Error> {
        self.appender.sync()
    }
}

/// Reads every line of a JSON-lines file. An incomplete last line is left out.
///
/// # Errors
/// [`Error::Io`] if the file cannot be read, [`Error::Line`] with the number of the first complete
/// line that is not a `T`.
pub fn read_json_lines<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, Error> {
    let text = fs::read(path).map_err(Error::io("read", path))?;
    let (complete, tail) = split_complete(&text);
    complete
        .split_inclusive(|&b| b == b'\n')
        .chain(is_object(tail).then_some(tail))
        .enumerate()
        .map(|(index, line)| {
            serde_json::from_slice(line).map_err(|source| Error::Line {
                path: path.to_owned(),
                line: index + 1,
                source,
            })
        })
        .collect()
}

/// Splits a text into its complete lines and the rest after the last newline.
fn split_complete(text: &[u8]) -> (&[u8], &[u8]) {
    text.split_at(text.iter().rposition(|&b| b == b'\n').map_or(0, |i| i + 1))
}

fn is_object(text: &[u8]) -> bool {
    text.starts_with(b"{") && serde_json::from_slice::<IgnoredAny>(text).is_ok()
}

#[cfg(test)]
mod tests {
    use std::io;

    use serde::Deserialize;

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Row {
        step: u64,
        loss: f64,
    }

    fn row(step: u64) -> Row {
        Row { step, loss: 0.5 }
    }

    fn steps(path: &Path) -> Vec<u64> {
        read_json_lines::<Row>(path).unwrap().iter().map(|r| r.step).collect()
    }

    #[test]
    fn lines_are_readable_as_soon_as_they_are_appended() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut lines = JsonLines::create(&path).unwrap();
        lines.append(&row(1)).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "{\"step\":1,\"loss\":0.5}\n");
        lines.append(&row(2)).unwrap();
        lines.sync().unwrap();
        assert_eq!(read_json_lines::<Row>(&path).unwrap(), [row(1), row(2)]);
        JsonLines::create(&path).unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"");
    }

    #[test]
    fn resume_after_a_kill_at_any_byte_keeps_the_complete_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let full = b"{\"step\":1,\"loss\":0.5}\n{\"step\":2,\"loss\":0.5}\n";
        for cut in 0..=full.len() {
            fs::write(&path, &full[..cut]).unwrap();
            let complete =
                [1, 2].into_iter().filter(|&n| cut + 1 >= n * full.len() / 2).map(|n| n as u64);
            let expected: Vec<u64> = complete.chain([9]).collect();
            assert_eq!(steps(&path), expected[..expected.len() - 1], "reading, cut at byte {cut}");
            JsonLines::resume(&path).unwrap().append(&row(9)).unwrap();
            assert_eq!(steps(&path), expected, "resuming, cut at byte {cut}");
        }
    }

    #[test]
    fn resume_makes_a_missing_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        JsonLines::resume(&path).unwrap().append(&row(1)).unwrap();
        assert_eq!(steps(&path), [1]);
    }

    fn after(line: &JsonObject, step: u64) -> bool {
        line.get("step").and_then(serde_json::Value::as_u64).is_some_and(|own| own > step)
    }

    #[test]
    fn later_steps_are_removed_and_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut lines = JsonLines::create(&path).unwrap();
        lines.append(&serde_json::json!({"note": "no step"})).unwrap();
        for step in [100, 200, 300] {
            lines.append(&row(step)).unwrap();
            lines.append(&serde_json::json!({"step": step, "loss": 1.0, "eval": true})).unwrap();
        }
        lines.remove_where(|line| after(line, 200)).unwrap();
        lines.append(&row(250)).unwrap();
        let values: Vec<serde_json::Value> = read_json_lines(&path).unwrap();
        let kept: Vec<_> = values.iter().map(|v| v["step"].as_u64()).collect();
        assert_eq!(kept, [None, Some(100), Some(100), Some(200), Some(200), Some(250)]);
        lines.remove_where(|line| after(line, 0)).unwrap();
        assert_eq!(fs::read_to_string(&path).unwrap(), "{\"note\":\"no step\"}\n");
    }

    #[test]
    fn damage_inside_the_file_is_reported_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let damaged = "{\"step\":1,\"loss\":0.5}\n{\"step\":\n{\"step\":3,\"loss\":0.5}\n";
        fs::write(&path, damaged).unwrap();
        let error =
            JsonLines::resume(&path).unwrap().remove_where(|line| after(line, 1)).unwrap_err();
        assert!(matches!(error, Error::Line { line: 2, .. }), "{error}");
        assert!(matches!(read_json_lines::<Row>(&path), Err(Error::Line { line: 2, .. })));
        assert_eq!(fs::read_to_string(&path).unwrap(), damaged);
    }

    #[test]
    fn a_value_without_json_form_is_refused_and_nothing_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("metrics.jsonl");
        let mut lines = JsonLines::create(&path).unwrap();
        lines.append(&row(1)).unwrap();
        let map = std::collections::BTreeMap::from([(vec![1], 1)]);
        assert!(matches!(lines.append(&map), Err(Error::Encode { .. })));
        lines.append(&row(2)).unwrap();
        assert_eq!(steps(&path), [1, 2]);
    }

    #[test]
    fn a_file_that_is_not_a_file_is_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let error = JsonLines::resume(folder.path()).unwrap_err();
        assert!(
            matches!(&error, Error::Io { source, .. } if source.kind() == io::ErrorKind::IsADirectory),
            "{error:?}"
        );
    }
}
