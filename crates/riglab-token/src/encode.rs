//! Skeletons to sequences.

use riglab_core::Skeleton;

use crate::order::{Order, parts_first, walk};
use crate::template::{Part, Template, usual_parents};
use crate::{Classes, EncodeFault, Quantiser, Spring, TokenizerConfig, Vocabulary, cells};

/// Joints as arrays: what files and tests have.
#[derive(Clone, Copy, Debug)]
pub struct Bones<'a> {
    /// Positions, in the quantiser's range.
    pub joints: &'a [[f64; 3]],
    /// Parents; the root first, parents before children.
    pub parents: &'a [Option<usize>],
    /// Names.
    pub names: &'a [String],
}

/// A skeleton's sequence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Encoded {
    /// The tokens, from `bos` to `eos`.
    pub ids: Vec<u32>,
    /// At each place of the sequence, the joint as given.
    pub order: Vec<usize>,
    /// Joints outside the range, written at its border.
    pub clamped: usize,
    /// Joints that moved to a free cell so that the tree comes back.
    pub moved: usize,
}

/// Turns skeletons into tokens and back.
#[derive(Clone, Debug, PartialEq)]
pub struct Tokenizer {
    pub(crate) config: TokenizerConfig,
    pub(crate) vocabulary: Vocabulary,
    pub(crate) quantiser: Quantiser,
}

impl Tokenizer {
    /// By a configuration.
    pub fn new(config: TokenizerConfig) -> Self {
        let [low, high] = config.range;
        let quantiser = Quantiser { bins: config.bins, low, high, rule: config.rule };
        Self { vocabulary: Vocabulary::new(&config), quantiser, config }
    }

    /// Its configuration.
    pub fn config(&self) -> &TokenizerConfig {
        &self.config
    }

    /// Its ids.
    pub fn vocabulary(&self) -> &Vocabulary {
        &self.vocabulary
    }

    /// Its cells.
    pub fn quantiser(&self) -> Quantiser {
        self.quantiser
    }

    /// The sequence of a skeleton that stands in the quantiser's range.
    ///
    /// # Errors
    /// When joints are too close together to be told apart.
    pub fn encode(&self, skeleton: &Skeleton, class: Option<&str>) -> Result<Encoded, EncodeFault> {
        let joints: Vec<_> = skeleton.heads().iter().map(|p| p.map(f64::from)).collect();
        let parents: Vec<_> = skeleton.parents().iter().map(|p| p.map(riglab_core::JointId::index)).collect();
        self.encode_bones(&Bones { joints: &joints, parents: &parents, names: skeleton.names() }, class)
    }

    /// As [`Self::encode`], of arrays.
    ///
    /// # Errors
    /// So, and when the arrays are no tree, or in released configurations where names are not unique.
    pub fn encode_bones(&self, bones: &Bones<'_>, class: Option<&str>) -> Result<Encoded, EncodeFault> {
        let count = bones.joints.len();
        if count == 0 {
            return Err(EncodeFault::Empty);
        }
        let (parents, names) = (bones.parents.len(), bones.names.len());
        if parents != count || names != count && names != 0 {
            return Err(EncodeFault::Lengths { joints: count, parents, names });
        }
        if let Some(joint) =
            (0..count).find(|&j| bones.parents[j].is_some_and(|p| p >= j) || bones.parents[j].is_none() != (j == 0))
        {
            return Err(EncodeFault::NotATree { joint });
        }
        let by_parts = self.config.class == Classes::ByParts;
        let class = match class {
            None if by_parts => Template::detect(bones.names).map(|t| t.class),
            class => class,
        };
        let order = self.order(bones, class)?;
        let class = class.filter(|c| !by_parts || Template::of(c).is_none() || !order.parts.is_empty());
        let mut place = vec![0; count];
        order.joints.iter().enumerate().for_each(|(at, &joint)| place[joint] = at);
        let parents: Vec<Option<usize>> = order.joints.iter().map(|&j| bones.parents[j].map(|p| place[p])).collect();
        let point = |&j: &usize| bones.joints[j].map(|x| self.quantiser.cell(x));
        let mut of: Vec<[u16; 3]> = order.joints.iter().map(point).collect();
        let usual = usual_parents(&self.known(&order, class), count);
        let branches: Vec<Option<usize>> =
            parents.iter().zip(&usual).map(|(own, usual)| own.filter(|_| own != usual)).collect();
        let moved = if self.config.distinct { cells::tell_apart(&mut of, &branches, self.config.bins)? } else { 0 };
        let outside = |p: &&[f64; 3]| p.iter().any(|x| !self.quantiser.holds(*x as f32));
        let named = class.filter(|_| !bones.names.is_empty());
        let ids = self.sequence(&order, &of, &branches, class, named.is_some());
        Ok(Encoded { ids, order: order.joints, clamped: bones.joints.iter().filter(outside).count(), moved })
    }

    fn order(&self, bones: &Bones<'_>, class: Option<&str>) -> Result<Order, EncodeFault> {
        let joints = walk(bones, self.config.siblings);
        let parts: Vec<_> = match class.and_then(Template::of) {
            // The released order step knows every template, also where the class has no token: names are lost then.
            Some(template)
                if self.config.templates
                    && (self.config.lenient || self.vocabulary.class_named(template.class).is_some()) =>
            {
                self.vocabulary.parts_of(template.class)
            }
            _ => Vec::new(),
        };
        if parts.is_empty() {
            return Ok(Order { joints, ..Order::default() });
        }
        match parts_first(bones, joints, &parts) {
            // A skeleton of another make that has the names: written as any other.
            Err(_) if self.config.class == Classes::ByParts => {
                Ok(Order { joints: walk(bones, self.config.siblings), ..Order::default() })
            }
            order => order,
        }
    }

    /// The parts whose joints need no parents, by the place of their first joint.
    fn known(&self, order: &Order, class: Option<&str>) -> Vec<(usize, &'static Part)> {
        // Who reads the sequence knows of them by the class' token only.
        let class = class.filter(|own| self.config.known_parents && self.vocabulary.class_named(own).is_some());
        let part = |&(first, number): &(usize, usize)| Some((first, self.vocabulary.part_named(class, number)?));
        order.parts.iter().filter_map(part).collect()
    }

    fn sequence(
        &self,
        order: &Order,
        of: &[[u16; 3]],
        branches: &[Option<usize>],
        class: Option<&str>,
        named: bool,
    ) -> Vec<u32> {
        let ids = &self.vocabulary;
        let known = class.and_then(|c| ids.class_named(c));
        let mut out = Vec::with_capacity(7 * of.len() + 6);
        out.extend([ids.bos(), known.map_or(ids.no_class(), |c| ids.class(c))]);
        let spring = match self.config.spring {
            Spring::Never => false,
            Spring::AfterParts => !order.parts.is_empty(),
            Spring::WithClass => !order.parts.is_empty() || named,
            Spring::Always => true,
        };
        let mut parts = order.parts.iter().peekable();
        for (at, cell) in of.iter().enumerate() {
            if let Some((_, part)) = parts.next_if(|(first, _)| *first == at) {
                out.push(ids.part(*part));
            } else if at == order.others && spring {
                out.push(ids.spring());
            }
            if let Some(parent) = branches[at] {
                out.push(ids.branch());
                out.extend(of[parent].map(u32::from));
            }
            out.extend(cell.map(u32::from));
        }
        out.push(ids.eos());
        out
    }
}

/// Tokens of the plain format that UniRig compares with: of each joint its own and its parent's
/// coordinates, with a start, a class and an end.
pub fn naive_length(joints: usize) -> usize {
    6 * joints + 3
}
