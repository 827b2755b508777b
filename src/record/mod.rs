//! The files of a run folder: metrics as JSON lines, TensorBoard events, and files that appear
//! complete or not at all.
//!
//! A run may be killed at any moment and resumed later, so no file may stay incomplete. Complete
//! files are written under a temporary name in the same folder and renamed. Files that grow are cut
//! back to the last complete record when they are opened again or when a write fails.

mod json_lines;
mod tensor_board;

use std::fs::{File, OpenOptions, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use tempfile::NamedTempFile;

pub use json_lines::{JsonLines, JsonObject, read_json_lines};
pub use tensor_board::TensorBoard;

/// An error of writing or reading a run file. Every message names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused (missing folder, no permission, full disk, ...).
    #[error("cannot {action} `{}`", path.display())]
    Io {
        /// The attempted action, as a verb.
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: io::Error,
    },
    /// A value has no JSON form, for example a map whose keys are not strings.
    #[error("cannot write a line to `{}`: the value has no JSON form", path.display())]
    Encode {
        /// The file that the value should be written to.
        path: PathBuf,
        /// The serialiser's error.
        source: serde_json::Error,
    },
    /// A complete line of a JSON-lines file is not valid: the file was edited, or is another kind
    /// of file.
    #[error("line {line} of `{}` is damaged; delete the line", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: usize,
        /// The parser's error.
        source: serde_json::Error,
    },
}

impl Error {
    /// Returns a function for `map_err` that wraps a system error.
    pub(crate) fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { action, path: path.to_owned(), source }
    }
}

/// Writes a complete file, so that a reader sees the old content or the new content, never a part.
///
/// The bytes are written to a temporary file in the same folder and forced to disk; a rename then
/// replaces `path`. If a step fails, the old file is unchanged. Only a kill can leave the temporary
/// file, whose name begins with `.tmp`. A path that is no regular file (a pipe, a device) is
/// written to directly, and a symbolic link to a file stays a link.
///
/// # Errors
/// [`Error::Io`], which names `path`.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    if is_stream(path) {
        return std::fs::write(path, bytes).map_err(Error::io("write", path));
    }
    let mut file = temporary_beside(path)?;
    file.as_file_mut().write_all(bytes).map_err(Error::io("write", path))?;
    file.as_file().sync_all().map_err(Error::io("write", path))?;
    let place = followed(path);
    file.persist(&place).map_err(|e| Error::io("replace", path)(e.error))?;
    // The rename survives a power cut only once the folder is on disk; not every file system
    // supports that.
    if let Ok(folder) = File::open(folder_of(&place)) {
        let _ = folder.sync_all();
    }
    Ok(())
}

/// Checks whether [`write_atomic`] could write to `path` now, without writing.
///
/// # Errors
/// [`Error::Io`], which names `path`.
pub fn check_writable(path: &Path) -> Result<(), Error> {
    if path.is_dir() {
        return Err(Error::io("write", path)(io::ErrorKind::IsADirectory.into()));
    }
    match path.symlink_metadata() {
        // For instance, its name is too long.
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            return Err(Error::io("write", path)(error));
        }
        _ => {}
    }
    if is_stream(path) { Ok(()) } else { temporary_beside(path).map(drop) }
}

/// Returns whether `path` is a file with something else in it than the JSON form of a `T`.
pub fn is_other_than<T: serde::de::DeserializeOwned>(path: &Path) -> bool {
    let is_empty = || path.metadata().is_ok_and(|found| found.len() == 0);
    let Ok(file) = File::open(path) else { return false };
    let read = || serde_json::from_reader::<_, T>(io::BufReader::new(file));
    path.is_file() && !is_empty() && read().is_err()
}

/// Returns whether two paths are those of one file, which need not exist.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| {
        let whole = path.canonicalize().ok();
        whole.or_else(|| {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            Some(folder.unwrap_or(Path::new(".")).canonicalize().ok()?.join(path.file_name()?))
        })
    };
    a == b || real(a).is_some_and(|a| real(b) == Some(a))
}

/// Returns whether `path` exists and is neither a file nor a folder.
fn is_stream(path: &Path) -> bool {
    path.metadata().is_ok_and(|found| !found.is_file() && !found.is_dir())
}

/// Returns the target of a symbolic link, or the path itself if it is no link.
fn followed(path: &Path) -> PathBuf {
    let linked = path.is_symlink().then(|| path.canonicalize().ok()).flatten();
    linked.unwrap_or_else(|| path.to_owned())
}

/// Creates an empty temporary file in the folder of `path`. The file is deleted on drop.
fn temporary_beside(path: &Path) -> Result<NamedTempFile, Error> {
    tempfile::Builder::new()
        // Temporary files are private by default; these get the usual permissions of a new file
        // (minus the umask).
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder_of(&followed(path)))
        .map_err(|error| Error::io("create", path)(without_path(error)))
}

/// Returns a system error without the path of the temporary file, which `tempfile` adds to it.
fn without_path(error: io::Error) -> io::Error {
    match error.to_string().rsplit_once(" at path ") {
        Some((cause, _)) => io::Error::new(error.kind(), cause.to_owned()),
        None => error,
    }
}

/// Returns the folder that contains `path`; `.` for a bare file name.
fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// A file that grows by complete records: one write each, undone if it fails.
#[derive(Debug)]
struct Appender {
    file: File,
    path: PathBuf,
    /// Length up to which the file contains complete records \[bytes\].
    len: u64,
}

impl Appender {
    /// Opens `path` with `options` in append mode and keeps its first `keep` bytes, or all of them.
    fn open(path: &Path, options: &mut OpenOptions, keep: Option<u64>) -> Result<Self, Error> {
        let file = options.append(true).open(path).map_err(Error::io("open", path))?;
        let len = match keep {
            Some(len) => file.set_len(len).map(|()| len),
            None => file.metadata().map(|m| m.len()),
        };
        Ok(Self { len: len.map_err(Error::io("open", path))?, file, path: path.to_owned() })
    }

    /// Appends one record and passes it to the operating system, so that killing this process
    /// cannot lose it.
    fn append(&mut self, record: &[u8]) -> Result<(), Error> {
        if let Err(source) = self.file.write_all(record) {
            // A partial record is cut off, because the next record would continue it. If that fails
            // as well, the first error is reported.
            let _ = self.file.set_len(self.len);
            return Err(Error::Io { action: "append to", path: self.path.clone(), source });
        }
        self.len += record.len() as u64;
        Ok(())
    }

    /// Forces all records to disk, so that a power cut cannot lose them either.
    fn sync(&self) -> Result<(), Error> {
        self.file.sync_data().map_err(Error::io("write", &self.path))
    }
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn files_of_one_kind_are_told_from_others() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a");
        let other = |text: &str| {
            std::fs::write(&file, text).unwrap();
            is_other_than::<Vec<u32>>(&file)
        };
        assert!(!other("[1, 2]\n") && !other(""));
        assert!(other("{\"a\": 1}") && other("[grid]\nseed = [1]") && other("<scenario/>"));
        assert!(!is_other_than::<Vec<u32>>(&folder.path().join("none")));
        let long = folder.path().join("a".repeat(300));
        assert!(check_writable(&long).is_err_and(|error| error.to_string().contains("aaa")));
    }

    fn names(folder: &Path) -> Vec<String> {
        fs::read_dir(folder)
            .unwrap()
            .map(|e| e.unwrap().file_name().into_string().unwrap())
            .collect()
    }

    #[test]
    fn two_spellings_of_a_path_are_one_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        std::fs::create_dir(path("a")).unwrap();
        assert!(super::is_same_file(&path("x.json"), &path("a/../x.json")), "it does not exist");
        assert!(super::is_same_file(&path("x.json"), &path("./x.json")));
        assert!(!super::is_same_file(&path("x.json"), &path("a/x.json")));
        assert!(super::is_same_file(Path::new("x.json"), Path::new("./x.json")));
    }

    #[test]
    fn write_atomic_creates_and_replaces() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("meta.json");
        write_atomic(&path, b"old and longer").unwrap();
        write_atomic(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(names(folder.path()), ["meta.json"]);
        let plain = folder.path().join("plain");
        fs::write(&plain, b"").unwrap();
        let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode();
        assert_eq!(mode(&path), mode(&plain), "same rights as any new file");
    }

    #[test]
    fn write_atomic_that_fails_leaves_the_target_and_no_litter() {
        let folder = tempfile::tempdir().unwrap();
        // The rename fails because the target is a folder that is not empty.
        let path = folder.path().join("target");
        fs::create_dir(&path).unwrap();
        fs::write(path.join("old"), b"old").unwrap();
        let error = write_atomic(&path, b"new").unwrap_err();
        assert!(error.to_string().contains(&path.display().to_string()), "{error}");
        assert_eq!(fs::read(path.join("old")).unwrap(), b"old");
        assert_eq!(names(folder.path()), ["target"]);
    }

    #[test]
    fn write_atomic_leaves_links_and_pipes_what_they_are() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        fs::write(&file, b"old").unwrap();
        std::os::unix::fs::symlink("file", &link).unwrap();
        write_atomic(&link, b"new").unwrap();
        assert!(link.is_symlink());
        assert_eq!(fs::read(&file).unwrap(), b"new");
        let (mut reader, writer) = io::pipe().unwrap();
        let path =
            PathBuf::from(format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&writer)));
        check_writable(&path).unwrap();
        write_atomic(&path, b"through").unwrap();
        drop(writer);
        let mut text = String::new();
        io::Read::read_to_string(&mut reader, &mut text).unwrap();
        assert_eq!(text, "through");
        assert!(
            check_writable(folder.path()).is_err()
                && check_writable(&folder.path().join("no/file")).is_err()
        );
        assert_eq!(names(folder.path()).len(), 2, "checking leaves nothing");
    }

    #[test]
    fn a_missing_folder_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("no/such/file");
        for error in [write_atomic(&path, b"x").unwrap_err(), JsonLines::create(&path).unwrap_err()]
        {
            assert!(error.to_string().contains("no/such/file"), "{error}");
            let source = std::error::Error::source(&error).unwrap().to_string();
            assert_eq!(source, "No such file or directory (os error 2)");
            assert!(
                matches!(error, Error::Io { source, .. } if source.kind() == io::ErrorKind::NotFound)
            );
        }
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_full_disk_is_reported() {
        let mut appender =
            Appender::open(Path::new("/dev/full"), &mut OpenOptions::new(), None).unwrap();
        let error = appender.append(b"record").unwrap_err();
        assert_eq!(error.to_string(), "cannot append to `/dev/full`");
        assert!(
            matches!(error, Error::Io { source, .. } if source.kind() == io::ErrorKind::StorageFull)
        );
        assert_eq!(appender.len, 0);
    }
}
