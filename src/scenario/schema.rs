//! The schema of scenario files, read from `scenarios/scenario.xsd`. Reading, writing, the reference
//! page and the comments in new scenario files follow from it: a new attribute is a declaration in
//! the schema and a field in `model.rs`.

use std::sync::LazyLock;

use roxmltree::{Document, Node};

use crate::sumo::net::{did_you_mean, nearest};

/// The schema, which is written beside new scenarios.
pub const SCHEMA: &str = include_str!("../../scenarios/scenario.xsd");

/// Largest magnitude of a number in a scenario, which keeps sums and products finite.
pub(super) const MAX_NUMBER: f64 = 1e9;

/// An element of a scenario file.
#[derive(Debug, Clone, PartialEq)]
pub struct Element {
    /// Name.
    pub name: String,
    /// Purpose.
    pub text: String,
    /// Smallest number of occurrences in its parent: 0 or 1.
    pub least: usize,
    /// Largest number of occurrences in its parent; `None`: unlimited.
    pub most: Option<usize>,
    /// Whether the element contains text instead of elements.
    pub is_text: bool,
    /// Attributes.
    pub attributes: Vec<Attribute>,
    /// Child elements.
    pub children: Vec<Element>,
}

/// An attribute of an element.
#[derive(Debug, Clone, PartialEq)]
pub struct Attribute {
    /// Name.
    pub name: String,
    /// Effect.
    pub text: String,
    /// Unit, if it has one.
    pub unit: Option<String>,
    /// Allowed values.
    pub kind: Kind,
    /// Whether it is required.
    pub required: bool,
    /// Default, if the schema declares one.
    pub default: Option<String>,
}

/// Kind of value that an attribute accepts.
#[derive(Debug, Clone, PartialEq)]
pub enum Kind {
    /// Text of at least `least` characters.
    Text {
        /// Smallest number of characters.
        least: usize,
    },
    /// Text of a form that the reader checks in addition to the schema; the form in words.
    Pattern(String),
    /// A number.
    Number {
        /// Whether the number is a whole number of at least 0.
        whole: bool,
        /// Smallest value.
        least: Option<f64>,
        /// Value that the number must exceed.
        above: Option<f64>,
        /// Largest value.
        most: Option<f64>,
    },
    /// One of some words.
    Choice(Vec<String>),
    /// Several values separated by spaces.
    List {
        /// Kind of each value.
        item: Box<Kind>,
        /// Largest number of values; `None`: unlimited. There is at least one.
        most: Option<usize>,
    },
}

impl Element {
    /// Returns the element and all elements within it, each before its children.
    pub fn all(&self) -> Vec<&Element> {
        std::iter::once(self).chain(self.children.iter().flat_map(Element::all)).collect()
    }

    /// Returns the child element with this name.
    pub fn child(&self, name: &str) -> Option<&Element> {
        self.children.iter().find(|child| child.name == name)
    }

    /// Returns the attribute with this name.
    pub fn attribute(&self, name: &str) -> Option<&Attribute> {
        self.attributes.iter().find(|attribute| attribute.name == name)
    }
}

impl Kind {
    /// Returns whether the schema accepts a value.
    pub fn accepts(&self, value: &str) -> bool {
        match self {
            Self::Text { least } => value.chars().count() >= *least,
            Self::Pattern(_) => true,
            Self::Choice(words) => words.iter().any(|word| word == value),
            Self::List { item, most } => {
                let count = value.split_whitespace().count();
                // No id of SUMO contains a comma, which is a mistyped separator.
                let is_word = |value: &str| {
                    !matches!(**item, Self::Text { .. }) || !value.contains([',', ';'])
                };
                (1..=most.unwrap_or(usize::MAX)).contains(&count)
                    && value.split_whitespace().all(|value| item.accepts(value) && is_word(value))
            }
            Self::Number { whole, least, above, most } => {
                let value = value.trim();
                let number = if *whole {
                    value.parse::<u32>().ok().map(f64::from)
                } else {
                    value.parse::<f64>().ok()
                };
                number.is_some_and(|v| {
                    v.abs() <= MAX_NUMBER
                        && least.is_none_or(|least| v >= least)
                        && above.is_none_or(|above| v > above)
                        && most.is_none_or(|most| v <= most)
                })
            }
        }
    }

    /// Returns the allowed values in words, and the word that `value` was probably meant to be.
    pub(super) fn instead_of(&self, value: &str) -> String {
        let similar = match self {
            Self::Choice(words) => nearest(value, words.iter().map(String::as_str)),
            _ => None,
        };
        self.allowed() + &did_you_mean(similar)
    }

    /// Returns the allowed values in words.
    pub fn allowed(&self) -> String {
        match self {
            Self::Text { least: 0 } => "text".into(),
            Self::Text { .. } => "text that is not empty".into(),
            Self::Pattern(form) => form.clone(),
            Self::Choice(words) => {
                words.iter().map(|word| format!("`{word}`")).collect::<Vec<_>>().join(", ")
            }
            Self::List { item, most } => {
                let item = match &**item {
                    Self::Text { .. } => "words".into(),
                    item => format!("values (each: {})", item.allowed()),
                };
                let count = most.map_or("one or more".into(), |most| format!("1 to {most}"));
                format!("{count} {item}, separated by spaces")
            }
            Self::Number { whole, least, above, most } => {
                let base = if *whole { "whole number" } else { "number" };
                let least = least.or(whole.then_some(0.0)).filter(|v| *v > -MAX_NUMBER);
                match (least, above, most.filter(|v| *v < MAX_NUMBER)) {
                    (Some(least), _, Some(most)) => format!("{base} from {least} to {most}"),
                    (Some(least), _, None) => format!("{base} of at least {least}"),
                    (None, Some(above), Some(most)) => {
                        format!("{base} above {above}, up to {most}")
                    }
                    (None, Some(above), None) => format!("{base} above {above}"),
                    (None, None, _) => base.into(),
                }
            }
        }
    }
}

/// Returns the description of the element `<scenario>`.
pub fn describe() -> &'static Element {
    static ROOT: LazyLock<Element> = LazyLock::new(|| {
        let document = Document::parse(SCHEMA).expect("the schema is well-formed");
        let root = document.root_element();
        Schema { root }.element(child(root, "element").expect("the schema declares <scenario>"))
    });
    &ROOT
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
        let count = |key| node.attribute(key).map(str::parse::<usize>);
        Element {
            name: node.attribute("name").unwrap_or_default().into(),
            text: text.unwrap_or_default(),
            least: count("minOccurs").and_then(Result::ok).unwrap_or(1),
            most: count("maxOccurs").map_or(Some(1), Result::ok),
            is_text: complex.is_none(),
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
            kind: match node.attribute("type") {
                Some(name) => self.type_named(name),
                None => child(node, "simpleType")
                    .map_or(Kind::Text { least: 0 }, |simple| self.kind(simple)),
            },
            required: node.attribute("use") == Some("required"),
            default: node.attribute("default").map(Into::into),
        }
    }

    fn type_named(&self, name: &str) -> Kind {
        let number = |whole| Kind::Number { whole, least: None, above: None, most: None };
        match (self.named("simpleType", name), name) {
            (Some(simple), _) => self.kind(simple),
            (None, "xs:double") => number(false),
            (None, "xs:unsignedInt") => number(true),
            (None, _) => Kind::Text { least: 0 },
        }
    }

    fn named(&self, kind: &str, name: &str) -> Option<Node<'a, 'input>> {
        self.root
            .children()
            .find(|n| n.tag_name().name() == kind && n.attribute("name") == Some(name))
    }

    /// Returns the kind of value of a simple type.
    fn kind(&self, simple: Node<'a, 'input>) -> Kind {
        if let Some(list) = child(simple, "list") {
            let item = self.type_named(list.attribute("itemType").unwrap_or_default());
            return Kind::List { item: Box::new(item), most: None };
        }
        let Some(restriction) = child(simple, "restriction") else {
            return Kind::Text { least: 0 };
        };
        let facet = |name| child(restriction, name).and_then(|facet| facet.attribute("value"));
        let number = |name| facet(name).and_then(|value| value.parse::<f64>().ok());
        let base = match child(restriction, "simpleType") {
            Some(inner) => self.kind(inner),
            None => self.type_named(restriction.attribute("base").unwrap_or_default()),
        };
        match base {
            Kind::List { item, .. } => {
                Kind::List { item, most: number("maxLength").map(|most| most as usize) }
            }
            Kind::Number { whole, .. } => Kind::Number {
                whole,
                least: number("minInclusive"),
                above: number("minExclusive"),
                most: number("maxInclusive"),
            },
            base => {
                let words: Vec<String> = restriction
                    .children()
                    .filter(|n| n.tag_name().name() == "enumeration")
                    .filter_map(|n| n.attribute("value").map(Into::into))
                    .collect();
                match facet("pattern") {
                    Some(_) => Kind::Pattern(documentation(simple)),
                    None if words.is_empty() => number("minLength")
                        .map_or(base, |least| Kind::Text { least: least as usize }),
                    None => Kind::Choice(words),
                }
            }
        }
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
