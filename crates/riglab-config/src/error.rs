//! What can be wrong with a configuration.

use std::fmt;

use crate::Origin;

/// What kind of thing is wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum FaultKind {
    /// A file cannot be read.
    Unreadable,
    /// A file is not TOML, or uses what configs leave out.
    Syntax,
    /// `extends` is not a path, or names a file that is nowhere.
    BadExtends,
    /// `extends` comes back to a file it started from.
    Cycle,
    /// A `--set` argument that cannot be understood or applied.
    BadSet,
    /// A key that nothing reads.
    UnknownKey,
    /// A required key that nothing sets.
    MissingKey,
    /// A value of another type.
    WrongType,
    /// A number or array outside what its type holds.
    OutOfRange,
    /// A choice that does not exist.
    UnknownVariant,
    /// Refused by whoever knows what the key means.
    Invalid,
}

/// One thing that is wrong, and where.
#[derive(Clone, Debug)]
pub struct Fault {
    /// What kind of thing.
    pub kind: FaultKind,
    /// One sentence, without full stop.
    pub message: String,
    /// What to do; empty when the message says it.
    pub hint: String,
    /// Where it was written; `None` when nothing was.
    pub origin: Option<Origin>,
}

impl Fault {
    pub(crate) fn new(kind: FaultKind, message: impl Into<String>, origin: Option<Origin>) -> Self {
        Self { kind, message: message.into(), hint: String::new(), origin }
    }

    pub(crate) fn at(kind: FaultKind, origin: &Origin, message: impl Into<String>) -> Self {
        Self::new(kind, message, Some(origin.clone()))
    }

    pub(crate) fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = hint.into();
        self
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(origin) = &self.origin {
            write!(f, "{origin}: ")?;
        }
        f.write_str(&self.message)?;
        if let Some(snippet) = self.origin.as_ref().and_then(Origin::snippet) {
            write!(f, "\n{snippet}")?;
        }
        if !self.hint.is_empty() {
            write!(f, "\n\nhint: {}", self.hint)?;
        }
        Ok(())
    }
}

/// One or more faults. Displays each as place, sentence, the line with carets, and a hint.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{}", display(faults))]
pub struct ConfigError {
    faults: Vec<Fault>,
}

fn display(faults: &[Fault]) -> String {
    faults.iter().map(Fault::to_string).collect::<Vec<_>>().join("\n\n")
}

impl ConfigError {
    pub(crate) fn new(faults: Vec<Fault>) -> Self {
        debug_assert!(!faults.is_empty());
        Self { faults }
    }

    /// What is wrong; at least one.
    pub fn faults(&self) -> &[Fault] {
        &self.faults
    }

    /// The same with a hint on the last fault.
    #[must_use]
    pub fn with_hint(mut self, hint: impl Into<String>) -> Self {
        if let Some(last) = self.faults.last_mut() {
            last.hint = hint.into();
        }
        self
    }

    /// Both errors' faults: for reporting all that a validation found.
    #[must_use]
    pub fn and(mut self, other: Self) -> Self {
        self.faults.extend(other.faults);
        self
    }
}

impl From<Fault> for ConfigError {
    fn from(fault: Fault) -> Self {
        Self { faults: vec![fault] }
    }
}
