//! Ids: coordinates, then structure, then spring and parts, then classes, as the released tokenizers
//! lay them out.

use crate::template::{Part, Template};
use crate::{DecodeFault, TokenizerConfig};

/// What an id means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// A cell.
    Cell(u16),
    /// A parent and a joint follow.
    Branch,
    /// The start.
    Bos,
    /// The end.
    Eos,
    /// Nothing.
    Pad,
    /// Joints of no part follow.
    Spring,
    /// A part follows, by its number in the vocabulary.
    Part(usize),
    /// No class.
    NoClass,
    /// A class, by its number.
    Class(usize),
    /// No id of this vocabulary.
    Beyond,
}

/// The ids of a configuration.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vocabulary {
    bins: u32,
    parts: Vec<String>,
    classes: Vec<String>,
    own_parts: bool,
}

impl Vocabulary {
    /// Of a configuration.
    pub fn new(config: &TokenizerConfig) -> Self {
        let parts = if config.own_parts {
            let of = |t: &Template| {
                let known = t.parts.iter().filter(|p| config.parts.iter().any(|n| n == p.name));
                known.map(|p| format!("{}:{}", t.class, p.name)).collect::<Vec<_>>()
            };
            Template::ALL.iter().flat_map(of).collect()
        } else {
            config.parts.clone()
        };
        Self { bins: u32::from(config.bins), parts, classes: config.classes.clone(), own_parts: config.own_parts }
    }

    /// How many ids there are.
    pub fn len(&self) -> usize {
        (self.bins + 6) as usize + self.parts.len() + self.classes.len()
    }

    /// There always are ids.
    pub fn is_empty(&self) -> bool {
        false
    }

    /// A parent and a joint follow.
    pub fn branch(&self) -> u32 {
        self.bins
    }

    /// The start.
    pub fn bos(&self) -> u32 {
        self.bins + 1
    }

    /// The end of the skeleton.
    pub fn eos(&self) -> u32 {
        self.bins + 2
    }

    /// Fills a batch.
    pub fn pad(&self) -> u32 {
        self.bins + 3
    }

    /// Joints of no part follow.
    pub fn spring(&self) -> u32 {
        self.bins + 4
    }

    /// A part, by its number.
    pub fn part(&self, part: usize) -> u32 {
        self.spring() + 1 + part as u32
    }

    /// No class.
    pub fn no_class(&self) -> u32 {
        self.part(self.parts.len())
    }

    /// A class, by its number.
    pub fn class(&self, class: usize) -> u32 {
        self.no_class() + 1 + class as u32
    }

    /// The classes, by number.
    pub fn classes(&self) -> &[String] {
        &self.classes
    }

    /// The number of a class.
    pub fn class_named(&self, name: &str) -> Option<usize> {
        self.classes.iter().position(|c| c == name)
    }

    /// The class that a person means by a name: the one of that name, else the only one whose name differs in case alone.
    pub fn class_meant(&self, told: &str) -> Option<&str> {
        let mut alike = self.classes.iter().filter(|class| class.eq_ignore_ascii_case(told));
        let only = alike.next().filter(|_| alike.next().is_none());
        self.classes.iter().find(|class| *class == told).or(only).map(String::as_str)
    }

    /// The parts of a class' template that have a token: number and part.
    pub fn parts_of(&self, class: &str) -> Vec<(usize, &'static Part)> {
        let Some(template) = Template::of(class) else { return Vec::new() };
        let number = |part: &Part| {
            let own = self.own_parts.then(|| format!("{class}:{}", part.name));
            self.parts.iter().position(|p| *p == own.as_deref().unwrap_or(part.name))
        };
        template.parts.iter().filter_map(|part| Some((number(part)?, part))).collect()
    }

    /// The part of that number under a class.
    pub fn part_named(&self, class: Option<&str>, number: usize) -> Option<&'static Part> {
        self.parts_of(class?).into_iter().find(|(n, _)| *n == number).map(|(_, part)| part)
    }

    /// What an id means.
    pub fn meaning(&self, id: u32) -> Meaning {
        if id < self.bins {
            return Meaning::Cell(id as u16);
        }
        match id - self.bins {
            0 => Meaning::Branch,
            1 => Meaning::Bos,
            2 => Meaning::Eos,
            3 => Meaning::Pad,
            4 => Meaning::Spring,
            _ if id < self.no_class() => Meaning::Part((id - self.part(0)) as usize),
            _ if id == self.no_class() => Meaning::NoClass,
            _ if (id as usize) < self.len() => Meaning::Class((id - self.class(0)) as usize),
            _ => Meaning::Beyond,
        }
    }

    /// An id in words: a cell as its number.
    pub fn word(&self, id: u32) -> String {
        match self.meaning(id) {
            Meaning::Cell(cell) => cell.to_string(),
            Meaning::Branch => "<branch>".into(),
            Meaning::Bos => "<bos>".into(),
            Meaning::Eos => "<eos>".into(),
            Meaning::Pad => "<pad>".into(),
            Meaning::Spring => "<spring>".into(),
            Meaning::Part(part) => format!("<{}>", self.parts[part]),
            Meaning::NoClass => "<no class>".into(),
            Meaning::Class(class) => format!("<{}>", self.classes[class]),
            Meaning::Beyond => format!("<{id}?>"),
        }
    }

    pub(crate) fn unexpected(&self, at: usize, id: u32, wanted: &'static str) -> DecodeFault {
        DecodeFault::Unexpected { at, word: self.word(id), wanted }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_class_is_meant_in_any_case_where_that_tells_it_from_others() {
        let classes = ["mixamo", "Dog", "dog"].map(String::from).to_vec();
        let ids = Vocabulary::new(&TokenizerConfig { classes, ..TokenizerConfig::default() });
        assert_eq!([ids.class_meant("Mixamo"), ids.class_meant("mixamo")], [Some("mixamo"); 2]);
        assert_eq!([ids.class_meant("Dog"), ids.class_meant("dog")], [Some("Dog"), Some("dog")]);
        assert_eq!([ids.class_meant("DOG"), ids.class_meant("cat")], [None, None], "it is not known which");
    }
}
