//! ONNX models: a graph of operations on tensors of single precision, in the file format of ONNX.
//! This module imports nothing of this crate.
//!
//! The format is a protocol buffer (<https://github.com/onnx/onnx/blob/main/onnx/onnx.proto>); only
//! the few messages and fields that such a graph needs are written.

/// Version of the file format, and of the set of operations.
const IR_VERSION: i64 = 8;
const OPSET: i64 = 17;
/// `TensorProto.DataType.FLOAT` and `INT64`.
const FLOAT: i64 = 1;
const INT64: i64 = 7;

/// A protocol buffer message under construction.
#[derive(Debug, Clone, Default)]
struct Message(Vec<u8>);

impl Message {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    /// Appends an integer field.
    fn int(mut self, field: u64, value: i64) -> Self {
        self.varint(field << 3);
        self.varint(value as u64);
        self
    }

    /// Appends a field of single precision.
    fn float(mut self, field: u64, value: f32) -> Self {
        self.varint(field << 3 | 5);
        self.0.extend(value.to_le_bytes());
        self
    }

    /// Appends a text, bytes, or another message.
    fn bytes(mut self, field: u64, bytes: &[u8]) -> Self {
        self.varint(field << 3 | 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
        self
    }

    fn text(self, field: u64, text: &str) -> Self {
        self.bytes(field, text.as_bytes())
    }

    fn message(self, field: u64, message: &Self) -> Self {
        self.bytes(field, &message.0)
    }
}

/// A value in a graph: an input, a constant, or the output of an operation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Value(String);

/// An attribute of an operation.
#[derive(Debug, Clone, Copy)]
pub enum Attribute<'a> {
    /// A number.
    Float(f32),
    /// An integer.
    Int(i64),
    /// Integers.
    Ints(&'a [i64]),
}

/// A dimension of an input or output.
#[derive(Debug, Clone, Copy)]
pub enum Dimension<'a> {
    /// A dimension of any size, with a name.
    Any(&'a str),
    /// A dimension of this size.
    Fixed(usize),
}

/// A graph under construction.
#[derive(Debug, Default)]
pub struct Graph {
    nodes: Vec<Message>,
    constants: Vec<Message>,
    inputs: Vec<Message>,
    outputs: Vec<Message>,
    names: usize,
}

impl Graph {
    fn name(&mut self) -> Value {
        self.names += 1;
        Value(format!("v{}", self.names))
    }

    /// Adds an input.
    pub fn input(&mut self, name: &str, shape: &[Dimension<'_>]) -> Value {
        self.inputs.push(described(name, shape));
        Value(name.to_owned())
    }

    /// Makes a value an output.
    pub fn output(&mut self, name: &str, value: &Value, shape: &[Dimension<'_>]) {
        let node = Message::default().text(1, &value.0).text(2, name).text(4, "Identity");
        self.nodes.push(node);
        self.outputs.push(described(name, shape));
    }

    /// Adds a constant of single precision.
    pub fn constant(&mut self, shape: &[i64], data: &[f32]) -> Value {
        let bytes: Vec<u8> = data.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(FLOAT, shape, &bytes)
    }

    /// Adds a constant vector of integers.
    pub fn integers(&mut self, data: &[i64]) -> Value {
        let bytes: Vec<u8> = data.iter().flat_map(|value| value.to_le_bytes()).collect();
        self.tensor(INT64, &[data.len() as i64], &bytes)
    }

    /// Adds a number.
    pub fn number(&mut self, value: f32) -> Value {
        self.constant(&[], &[value])
    }

    fn tensor(&mut self, kind: i64, shape: &[i64], bytes: &[u8]) -> Value {
        let name = self.name();
        let tensor = shape.iter().fold(Message::default(), |tensor, &size| tensor.int(1, size));
        self.constants.push(tensor.int(2, kind).text(8, &name.0).bytes(9, bytes));
        name
    }

    /// Adds an operation of ONNX with one output.
    pub fn apply(&mut self, operation: &str, inputs: &[&Value]) -> Value {
        self.apply_with(operation, inputs, &[])
    }

    /// Adds an operation of ONNX with attributes and one output.
    pub fn apply_with(
        &mut self,
        operation: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute<'_>)],
    ) -> Value {
        let [output] = self.apply_to(operation, inputs, attributes);
        output
    }

    /// Adds an operation of ONNX with several outputs.
    pub fn apply_to<const COUNT: usize>(
        &mut self,
        operation: &str,
        inputs: &[&Value],
        attributes: &[(&str, Attribute<'_>)],
    ) -> [Value; COUNT] {
        let outputs = [(); COUNT].map(|()| self.name());
        let node = inputs.iter().fold(Message::default(), |node, input| node.text(1, &input.0));
        let node = outputs.iter().fold(node, |node, output| node.text(2, &output.0));
        let node = node.text(4, operation);
        self.nodes.push(attributes.iter().fold(node, |node, (name, value)| {
            let attribute = Message::default().text(1, name);
            let attribute = match value {
                Attribute::Float(value) => attribute.float(2, *value).int(20, 1),
                Attribute::Int(value) => attribute.int(3, *value).int(20, 2),
                Attribute::Ints(values) => values
                    .iter()
                    .fold(attribute, |attribute, &value| attribute.int(8, value))
                    .int(20, 7),
            };
            node.message(5, &attribute)
        }));
        outputs
    }

    /// Returns the file, with pairs of names and texts as metadata.
    pub fn encode(&self, name: &str, metadata: &[(&str, String)]) -> Vec<u8> {
        let all = |message: Message, field: u64, parts: &[Message]| {
            parts.iter().fold(message, |message, part| message.message(field, part))
        };
        let graph = all(Message::default(), 1, &self.nodes).text(2, name);
        let graph = all(graph, 5, &self.constants);
        let graph = all(all(graph, 11, &self.inputs), 12, &self.outputs);
        let model = Message::default()
            .int(1, IR_VERSION)
            .text(2, "iwol-sumo")
            .text(3, env!("CARGO_PKG_VERSION"))
            .message(7, &graph)
            .message(8, &Message::default().text(1, "").int(2, OPSET));
        let entry = |(key, value): &(&str, String)| Message::default().text(1, key).text(2, value);
        metadata.iter().map(entry).fold(model, |model, entry| model.message(14, &entry)).0
    }
}

/// Returns the description of an input or output of single precision.
fn described(name: &str, shape: &[Dimension<'_>]) -> Message {
    let shape = shape.iter().fold(Message::default(), |shape, dimension| {
        let dimension = match dimension {
            Dimension::Any(name) => Message::default().text(2, name),
            Dimension::Fixed(size) => Message::default().int(1, *size as i64),
        };
        shape.message(1, &dimension)
    });
    let tensor = Message::default().int(1, FLOAT).message(2, &shape);
    Message::default().text(1, name).message(2, &Message::default().message(1, &tensor))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The encoding of protocol buffers, by the examples of its documentation.
    #[test]
    fn messages_are_protocol_buffers() {
        assert_eq!(Message::default().int(1, 150).0, [0x08, 0x96, 0x01]);
        assert_eq!(Message::default().text(2, "testing").0, b"\x12\x07testing");
        assert_eq!(Message::default().float(3, 1.0).0, [0x1d, 0, 0, 0x80, 0x3f]);
        // Negative integers take ten bytes.
        assert_eq!(Message::default().int(1, -1).0.len(), 11);
    }
}
