//! Descriptions of all elements and attributes, read from `scenarios/scenario.xsd`. The
//! documentation page and the comments in new scenario files are generated from them, so that each
//! explanation stands in one place.

use std::fmt::Write as _;

use roxmltree::{Document, Node};

/// The schema, which is written beside new scenarios.
pub const SCHEMA: &str = include_str!("../../scenarios/scenario.xsd");

/// An element of a scenario file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Element {
    /// Name.
    pub name: String,
    /// Purpose.
    pub text: String,
    /// How often it occurs in its parent: `once`, `once or not at all`, `1 to 256 times`.
    pub occurs: String,
    /// Attributes.
    pub attributes: Vec<Attribute>,
    /// Child elements.
    pub children: Vec<Element>,
}

/// An attribute of an element.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Attribute {
    /// Name.
    pub name: String,
    /// Effect.
    pub text: String,
    /// Unit, if it has one.
    pub unit: Option<String>,
    /// Allowed values, in words.
    pub allowed: String,
    /// Whether it is required.
    pub required: bool,
    /// Default, if the schema declares one.
    pub default: Option<String>,
}

impl Element {
    /// Returns the element and all elements within it, each before its children.
    pub fn all(&self) -> Vec<&Element> {
        std::iter::once(self).chain(self.children.iter().flat_map(Element::all)).collect()
    }
}

/// Returns the description of the element `<scenario>`.
pub fn describe() -> Element {
    let document = Document::parse(SCHEMA).expect("the schema is well-formed");
    let root = document.root_element();
    Schema { root }.element(child(root, "element").expect("the schema declares <scenario>"))
}

/// Returns a Markdown page about all elements and attributes.
pub fn markdown() -> String {
    let mut page = String::from(
        "# Scenario files\n\n\
         Made from `scenarios/scenario.xsd` by `iwol scenario reference`; edit the schema, not this page. `iwol scenario new` \
         writes a file with all but `<traffic>`, `iwol scenario check` says what is wrong with one.\n\n\
         Lengths are in metres, times in seconds; positions on lanes are those of the vehicle's centre.\n",
    );
    for element in describe().all() {
        // Writing to a string cannot fail.
        let _ = element.write(&mut page);
    }
    page
}

/// Returns the explanation of an element and its contents as lines of an XML comment, or `None` for
/// an unknown name.
pub(super) fn comment(name: &str) -> Option<Vec<String>> {
    let scenario = describe();
    let element = scenario.all().into_iter().find(|element| element.name == name)?.clone();
    let mut lines = Vec::new();
    for (depth, element) in element.all().into_iter().enumerate() {
        if !element.text.is_empty() {
            let name = if depth == 0 { String::new() } else { format!("<{}> ", element.name) };
            lines.push(format!("{name}{}", element.text));
        }
        for attribute in &element.attributes {
            let unit = attribute.unit.as_ref().map_or(String::new(), |unit| format!(" [{unit}]"));
            lines.push(format!("  {}{unit}: {}", attribute.name, attribute.text));
        }
    }
    Some(lines)
}

impl Element {
    fn write(&self, page: &mut String) -> std::fmt::Result {
        writeln!(page, "\n## `<{}>`\n\n{} Occurs {}.", self.name, self.text, self.occurs)?;
        if !self.attributes.is_empty() {
            writeln!(
                page,
                "\n| attribute | unit | allowed | default | effect |\n|---|---|---|---|---|"
            )?;
        }
        for attribute in &self.attributes {
            let unit = attribute.unit.as_deref().unwrap_or("");
            let default = match &attribute.default {
                Some(default) => format!("`{default}`"),
                None if attribute.required => "required".to_owned(),
                None => "optional".to_owned(),
            };
            let (name, allowed, text) = (&attribute.name, &attribute.allowed, &attribute.text);
            writeln!(
                page,
                "| `{name}` | {unit} | {} | {default} | {} |",
                cell(allowed),
                cell(text)
            )?;
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

struct Schema<'a, 'input> {
    root: Node<'a, 'input>,
}

impl<'a, 'input> Schema<'a, 'input> {
    fn element(&self, node: Node<'a, 'input>) -> Element {
        let complex = match node.attribute("type") {
            Some(name) => self.named("complexType", name),
            None => child(node, "complexType"),
        };
        let below = |wanted: &'static str| {
            complex.into_iter().flat_map(move |complex| {
                let groups = complex
                    .children()
                    .filter(|n| matches!(n.tag_name().name(), "all" | "sequence"));
                let all = groups.flat_map(|group| group.children()).chain(complex.children());
                all.filter(move |n| n.tag_name().name() == wanted)
            })
        };
        let text = [Some(node), complex]
            .into_iter()
            .flatten()
            .map(documentation)
            .find(|text| !text.is_empty());
        Element {
            name: node.attribute("name").unwrap_or_default().into(),
            text: text.unwrap_or_default(),
            occurs: occurs(node),
            attributes: below("attribute").map(|attribute| self.attribute(attribute)).collect(),
            children: below("element").map(|element| self.element(element)).collect(),
        }
    }

    fn attribute(&self, node: Node<'a, 'input>) -> Attribute {
        let text = documentation(node);
        let bracket = text.find('[').and_then(|open| Some((open, open + text[open..].find(']')?)));
        let (unit, text) = match bracket {
            Some((open, close)) => {
                let rest = format!("{}{}", text[..open].trim_end(), &text[close + 1..]);
                (Some(text[open + 1..close].to_owned()), rest)
            }
            None => (None, text),
        };
        Attribute {
            name: node.attribute("name").unwrap_or_default().into(),
            text,
            unit,
            allowed: match node.attribute("type") {
                Some(name) => self.type_named(name),
                None => child(node, "simpleType")
                    .map_or_else(|| "text".into(), |simple| self.allowed(simple)),
            },
            required: node.attribute("use") == Some("required"),
            default: node.attribute("default").map(Into::into),
        }
    }

    fn type_named(&self, name: &str) -> String {
        match self.named("simpleType", name) {
            Some(simple) => self.allowed(simple),
            None => plain(name).into(),
        }
    }

    fn named(&self, kind: &str, name: &str) -> Option<Node<'a, 'input>> {
        self.root
            .children()
            .find(|n| n.tag_name().name() == kind && n.attribute("name") == Some(name))
    }

    /// Returns the values that a simple type allows, in words.
    fn allowed(&self, simple: Node<'a, 'input>) -> String {
        if let Some(list) = child(simple, "list") {
            return format!(
                "one or more, separated by spaces: {}",
                self.type_named(list.attribute("itemType").unwrap_or(""))
            );
        }
        let Some(restriction) = child(simple, "restriction") else { return "text".into() };
        if let Some(inner) = child(restriction, "simpleType") {
            return self.allowed(inner);
        }
        let facet = |name| child(restriction, name).and_then(|facet| facet.attribute("value"));
        let values: Vec<String> = restriction
            .children()
            .filter(|n| n.tag_name().name() == "enumeration")
            .filter_map(|n| Some(format!("`{}`", n.attribute("value")?)))
            .collect();
        if !values.is_empty() {
            return values.join(", ");
        }
        if let Some(pattern) = facet("pattern") {
            return format!("`{pattern}`");
        }
        let base = plain(restriction.attribute("base").unwrap_or(""));
        let bound =
            |value: Option<&'a str>| value.filter(|value| value.trim_start_matches('-') != "1e9");
        let least =
            bound(facet("minInclusive")).or(if base == "whole number" { Some("0") } else { None });
        match (least, bound(facet("minExclusive")), bound(facet("maxInclusive"))) {
            (Some(least), _, Some(most)) => format!("{base}, {least} to {most}"),
            (Some(least), ..) => format!("{base}, {least} or more"),
            (None, Some(above), _) => format!("{base} above {above}"),
            _ => base.into(),
        }
    }
}

/// Returns the plain name of a type that XML Schema defines.
fn plain(name: &str) -> &'static str {
    match name {
        "xs:double" => "number",
        "xs:unsignedInt" => "whole number",
        _ => "text",
    }
}

fn child<'a, 'input>(node: Node<'a, 'input>, name: &str) -> Option<Node<'a, 'input>> {
    node.children().find(|n| n.tag_name().name() == name)
}

fn documentation(node: Node) -> String {
    let text =
        child(node, "annotation").and_then(|n| child(n, "documentation")).and_then(|n| n.text());
    text.unwrap_or_default().trim().into()
}

fn occurs(node: Node) -> String {
    match (node.attribute("minOccurs"), node.attribute("maxOccurs")) {
        (Some("0"), _) => "once or not at all".into(),
        (_, Some("unbounded")) => "once or more".into(),
        (_, Some(most)) => format!("1 to {most} times"),
        _ => "once".into(),
    }
}
