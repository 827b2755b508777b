//! The reference page on scenario files, and the comments in new scenario files.

use std::fmt::Write as _;

use super::schema::{Attribute, Element, describe};

/// Returns a Markdown page about all elements and attributes.
pub fn markdown() -> String {
    let mut page = String::from(
        "# Scenario files\n\n\
         Made from `scenarios/scenario.xsd` by `iwol scenario reference`; edit the schema, not this page. `iwol scenario new` \
         writes a file with all but `<occlusion>` and `<traffic>`, `iwol scenario check` says what is wrong with one.\n\n\
         A run can override numbers, words and flags of all elements that occur once, except those of `<agents>`: \
         `--set scenario.observation.neighbours=2`, or `neighbours = 2` in a table `[scenario.observation]` of a settings file.\n\n\
         Lengths are in metres, times in seconds; positions on lanes are those of the vehicle's centre.\n",
    );
    for element in describe().all() {
        // Writing to a string cannot fail.
        let _ = element.write(&mut page);
    }
    page
}

/// Returns the explanation of a part of a scenario as lines of an XML comment, or `None` for an
/// unknown name.
pub(super) fn comment(name: &str) -> Option<String> {
    let mut lines = Vec::new();
    for (depth, element) in describe().child(name)?.all().into_iter().enumerate() {
        let name = if depth == 0 { String::new() } else { format!("<{}> ", element.name) };
        lines.push(format!("{name}{}", element.text));
        for attribute in &element.attributes {
            let unit = attribute.unit.as_ref().map_or(String::new(), |unit| format!(" [{unit}]"));
            let default = attribute.default.as_ref();
            let default = default.map_or(String::new(), |value| format!(" Default: {value}."));
            lines.push(format!("  {}{unit}: {}{default}", attribute.name, attribute.text));
        }
    }
    Some(lines.join("\n         "))
}

impl Element {
    fn write(&self, page: &mut String) -> std::fmt::Result {
        let occurs = match (self.least, self.most) {
            (0, Some(1)) => "once or not at all".into(),
            (0, Some(most)) => format!("up to {most} times"),
            (0, None) => "any number of times".into(),
            (_, None) => "once or more".into(),
            (_, Some(1)) => "once".into(),
            (least, Some(most)) => format!("{least} to {most} times"),
        };
        writeln!(page, "\n## `<{}>`\n\n{} Occurs {occurs}.", self.name, self.text)?;
        if !self.attributes.is_empty() {
            writeln!(
                page,
                "\n| attribute | unit | allowed | default | effect |\n|---|---|---|---|---|"
            )?;
        }
        for Attribute { name, text, unit, kind, required, default } in &self.attributes {
            let default = match default {
                Some(default) => format!("`{default}`"),
                None if *required => "required".to_owned(),
                None => "optional".to_owned(),
            };
            let (unit, allowed) = (unit.as_deref().unwrap_or(""), cell(&kind.allowed()));
            writeln!(page, "| `{name}` | {unit} | {allowed} | {default} | {} |", cell(text))?;
        }
        if !self.children.is_empty() {
            let children: Vec<String> =
                self.children.iter().map(|child| format!("`<{}>`", child.name)).collect();
            writeln!(page, "\nWithin it: {}.", children.join(", "))?;
        }
        Ok(())
    }
}

/// Escapes text for a cell of a Markdown table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|")
}
