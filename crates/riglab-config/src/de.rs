//! Trees to types, with every fault at its place.
//!
//! Structs are asked which fields they know before they are filled, so unknown keys are found here
//! and not by serde; they are collected while reading goes on. Any other fault ends the reading.

use std::cell::RefCell;
use std::fmt;

use serde::de::value::StrDeserializer;
use serde::de::{
    self, DeserializeSeed, Deserializer, EnumAccess, Expected, IntoDeserializer, MapAccess, SeqAccess, Unexpected,
    VariantAccess, Visitor,
};

use crate::nearest::{listed, suggestion};
use crate::tree::{Entry, Node, Table, Value, counted};
use crate::{ConfigError, Fault, FaultKind, Origin, key};

/// Reads a type from the node at `path`.
pub(crate) fn from_node<'a, T: de::Deserialize<'a>>(node: &'a Node, path: &str) -> Result<T, ConfigError> {
    let unknown = RefCell::default();
    let reader = Reader { node, path: path.to_owned(), unknown: &unknown };
    let result = T::deserialize(reader.clone()).map_err(|e| reader.place(e));
    let mut faults = unknown.into_inner();
    match result {
        Ok(value) if faults.is_empty() => Ok(value),
        Ok(_) => Err(ConfigError::new(faults)),
        Err(error) => {
            faults.push(*error.0);
            Err(ConfigError::new(faults))
        }
    }
}

/// A fault; without origin until it passes the reader of the value it is about.
#[derive(Debug)]
struct Error(Box<Fault>);

impl Error {
    fn bare(kind: FaultKind, message: String) -> Self {
        Self(Box::new(Fault::new(kind, message, None)))
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl std::error::Error for Error {}

impl From<Fault> for Error {
    fn from(fault: Fault) -> Self {
        Self(Box::new(fault))
    }
}

/// What visitors say. The messages end up behind the path of the value.
impl de::Error for Error {
    fn custom<T: fmt::Display>(message: T) -> Self {
        Self::bare(FaultKind::Invalid, message.to_string())
    }

    fn invalid_type(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::bare(FaultKind::WrongType, format!("should be {expected}, but is {found}"))
    }

    fn invalid_value(found: Unexpected<'_>, expected: &dyn Expected) -> Self {
        Self::bare(FaultKind::OutOfRange, format!("should be {expected}, but is {found}"))
    }

    fn invalid_length(len: usize, expected: &dyn Expected) -> Self {
        Self::bare(FaultKind::OutOfRange, format!("should be {expected}, but has {}", counted(len, "value")))
    }

    fn unknown_variant(variant: &str, expected: &'static [&'static str]) -> Self {
        let mut error = Self::bare(FaultKind::UnknownVariant, format!("`{variant}` is no choice"));
        error.0.hint = suggestion(variant, expected, "choices");
        error
    }

    fn missing_field(field: &'static str) -> Self {
        Self::bare(FaultKind::MissingKey, key::quoted(field))
    }
}

/// A value to be read: the deserialiser.
#[derive(Clone)]
struct Reader<'a, 'u> {
    node: &'a Node,
    path: String,
    /// Collects unknown keys.
    unknown: &'u RefCell<Vec<Fault>>,
}

impl<'a, 'u> Reader<'a, 'u> {
    /// Gives an error without a place this value's path and place.
    fn place(&self, mut error: Error) -> Error {
        let fault = &mut error.0;
        if fault.origin.is_some() {
            return error;
        }
        fault.origin = Some(self.node.origin.clone());
        fault.message = match (fault.kind, self.path.as_str()) {
            (FaultKind::MissingKey, path) => format!("`{}` is missing", join_quoted(path, &fault.message)),
            (_, "") => std::mem::take(&mut fault.message),
            (FaultKind::WrongType | FaultKind::OutOfRange, path) => format!("`{path}` {}", fault.message),
            (_, path) => format!("`{path}`: {}", fault.message),
        };
        error
    }

    fn wrong(&self, expected: impl fmt::Display) -> Error {
        let found = self.node.value.described();
        self.place(Error::bare(FaultKind::WrongType, format!("should be {expected}, but is {found}")))
    }

    fn child(&self, path: String, node: &'a Node) -> Self {
        Self { node, path, unknown: self.unknown }
    }

    /// A whole number within what the asking type holds.
    fn integer(&self, min: i128, max: i128) -> Result<i128, Error> {
        // What the least is, is for the key to say: of many 0 is none either.
        let any = min <= i128::from(i64::MIN) || max >= i128::from(u64::MAX);
        let expected = if any { "a whole number".to_owned() } else { format!("a whole number from {min} to {max}") };
        let out = |wanted: &str, n| {
            Err(self.place(Error::bare(FaultKind::OutOfRange, format!("should {wanted}, but is {n}"))))
        };
        match self.node.value {
            Value::Integer(n) if (min..=max).contains(&n) => Ok(n),
            Value::Integer(n) if any && n < 0 => out("not be negative", n),
            Value::Integer(n) if any => out(&format!("be a whole number of at most {max}"), n),
            Value::Integer(n) => out(&format!("be {expected}"), n),
            _ => Err(self.wrong(expected)),
        }
    }

    fn float(&self) -> Result<f64, Error> {
        match self.node.value {
            Value::Float(x) => Ok(x),
            Value::Integer(n) => Ok(n as f64),
            _ => Err(self.wrong("a number")),
        }
    }

    fn table(&self) -> Result<&'a Table, Error> {
        match &self.node.value {
            Value::Table(table) => Ok(table),
            _ => Err(self.wrong("a table")),
        }
    }

    fn visit_table<V: Visitor<'a>>(self, fields: Option<&[&str]>, visitor: V) -> Result<V::Value, Error> {
        let table = self.table()?;
        let known = |key: &str| fields.is_none_or(|fields| fields.contains(&key));
        if let Some(fields) = fields {
            self.unknown.borrow_mut().extend(table.unknown_keys(&self.path, fields));
        }
        let entries: Vec<_> = table.entries.iter().filter(|(key, _)| known(key)).collect();
        let access = Entries { reader: &self, entries: entries.into_iter(), value: None };
        visitor.visit_map(access).map_err(|e| self.place(e))
    }

    /// What to do where one value stands for an array of any length: whether brackets around it would do, or what each
    /// value should be, is found by reading it as one of them.
    fn hint_of_array<V: Visitor<'a>>(&self, visitor: V) -> String {
        let unknown = self.unknown.borrow().len();
        let read = visitor.visit_seq(Items { reader: self, nodes: std::slice::from_ref(self.node).iter().enumerate() });
        self.unknown.borrow_mut().truncate(unknown);
        let Err(error) = read else {
            return match &self.node.value {
                Value::String(text) => format!("put it in brackets: [{text:?}]"),
                Value::Table(_) => "put it in brackets".into(),
                value => format!("put it in brackets: [{}]", value.described()),
            };
        };
        let wanted = error.0.message.split_once(" should be ").and_then(|(_, rest)| rest.rsplit_once(", but is "));
        wanted.map_or_else(String::new, |(wanted, _)| format!("each of its values should be {wanted}"))
    }

    fn visit_array<V: Visitor<'a>>(self, len: Option<usize>, visitor: V) -> Result<V::Value, Error> {
        let expected = len.map_or("an array".to_owned(), |n| format!("an array of {}", counted(n, "value")));
        let Value::Array(nodes) = &self.node.value else {
            let mut error = self.wrong(expected);
            if len.is_none() {
                error.0.hint = self.hint_of_array(visitor);
            }
            return Err(error);
        };
        if len.is_some_and(|n| n != nodes.len()) {
            let message = format!("should be {expected}, but has {}", nodes.len());
            return Err(self.place(Error::bare(FaultKind::OutOfRange, message)));
        }
        visitor.visit_seq(Items { reader: &self, nodes: nodes.iter().enumerate() }).map_err(|e| self.place(e))
    }
}

fn join_quoted(path: &str, key: &str) -> String {
    if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") }
}

macro_rules! integers {
    ($de:lifetime: $($method:ident $visit:ident $int:ident),*) => {$(
        fn $method<V: Visitor<$de>>(self, visitor: V) -> Result<V::Value, Error> {
            let n = self.integer($int::MIN as i128, i128::try_from($int::MAX).unwrap_or(i128::MAX))?;
            visitor.$visit(n as $int).map_err(|e| self.place(e))
        }
    )*};
}

impl<'a> Deserializer<'a> for Reader<'a, '_> {
    type Error = Error;

    integers!(
        'a: deserialize_i8 visit_i8 i8, deserialize_i16 visit_i16 i16, deserialize_i32 visit_i32 i32,
        deserialize_i64 visit_i64 i64, deserialize_i128 visit_i128 i128, deserialize_u8 visit_u8 u8,
        deserialize_u16 visit_u16 u16, deserialize_u32 visit_u32 u32, deserialize_u64 visit_u64 u64,
        deserialize_u128 visit_u128 u128
    );

    /// For types that take what comes: maps of mixed values, and enums without outer tag.
    fn deserialize_any<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        let result = match &self.node.value {
            Value::String(s) => visitor.visit_borrowed_str(s),
            Value::Boolean(b) => visitor.visit_bool(*b),
            Value::Float(x) => visitor.visit_f64(*x),
            Value::Integer(n) => match i64::try_from(*n) {
                Ok(n) => visitor.visit_i64(n),
                Err(_) => visitor.visit_u64(*n as u64), // checked when parsed
            },
            Value::Array(_) => return self.visit_array(None, visitor),
            Value::Table(_) => return self.visit_table(None, visitor),
        };
        result.map_err(|e| self.place(e))
    }

    fn deserialize_bool<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        match self.node.value {
            Value::Boolean(b) => visitor.visit_bool(b).map_err(|e| self.place(e)),
            _ => Err(self.wrong("`true` or `false`")),
        }
    }

    fn deserialize_f32<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        let x = self.float()?;
        if x.is_finite() && (x as f32).is_infinite() {
            let message = format!("should be a number of at most {:e}, but is {x:e}", f32::MAX);
            return Err(self.place(Error::bare(FaultKind::OutOfRange, message)));
        }
        visitor.visit_f32(x as f32).map_err(|e| self.place(e))
    }

    fn deserialize_f64<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_f64(self.float()?).map_err(|e| self.place(e))
    }

    fn deserialize_char<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_str(visitor)
    }

    fn deserialize_str<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        match &self.node.value {
            Value::String(s) => visitor.visit_borrowed_str(s).map_err(|e| self.place(e)),
            _ => Err(self.wrong("a string")),
        }
    }

    fn deserialize_string<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_str(visitor)
    }

    fn deserialize_bytes<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_str(visitor)
    }

    fn deserialize_byte_buf<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_str(visitor)
    }

    fn deserialize_option<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_some(self)
    }

    fn deserialize_unit<V: Visitor<'a>>(self, _: V) -> Result<V::Value, Error> {
        Err(self.wrong("left out"))
    }

    fn deserialize_unit_struct<V: Visitor<'a>>(self, _: &'static str, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_unit(visitor)
    }

    fn deserialize_newtype_struct<V: Visitor<'a>>(self, _: &'static str, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        self.visit_array(None, visitor)
    }

    fn deserialize_tuple<V: Visitor<'a>>(self, len: usize, visitor: V) -> Result<V::Value, Error> {
        self.visit_array(Some(len), visitor)
    }

    fn deserialize_tuple_struct<V: Visitor<'a>>(
        self,
        _: &'static str,
        len: usize,
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.visit_array(Some(len), visitor)
    }

    fn deserialize_map<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        self.visit_table(None, visitor)
    }

    fn deserialize_struct<V: Visitor<'a>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        self.visit_table(Some(fields), visitor)
    }

    /// `key = "choice"`, or `[key.choice]` for choices with settings of their own.
    fn deserialize_enum<V: Visitor<'a>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let (name, origin, content) = match &self.node.value {
            Value::String(name) => (name, &self.node.origin, None),
            Value::Table(table) => match table.entries.iter().collect::<Vec<_>>().as_slice() {
                [(name, entry)] => (*name, &entry.key, Some(&entry.node)),
                [] => return Err(self.wrong(format!("one of {}", listed(variants)))),
                [(a, _), .., (b, entry)] => {
                    let message = format!("`{}` should be one choice, but has `{a}` and `{b}`", self.path);
                    let hint = format!("`extends = []` in `{}` drops what lower layers chose", self.path);
                    return Err(Fault::at(FaultKind::UnknownVariant, &entry.key, message).hint(hint).into());
                }
            },
            _ => return Err(self.wrong(format!("one of {}", listed(variants)))),
        };
        if !variants.contains(&name.as_str()) {
            let message = format!("`{name}` is no choice for `{}`", self.path);
            let fault = Fault::at(FaultKind::UnknownVariant, origin, message);
            return Err(fault.hint(suggestion(name, variants, "choices")).into());
        }
        let content = content.map(|node| self.child(key::join(&self.path, name), node));
        visitor.visit_enum(Choice { reader: &self, name, content }).map_err(|e| self.place(e))
    }

    fn deserialize_identifier<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        self.deserialize_str(visitor)
    }

    fn deserialize_ignored_any<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_unit()
    }
}

/// The entries of a table.
struct Entries<'r, 'a, 'u> {
    reader: &'r Reader<'a, 'u>,
    entries: std::vec::IntoIter<(&'a String, &'a Entry)>,
    value: Option<(&'a String, &'a Entry)>,
}

impl<'a> MapAccess<'a> for Entries<'_, 'a, '_> {
    type Error = Error;

    fn next_key_seed<K: DeserializeSeed<'a>>(&mut self, seed: K) -> Result<Option<K::Value>, Error> {
        self.value = self.entries.next();
        let Some((name, entry)) = self.value else { return Ok(None) };
        let reader = Key { name, origin: &entry.key, path: &self.reader.path };
        seed.deserialize(reader).map(Some)
    }

    fn next_value_seed<S: DeserializeSeed<'a>>(&mut self, seed: S) -> Result<S::Value, Error> {
        let (name, entry) = self.value.take().expect("serde asks for a key first");
        let reader = self.reader.child(key::join(&self.reader.path, name), &entry.node);
        // Faults that a type finds after reading (`try_from`) have no place yet.
        seed.deserialize(reader.clone()).map_err(|e| reader.place(e))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.entries.len())
    }
}

/// The values of an array.
struct Items<'r, 'a, 'u> {
    reader: &'r Reader<'a, 'u>,
    nodes: std::iter::Enumerate<std::slice::Iter<'a, Node>>,
}

impl<'a> SeqAccess<'a> for Items<'_, 'a, '_> {
    type Error = Error;

    fn next_element_seed<S: DeserializeSeed<'a>>(&mut self, seed: S) -> Result<Option<S::Value>, Error> {
        let Some((at, node)) = self.nodes.next() else { return Ok(None) };
        let reader = self.reader.child(format!("{}[{at}]", self.reader.path), node);
        seed.deserialize(reader.clone()).map(Some).map_err(|e| reader.place(e))
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.nodes.len())
    }
}

/// A key of a map: a string, the name of a choice, or a type made from a string.
struct Key<'a, 'p> {
    name: &'a str,
    origin: &'a Origin,
    path: &'p str,
}

impl Key<'_, '_> {
    fn place(&self, mut error: Error) -> Error {
        if error.0.origin.is_none() {
            error.0.origin = Some(self.origin.clone());
            error.0.message = format!("key `{}`: {}", key::join(self.path, self.name), error.0.message);
        }
        error
    }
}

impl<'a> Deserializer<'a> for Key<'a, '_> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'a>>(self, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_borrowed_str(self.name).map_err(|e| self.place(e))
    }

    fn deserialize_enum<V: Visitor<'a>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, Error> {
        let name: StrDeserializer<'_, Error> = self.name.into_deserializer();
        visitor.visit_enum(name).map_err(|e| self.place(e))
    }

    fn deserialize_newtype_struct<V: Visitor<'a>>(self, _: &'static str, visitor: V) -> Result<V::Value, Error> {
        visitor.visit_newtype_struct(self)
    }

    serde::forward_to_deserialize_any! {
        <W: Visitor<'a>>
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option
        unit unit_struct seq tuple tuple_struct map struct identifier ignored_any
    }
}

/// A choice by name, with its settings if it was written as a table.
struct Choice<'r, 'a, 'u> {
    reader: &'r Reader<'a, 'u>,
    name: &'a str,
    content: Option<Reader<'a, 'u>>,
}

impl<'a, 'u> Choice<'_, 'a, 'u> {
    fn settings(self) -> Result<Reader<'a, 'u>, Error> {
        let path = &self.reader.path;
        self.content.ok_or_else(|| {
            let message = format!("`{}` needs settings", self.name);
            let mut error = self.reader.place(Error::bare(FaultKind::Invalid, message));
            error.0.hint = format!("write them under `{}`", key::join(path, self.name));
            error
        })
    }
}

impl<'r, 'a, 'u> EnumAccess<'a> for Choice<'r, 'a, 'u> {
    type Error = Error;
    type Variant = Self;

    fn variant_seed<S: DeserializeSeed<'a>>(self, seed: S) -> Result<(S::Value, Self), Error> {
        let name: StrDeserializer<'_, Error> = self.name.into_deserializer();
        Ok((seed.deserialize(name)?, self))
    }
}

impl<'a> VariantAccess<'a> for Choice<'_, 'a, '_> {
    type Error = Error;

    fn unit_variant(self) -> Result<(), Error> {
        match self.content {
            None => Ok(()),
            Some(Reader { node: Node { value: Value::Table(t), .. }, .. }) if t.entries.is_empty() => Ok(()),
            Some(content) => Err(content.wrong("an empty table, the choice has no settings")),
        }
    }

    fn newtype_variant_seed<S: DeserializeSeed<'a>>(self, seed: S) -> Result<S::Value, Error> {
        let settings = self.settings()?;
        seed.deserialize(settings.clone()).map_err(|e| settings.place(e))
    }

    fn tuple_variant<V: Visitor<'a>>(self, len: usize, visitor: V) -> Result<V::Value, Error> {
        self.settings()?.visit_array(Some(len), visitor)
    }

    fn struct_variant<V: Visitor<'a>>(self, fields: &'static [&'static str], visitor: V) -> Result<V::Value, Error> {
        self.settings()?.visit_table(Some(fields), visitor)
    }
}
