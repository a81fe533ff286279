//! TOML text to trees that know their places.

use std::ops::Range;
use std::sync::Arc;

use toml::Spanned;
use toml::de::{DeInteger, DeTable, DeValue};

use crate::origin::Source;
use crate::tree::{Entry, Node, Table, Value};
use crate::{ConfigError, Fault, FaultKind, Origin};

/// Parses a whole text.
pub(crate) fn document(source: &Arc<Source>) -> Result<Table, ConfigError> {
    let parsed = DeTable::parse(&source.text).map_err(|error| {
        // The position of a fault at the end of a text may be the empty span there.
        let span = error.span().unwrap_or(0..0);
        let origin = if span == (0..0) { 0..1 } else { span };
        Fault::at(FaultKind::Syntax, &Origin::new(source, origin), format!("not TOML: {}", error.message()))
    })?;
    Reader { source, shift: 0 }.table(parsed.into_inner())
}

/// Parses the value that stands in the source's text at `at`; `None` if it is not TOML, or a date or time, which no key is:
/// as an argument that is a word, such as a time limit of `12:00:00`.
pub(crate) fn value(source: &Arc<Source>, at: Range<usize>) -> Option<Result<Node, ConfigError>> {
    let parsed = DeValue::parse(&source.text[at.clone()]).ok()?;
    if matches!(parsed.get_ref(), DeValue::Datetime(_)) {
        return None;
    }
    Some(Reader { source, shift: at.start }.node(parsed))
}

struct Reader<'a> {
    source: &'a Arc<Source>,
    /// Where in the source the parsed text starts.
    shift: usize,
}

impl Reader<'_> {
    fn origin(&self, span: Range<usize>) -> Origin {
        Origin::new(self.source, span.start + self.shift..span.end + self.shift)
    }

    fn table(&self, table: DeTable<'_>) -> Result<Table, ConfigError> {
        let mut out = Table::default();
        for (key, value) in table {
            let entry = Entry { key: self.origin(key.span()), node: self.node(value)? };
            out.entries.insert(key.into_inner().into_owned(), entry);
        }
        Ok(out)
    }

    fn node(&self, node: Spanned<DeValue<'_>>) -> Result<Node, ConfigError> {
        let origin = self.origin(node.span());
        let refuse = |message: &str| Fault::at(FaultKind::Syntax, &origin, message);
        let value = match node.into_inner() {
            DeValue::String(s) => Value::String(s.into_owned()),
            DeValue::Boolean(b) => Value::Boolean(b),
            DeValue::Integer(i) => {
                Value::Integer(integer(&i).ok_or_else(|| refuse("this integer does not fit into 64 bits"))?)
            }
            DeValue::Float(f) => {
                Value::Float(float(f.as_str()).ok_or_else(|| refuse("this number is too large for a 64-bit float"))?)
            }
            DeValue::Datetime(_) => {
                return Err(refuse("configs know no dates").hint("write it as a string, in quotes").into());
            }
            DeValue::Array(a) => Value::Array(a.into_iter().map(|node| self.node(node)).collect::<Result<_, _>>()?),
            DeValue::Table(t) => Value::Table(self.table(t)?),
        };
        Ok(Node { value, origin })
    }
}

fn integer(parsed: &DeInteger<'_>) -> Option<i128> {
    let value = i128::from_str_radix(parsed.as_str(), parsed.radix()).ok()?;
    (i128::from(i64::MIN)..=i128::from(u64::MAX)).contains(&value).then_some(value)
}

fn float(text: &str) -> Option<f64> {
    let value: f64 = text.parse().ok()?;
    match value {
        v if v.is_nan() => Some(f64::NAN), // one NaN, whatever its sign was
        v if v.is_infinite() && !text.contains("inf") => None,
        v => Some(v),
    }
}
