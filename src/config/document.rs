//! Settings as TOML text.

use std::path::Path;

use super::Error;

/// A TOML text and its name in messages.
#[derive(Debug, Clone, Default)]
pub struct Document {
    /// File name, or another description of the source.
    pub name: String,
    /// The text.
    pub text: String,
    /// Whether the program made the text, so that its lines mean nothing to the reader of a
    /// message.
    pub generated: bool,
}

impl Document {
    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::Read`].
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| Error::Read { path: path.to_owned(), source })?;
        Ok(Self { name: path.display().to_string(), text, generated: false })
    }

    /// Returns the configuration with which a run was made, from its text.
    pub fn of_run(name: String, text: String) -> Self {
        Self { name, text, generated: false }
    }

    /// Returns a document of settings that come from several sources, which `name` describes.
    pub fn of_table(name: String, settings: &toml::Table) -> Self {
        Self { name, text: settings.to_string(), generated: true }
    }

    /// Returns the place of a byte in words: file, line and column.
    pub(super) fn place(&self, offset: usize) -> String {
        let Self { name, text, generated } = self;
        if *generated {
            return name.clone();
        }
        let before = text.get(..offset).unwrap_or(text);
        let line = before.matches('\n').count() + 1;
        let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
        format!("{name}:{line}:{column}")
    }
}
