//! Reading of XML files as text: compressed with gzip or not, in any encoding that the file
//! declares.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

use encoding_rs::{Encoding, UTF_8, UTF_16BE, UTF_16LE};
use flate2::read::MultiGzDecoder;

/// First bytes of a gzip file.
const GZIP: [u8; 2] = [0x1f, 0x8b];

/// Returns the text of an XML file; `None` if the file, uncompressed, is longer than `limit` bytes.
///
/// A file that begins as gzip files do is uncompressed, whatever its name. The encoding is that of
/// the byte order mark, else that of the XML declaration, else UTF-8.
///
/// # Errors
/// The operating system's error; a file that is not completely compressed; an encoding that is
/// unknown; the line and column of the first byte that the encoding does not allow.
pub(crate) fn read(path: &Path, limit: u64) -> io::Result<Option<String>> {
    let mut file = BufReader::new(File::open(path)?);
    let mut bytes = Vec::new();
    file.by_ref().take(GZIP.len() as u64).read_to_end(&mut bytes)?;
    if bytes == GZIP {
        let whole = io::Cursor::new(std::mem::take(&mut bytes)).chain(file);
        MultiGzDecoder::new(whole).take(limit + 1).read_to_end(&mut bytes)?;
    } else {
        file.take(limit + 1).read_to_end(&mut bytes)?;
    }
    if bytes.len() as u64 > limit { Ok(None) } else { decode(bytes).map(Some) }
}

/// Returns the text of the bytes of an XML file.
fn decode(mut bytes: Vec<u8>) -> io::Result<String> {
    let invalid = |message: String| io::Error::new(io::ErrorKind::InvalidData, message);
    let encoding = match Encoding::for_bom(&bytes) {
        Some((encoding, length)) => {
            bytes.drain(..length);
            encoding
        }
        // The first two characters of a document in UTF-16 without a byte order mark.
        None if bytes.starts_with(b"<\0?\0") => UTF_16LE,
        None if bytes.starts_with(b"\0<\0?") => UTF_16BE,
        None => match declared(&bytes) {
            None => UTF_8,
            Some(label) => Encoding::for_label(label.as_bytes())
                // A declaration that was read byte by byte is not in UTF-16.
                .filter(|encoding| encoding.is_ascii_compatible())
                .ok_or_else(|| {
                    invalid(format!("the file is not in the encoding `{label}` that it declares"))
                })?,
        },
    };
    if encoding == UTF_8 {
        return String::from_utf8(bytes).map_err(|error| {
            let valid = &error.as_bytes()[..error.utf8_error().valid_up_to()];
            let (line, column) = end_of(&String::from_utf8_lossy(valid));
            invalid(format!(
                "not UTF-8 at line {line}, column {column}; a file in another encoding names it in its first line: \
                 <?xml version=\"1.0\" encoding=\"ISO-8859-1\"?>"
            ))
        });
    }
    let mut text = String::with_capacity(
        encoding
            .new_decoder_without_bom_handling()
            .max_utf8_buffer_length(bytes.len())
            .unwrap_or(0),
    );
    let mut decoder = encoding.new_decoder_without_bom_handling();
    let (result, _) = decoder.decode_to_string_without_replacement(&bytes, &mut text, true);
    if result != encoding_rs::DecoderResult::InputEmpty {
        let (line, column) = end_of(&text);
        let name = encoding.name();
        return Err(invalid(format!("not {name} at line {line}, column {column}")));
    }
    Ok(text)
}

/// Returns the encoding that the XML declaration names.
fn declared(bytes: &[u8]) -> Option<String> {
    let start = String::from_utf8_lossy(&bytes[..bytes.len().min(256)]);
    let declaration = start.strip_prefix("<?xml")?.split_once("?>")?.0;
    let value = declaration.split_once("encoding")?.1.trim_start().strip_prefix('=')?.trim_start();
    let quote = value.chars().next().filter(|c| matches!(c, '"' | '\''))?;
    Some(value[1..].split_once(quote)?.0.trim().to_owned())
}

/// Returns the line and column, from 1, at which a text ends.
fn end_of(text: &str) -> (usize, usize) {
    let line = text.rsplit('\n').next().unwrap_or_default();
    (text.matches('\n').count() + 1, line.chars().count() + 1)
}

#[cfg(test)]
mod tests {
    use std::io::Write as _;

    use super::*;

    const TEXT: &str = "<?xml version=\"1.0\" encoding=\"NAME\"?>\n<net id=\"Straße ü\"/>\n";

    fn of(bytes: &[u8]) -> io::Result<Option<String>> {
        let file = tempfile::NamedTempFile::new().unwrap();
        file.as_file().write_all(bytes).unwrap();
        read(file.path(), 4096)
    }

    #[test]
    fn files_are_read_in_the_encoding_that_they_declare() {
        let latin = |text: &str| text.chars().map(|c| c as u8).collect::<Vec<_>>();
        let units = |text: &str| text.encode_utf16().collect::<Vec<_>>();
        for name in ["ISO-8859-1", "windows-1252", "utf-8", "UTF-16"] {
            let text = TEXT.replace("NAME", name);
            let files = match name {
                "utf-8" => vec![text.clone().into_bytes(), format!("\u{feff}{text}").into_bytes()],
                "UTF-16" => {
                    let marked = units(&format!("\u{feff}{text}"));
                    [units(&text), marked]
                        .iter()
                        .flat_map(|units| {
                            [
                                units.iter().flat_map(|u| u.to_le_bytes()).collect(),
                                units.iter().flat_map(|u| u.to_be_bytes()).collect::<Vec<u8>>(),
                            ]
                        })
                        .collect()
                }
                _ => vec![latin(&text)],
            };
            for bytes in files {
                assert_eq!(of(&bytes).unwrap().as_deref(), Some(text.as_str()), "{name}");
                let mut packed =
                    flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
                packed.write_all(&bytes).unwrap();
                let packed = packed.finish().unwrap();
                assert_eq!(of(&packed).unwrap().as_deref(), Some(text.as_str()), "{name}.gz");
                assert!(of(&packed[..packed.len() - 9]).is_err(), "{name}.gz is cut");
            }
        }
        let long = of(&[b' '; 4097]).unwrap();
        assert_eq!(long, None);
    }

    #[test]
    fn bytes_that_the_encoding_does_not_allow_have_their_place() {
        let message = |bytes: &[u8]| of(bytes).unwrap_err().to_string();
        let latin: Vec<u8> = "<a>\n  ü".chars().map(|c| c as u8).collect();
        assert!(
            message(&latin).starts_with("not UTF-8 at line 2, column 3"),
            "{}",
            message(&latin)
        );
        let found = message(TEXT.replace("NAME", "klingon").as_bytes());
        assert!(found.contains("`klingon`"), "{found}");
        let found = message(TEXT.replace("NAME", "utf-16").as_bytes());
        assert!(found.contains("`utf-16`"), "{found}");
        let found = message(b"\xff\xfe<\0\0\xdc");
        assert!(found.starts_with("not UTF-16LE at line 1, column 2"), "{found}");
    }
}
