//! Attributes of scenario files as fields of structs. `element!` declares a struct whose fields
//! are read from attributes and written as attributes of the same names in camel case;
//! the schema says what each attribute accepts.

use std::path::PathBuf;
use std::str::FromStr;

use super::Error;
use super::reader::Element;
use super::schema;
use crate::markup::Writer;

/// A value with a textual form.
pub(super) trait Value: Sized {
    /// Returns the value of a text that the schema accepts.
    fn parse(text: &str) -> Option<Self>;

    /// Returns the text, or `None` if the attribute is to be left out.
    fn text(&self) -> Option<String>;

    /// Returns the value of an optional attribute without a default that is missing.
    fn missing() -> Option<Self> {
        None
    }

    /// Returns the value of an item of a list, whose items are separated by spaces.
    fn item(text: &str) -> Option<Self> {
        Self::parse(text)
    }

    /// Returns the text as an item of a list.
    fn item_text(&self) -> Option<String> {
        self.text()
    }
}

/// A field of an element: an attribute, or several.
pub(super) trait Field: Sized {
    /// Reads the field called `name`.
    fn read(element: &Element, name: &str) -> Result<Self, Error>;

    /// Writes the field, except attributes that equal the default in the schema.
    fn write(&self, tag: &mut Tag, name: &str);

    /// Appends the names of the attributes.
    #[cfg(test)]
    fn names(name: &str, out: &mut Vec<String>) {
        out.push(name.to_owned());
    }
}

/// An element that is being written.
pub(super) struct Tag<'a> {
    xml: &'a mut Writer,
    schema: &'static schema::Element,
}

impl<'a> Tag<'a> {
    /// Returns the innermost open element of a document, which the schema describes.
    pub(super) fn new(xml: &'a mut Writer, schema: &'static schema::Element) -> Self {
        Self { xml, schema }
    }

    /// Writes an attribute, unless its value is the default.
    pub(super) fn attribute(&mut self, name: &str, value: &str) {
        let default = self.schema.attribute(name).and_then(|known| known.default.as_deref());
        if default != Some(value) {
            self.xml.attribute(name, value);
        }
    }

    /// Writes a child element with the attributes and elements that `content` writes.
    pub(super) fn element(&mut self, name: &str, content: impl FnOnce(&mut Tag)) {
        let Some(schema) = self.schema.child(name) else { return };
        self.xml.open(&schema.name);
        content(&mut Tag { xml: &mut *self.xml, schema });
        self.xml.close();
    }

    /// Writes a child element that consists of the attributes of `fields`.
    pub(super) fn fields(&mut self, name: &str, fields: &impl Field) {
        self.element(name, |tag| fields.write(tag, ""));
    }
}

impl<T: Value> Field for T {
    fn read(element: &Element, name: &str) -> Result<Self, Error> {
        match element.attribute(name) {
            Some(text) => T::parse(text).ok_or_else(|| element.refuse(name)),
            None => T::missing().ok_or_else(|| element.lacks("attribute", name)),
        }
    }

    fn write(&self, tag: &mut Tag, name: &str) {
        if let Some(text) = self.text() {
            tag.attribute(name, &text);
        }
    }
}

fn parse<T: FromStr>(text: &str) -> Option<T> {
    text.trim().parse().ok()
}

macro_rules! plain {
    ($($Type:ty),*) => {$(
        impl Value for $Type {
            fn parse(text: &str) -> Option<Self> {
                parse(text)
            }

            fn text(&self) -> Option<String> {
                Some(self.to_string())
            }
        }
    )*};
}
plain!(u32, usize, bool);

/// A missing number is infinite: it limits nothing.
impl Value for f64 {
    fn parse(text: &str) -> Option<Self> {
        parse(text)
    }

    fn text(&self) -> Option<String> {
        self.is_finite().then(|| self.to_string())
    }

    fn missing() -> Option<Self> {
        Some(Self::INFINITY)
    }
}

impl Value for String {
    fn parse(text: &str) -> Option<Self> {
        Some(text.into())
    }

    fn text(&self) -> Option<String> {
        Some(self.clone())
    }
}

impl Value for PathBuf {
    fn parse(text: &str) -> Option<Self> {
        Some(text.into())
    }

    fn text(&self) -> Option<String> {
        Some(self.to_string_lossy().into_owned())
    }

    fn item(text: &str) -> Option<Self> {
        let replace = |text: String, (of, code): &(char, &str)| text.replace(code, &of.to_string());
        Some(ESCAPED.iter().rev().fold(text.to_owned(), replace).into())
    }

    fn item_text(&self) -> Option<String> {
        let replace = |text: String, (of, code): &(char, &str)| text.replace(*of, code);
        Some(ESCAPED.iter().fold(self.to_string_lossy().into_owned(), replace))
    }
}

/// What a path in a list cannot contain, and how it is written, as in a URI. The percent sign comes
/// first, because the others contain it.
const ESCAPED: [(char, &str); 6] =
    [('%', "%25"), (' ', "%20"), ('\t', "%09"), ('\n', "%0A"), (',', "%2C"), (';', "%3B")];

/// A point of the braking curve, as `magnitude:deceleration`.
impl Value for (f64, f64) {
    fn parse(text: &str) -> Option<Self> {
        let (magnitude, deceleration) = text.split_once(':')?;
        Some((parse(magnitude)?, parse(deceleration)?))
    }

    fn text(&self) -> Option<String> {
        Some(format!("{}:{}", self.0, self.1))
    }
}

impl<T: Value> Value for Vec<T> {
    fn parse(text: &str) -> Option<Self> {
        text.split_whitespace().map(T::item).collect()
    }

    fn text(&self) -> Option<String> {
        let texts: Vec<String> = self.iter().filter_map(T::item_text).collect();
        (!texts.is_empty()).then(|| texts.join(" "))
    }

    fn missing() -> Option<Self> {
        Some(Vec::new())
    }
}

impl<T: Value> Value for Option<T> {
    fn parse(text: &str) -> Option<Self> {
        T::parse(text).map(Some)
    }

    fn text(&self) -> Option<String> {
        self.as_ref().and_then(T::text)
    }

    fn missing() -> Option<Self> {
        Some(None)
    }
}

/// Returns the name of the attribute for a field of a group: `max_speed` becomes `maxSpeed`, and the
/// field `beams` of the group `lidar` becomes `lidarBeams`.
pub(super) fn name(group: &str, field: &str) -> String {
    let mut name = group.to_owned();
    for word in field.split('_') {
        let (first, rest) = word.split_at(1.min(word.len()));
        name += &if name.is_empty() { first.to_owned() } else { first.to_uppercase() };
        name += rest;
    }
    name
}

/// Declares a struct whose fields are attributes. `field as "name": Type` names an attribute whose
/// name differs from the field's.
macro_rules! element {
    (
        $(#[$outer:meta])*
        pub struct $Struct:ident {
            $($(#[$inner:meta])* pub $field:ident $(as $name:literal)?: $Type:ty,)*
        }
    ) => {
        $(#[$outer])*
        pub struct $Struct {
            $($(#[$inner])* pub $field: $Type,)*
        }

        impl $crate::scenario::attribute::Field for $Struct {
            fn read(
                element: &$crate::scenario::reader::Element,
                group: &str,
            ) -> Result<Self, $crate::scenario::Error> {
                use $crate::scenario::attribute::{Field, name};
                Ok(Self {
                    $($field: Field::read(
                        element,
                        &name(group, [$($name,)? stringify!($field)][0]),
                    )?,)*
                })
            }

            fn write(&self, tag: &mut $crate::scenario::attribute::Tag, group: &str) {
                use $crate::scenario::attribute::{Field, name};
                $(Field::write(&self.$field, tag, &name(group, [$($name,)? stringify!($field)][0]));)*
            }

            #[cfg(test)]
            fn names(group: &str, out: &mut Vec<String>) {
                use $crate::scenario::attribute::{Field, name};
                $(<$Type as Field>::names(&name(group, [$($name,)? stringify!($field)][0]), out);)*
            }
        }
    };
}

/// Declares the words that stand for the values of an enum.
macro_rules! words {
    ($Enum:ident { $($Variant:ident: $word:literal),* }) => {
        impl $Enum {
            /// Names in XML and settings.
            pub const NAMES: [(&str, Self); [$($word),*].len()] =
                [$(($word, Self::$Variant)),*];

            /// Returns the name in XML and settings.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$Variant => $word,)*
                }
            }
        }

        impl $crate::scenario::attribute::Value for $Enum {
            fn parse(text: &str) -> Option<Self> {
                Self::NAMES.iter().find(|entry| entry.0 == text).map(|entry| entry.1)
            }

            fn text(&self) -> Option<String> {
                Some(self.name().into())
            }
        }
    };
}

pub(super) use {element, words};
