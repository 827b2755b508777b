//! A document of headings, paragraphs, tables and figures. It is written as Markdown, and as a
//! single self-contained HTML file.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use base64::Engine as _;

use super::Error;
use crate::markup::escape as escaped;
use crate::plot::Format;
use crate::record;

/// A document; see the module.
pub(super) struct Document {
    title: String,
    parts: Vec<Part>,
}

enum Part {
    Heading(u8, String),
    Text(String),
    Code(String),
    Table { header: Vec<String>, rows: Vec<Vec<String>> },
    Figure { file: PathBuf, text: String },
}

impl Document {
    pub(super) fn new(title: &str) -> Self {
        Self { title: title.to_owned(), parts: Vec::new() }
    }

    pub(super) fn heading(&mut self, level: u8, text: &str) {
        self.parts.push(Part::Heading(level, text.to_owned()));
    }

    pub(super) fn text(&mut self, text: impl Into<String>) {
        self.parts.push(Part::Text(text.into()));
    }

    pub(super) fn code(&mut self, text: impl Into<String>) {
        self.parts.push(Part::Code(text.into()));
    }

    pub(super) fn table(&mut self, header: Vec<String>, rows: Vec<Vec<String>>) {
        self.parts.push(Part::Table { header, rows });
    }

    pub(super) fn figure(&mut self, file: &Path, text: &str) {
        self.parts.push(Part::Figure { file: file.to_owned(), text: text.to_owned() });
    }

    pub(super) fn markdown(&self) -> String {
        let mut out = format!("# {}\n", self.title);
        for part in &self.parts {
            let _ = match part {
                Part::Heading(level, text) => {
                    writeln!(out, "\n{} {text}", "#".repeat(usize::from(*level)))
                }
                Part::Text(text) => writeln!(out, "\n{text}"),
                Part::Code(text) => writeln!(out, "\n```sh\n{text}\n```"),
                Part::Figure { file, text } => writeln!(out, "\n![{text}]({})", name(file)),
                Part::Table { header, rows } => {
                    let line = |cells: &[String]| {
                        format!(
                            "| {} |\n",
                            cells
                                .iter()
                                .map(|c| c.replace('|', "\\|"))
                                .collect::<Vec<_>>()
                                .join(" | ")
                        )
                    };
                    let _ = write!(
                        out,
                        "\n{}|---|{}\n",
                        line(header),
                        "--:|".repeat(header.len().saturating_sub(1))
                    );
                    for row in rows {
                        out.push_str(&line(row));
                    }
                    Ok(())
                }
            };
        }
        out
    }

    /// Returns the document as HTML with embedded figures.
    pub(super) fn html(&self) -> Result<String, Error> {
        let title = escaped(&self.title);
        let mut out = format!(
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title}</title>\n\
             <style>\n{STYLE}</style>\n<main>\n<h1>{title}</h1>\n"
        );
        for part in &self.parts {
            let _ = match part {
                Part::Heading(level, text) => {
                    writeln!(out, "<h{level}>{}</h{level}>", escaped(text))
                }
                Part::Text(text) => writeln!(out, "<p>{}</p>", escaped(text)),
                Part::Code(text) => writeln!(out, "<pre>{}</pre>", escaped(text)),
                Part::Figure { file, text } => {
                    let bytes = std::fs::read(file).map_err(record::Error::io("read", file))?;
                    let data = base64::engine::general_purpose::STANDARD.encode(bytes);
                    let text = escaped(text);
                    let kind = Format::of(file)?.media_type();
                    writeln!(
                        out,
                        "<figure><img src=\"data:{kind};base64,{data}\" alt=\"{text}\">\
                         <figcaption>{text}</figcaption></figure>"
                    )
                }
                Part::Table { header, rows } => {
                    let line = |cells: &[String], tag: &str| {
                        let cell = |c: &String| format!("<{tag}>{}</{tag}>", escaped(c));
                        let cells = cells.iter().map(cell).collect::<Vec<_>>().concat();
                        format!("<tr>{cells}</tr>\n")
                    };
                    let rows = rows.iter().map(|row| line(row, "td")).collect::<String>();
                    let header = line(header, "th");
                    writeln!(
                        out,
                        "<div class=\"wide\"><table>\n<thead>{header}</thead>\n<tbody>{rows}</tbody>\n</table></div>"
                    )
                }
            };
        }
        out.push_str("</main>\n</html>\n");
        Ok(out)
    }
}

const STYLE: &str = "\
:root { color-scheme: light dark; }
body { margin: 0; font: 16px/1.5 system-ui, sans-serif; }
main { max-width: 72rem; margin: 0 auto; padding: 1rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .75rem; text-align: right; white-space: nowrap; border-bottom: 1px solid #8886; }
th:first-child, td:first-child { text-align: left; }
figure { margin: 1rem 0; }
img { max-width: 100%; background: #fff; }
pre { overflow-x: auto; padding: .5rem .75rem; background: #8882; }
";

fn name(file: &Path) -> String {
    file.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn markup_in_text_stays_text() {
        let mut document = Document::new("a < b");
        document.table(vec!["x".into(), "y|z".into()], vec![vec!["<b>".into(), "1".into()]]);
        assert!(document.markdown().contains("| x | y\\|z |\n|---|--:|\n| <b> | 1 |"));
        let html = document.html().unwrap();
        assert!(
            html.contains("<title>a &lt; b</title>") && html.contains("<td>&lt;b&gt;</td>"),
            "{html}"
        );
    }
}
