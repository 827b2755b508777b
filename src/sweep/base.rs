//! Sweep files with a base: `base = "other.toml"`.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;
use toml::{Table, Value};

use super::Error;
use crate::config::flatten;
use crate::record;

/// Reads the text of a file.
pub(super) fn read(path: &Path) -> Result<String, Error> {
    Ok(std::fs::read_to_string(path).map_err(record::Error::io("read", path))?)
}

/// Parses `text`, with the values of its base for everything that `text` does not set. The path of
/// the base is relative to the folder of `file`.
pub(super) fn resolve<T: DeserializeOwned>(text: &str, file: &Path) -> Result<T, Error> {
    let whole = with_base::<T>(text, file, &mut Vec::new())?;
    whole.try_into().map_err(|e: toml::de::Error| Error::Content {
        file: format!("{} with its base", file.display()),
        message: e.message().to_owned(),
    })
}

fn parse<T: DeserializeOwned>(text: &str, file: &Path) -> Result<T, Error> {
    toml::from_str(text).map_err(|e| Error::Content {
        file: file.display().to_string(),
        message: e.to_string().trim_end().to_owned(),
    })
}

fn with_base<T: DeserializeOwned>(
    text: &str,
    file: &Path,
    before: &mut Vec<PathBuf>,
) -> Result<Table, Error> {
    // Each file is parsed alone first: its errors have line numbers, which are lost once the files
    // are merged.
    let _: T = parse(text, file)?;
    let mut own: Table = parse(text, file)?;
    let Some(Value::String(base)) = own.remove("base") else { return Ok(own) };
    let path = file.parent().unwrap_or(Path::new("")).join(base);
    let text = read(&path)?;
    let real = path.canonicalize().map_err(record::Error::io("read", &path))?;
    if before.contains(&real) {
        let message = format!("base forms a cycle: `{}` is based on itself", path.display());
        return Err(Error::Content { file: file.display().to_string(), message });
    }
    before.push(real);
    let mut whole = with_base::<T>(&text, &path, before)?;
    // A setting may be written in a table or as a key with dots.
    for table in [&mut whole, &mut own] {
        if let Some(Value::Table(settings)) = table.get_mut("settings") {
            *settings = flatten(settings).into_iter().collect();
        }
    }
    merge(&mut whole, own);
    Ok(whole)
}

/// Merges tables at any depth; any other value of `from`, lists included, replaces the value in
/// `to`.
fn merge(to: &mut Table, from: Table) {
    for (key, value) in from {
        match (to.get_mut(&key), value) {
            (Some(Value::Table(there)), Value::Table(value)) => merge(there, value),
            (_, value) => _ = to.insert(key, value),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::file::File;
    use super::*;

    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in files {
            std::fs::write(folder.path().join(name), text).unwrap();
        }
        folder
    }

    fn resolved(folder: &tempfile::TempDir, name: &str) -> Result<Table, Error> {
        let path = folder.path().join(name);
        resolve(&read(&path).unwrap(), &path)
    }

    #[test]
    fn a_file_says_what_differs_from_its_base() {
        let folder = folder(&[
            (
                "first.toml",
                "title = 'a'\n[settings]\nsteps = 1\n\"ppo.gamma\" = 0.9\nppo.gae_lambda = 0.2\n[grid]\nseed = [0, 1]",
            ),
            (
                "second.toml",
                "base = 'first.toml'\n[settings.ppo]\ngamma = 0.8\n[grid]\nagents = [4]",
            ),
            (
                "third.toml",
                "base = 'second.toml'\ntitle = 'c'\n[grid]\nseed = [2]\n[[skip]]\nwhen = {}",
            ),
        ]);
        let expected: Table =
            "title = 'c'\nsettings = { steps = 1, 'ppo.gamma' = 0.8, 'ppo.gae_lambda' = 0.2 }\ngrid = { seed = [2], agents = [4] }\nskip = [{ when = {} }]"
                .parse()
                .unwrap();
        assert_eq!(resolved(&folder, "third.toml").unwrap(), expected);
        let keys: Vec<_> = resolved(&folder, "third.toml").unwrap()["grid"]
            .as_table()
            .unwrap()
            .keys()
            .cloned()
            .collect();
        assert_eq!(keys, ["seed", "agents"], "the grid keeps the base's order");
    }

    #[test]
    fn a_base_that_is_none_is_refused() {
        let folder = folder(&[
            ("lost.toml", "base = 'nowhere.toml'"),
            ("number.toml", "base = 3"),
            ("round.toml", "base = 'about.toml'"),
            ("about.toml", "base = 'round.toml'"),
            ("broken.toml", "base = 'garbled.toml'"),
            ("garbled.toml", "title ="),
            ("unknown.toml", "base = 'sound.toml'\ntitle = 'd'\nsettingz = {}"),
            ("below.toml", "base = 'field.toml'"),
            ("field.toml", "title = 'e'\n\n[[rule]]\nwhen = {}\nsett = {}"),
            ("sound.toml", "title = 'f'"),
        ]);
        let refused = |name: &str| {
            let path = folder.path().join(name);
            resolve::<File>(&read(&path).unwrap(), &path).expect_err("must be refused").to_string()
        };
        assert!(refused("lost.toml").contains("nowhere.toml"));
        let number = refused("number.toml");
        assert!(
            number.contains("line 1") && number.contains("base = 3") && number.contains("a string"),
            "{number}"
        );
        assert!(refused("round.toml").contains("base forms a cycle"));
        let broken = refused("broken.toml");
        assert!(broken.contains("garbled.toml: ") && broken.contains("line 1"), "{broken}");
        let unknown = refused("unknown.toml");
        assert!(
            unknown.contains("unknown.toml: ")
                && unknown.contains("line 3")
                && unknown.contains("settingz"),
            "{unknown}"
        );
        let below = refused("below.toml");
        assert!(
            below.contains("field.toml: ") && below.contains("line 5") && below.contains("sett"),
            "{below}"
        );
    }
}
