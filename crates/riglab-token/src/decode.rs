//! Sequences to skeletons.

use std::sync::LazyLock;

use riglab_core::{Joint, JointId, RigError, Skeleton};

use crate::encode::Tokenizer;
use crate::tails::tails;
use crate::template::usual_parents;
use crate::vocabulary::Meaning;
use crate::{DecodeFault, Merge};

/// What a sequence says.
#[derive(Clone, Debug, PartialEq)]
pub struct Decoded {
    /// Positions, J × 3.
    pub joints: Vec<[f32; 3]>,
    /// Parents, the root first.
    pub parents: Vec<Option<usize>>,
    /// Names: those of the template's parts, and `bone_<number>`.
    pub names: Vec<String>,
    /// The class, if one was named.
    pub class: Option<String>,
    /// Parts and springs (`None`) in their order.
    pub parts: Vec<Option<String>>,
}

impl Decoded {
    /// Where bones end, J × 3, by the rule of UniRig's release: it takes z for up.
    pub fn tails(&self) -> Vec<[f32; 3]> {
        tails(&self.joints, &self.parents)
    }

    /// As a skeleton.
    ///
    /// # Errors
    /// When there are more joints than a skeleton holds.
    pub fn skeleton(&self) -> Result<Skeleton, RigError> {
        let parent = |p: Option<usize>| p.map(|p| JointId(u16::try_from(p).unwrap_or(u16::MAX)));
        let all = self.joints.iter().zip(&self.parents).zip(&self.names);
        Skeleton::new(all.map(|((&head, &p), name)| Joint { name: name.clone(), parent: parent(p), head }).collect())
    }
}

/// The name of a joint of no part. Those of usual skeletons are made once: to format them anew would be a third of
/// decoding.
fn numbered(joint: usize) -> String {
    static USUAL: LazyLock<Vec<String>> = LazyLock::new(|| (0..256).map(|k| format!("bone_{k}")).collect());
    USUAL.get(joint).cloned().unwrap_or_else(|| format!("bone_{joint}"))
}

/// A joint as it stands in a sequence.
struct Found {
    head: [f32; 3],
    parent: [f32; 3],
    /// Whether the parent was written.
    branch: bool,
}

impl Tokenizer {
    /// The skeleton of a sequence. `pad` tokens at the end are passed over.
    ///
    /// # Errors
    /// What is wrong with the sequence, and where.
    pub fn decode(&self, ids: &[u32]) -> Result<Decoded, DecodeFault> {
        let vocabulary = &self.vocabulary;
        let end = ids.iter().rposition(|&id| id != vocabulary.pad()).map_or(0, |at| at + 1);
        let ids = &ids[..end];
        if ids.first() != Some(&vocabulary.bos()) {
            return Err(DecodeFault::NoBos);
        }
        if ids.len() < 2 || ids.last() != Some(&vocabulary.eos()) {
            return Err(DecodeFault::NoEos);
        }
        let last = ids.len() - 1;
        let (mut found, mut parts, mut class) = (Vec::<Found>::new(), Vec::new(), None);
        let (mut previous, mut branch) = (None, false);
        let mut at = 1;
        while at < last {
            match vocabulary.meaning(ids[at]) {
                Meaning::Cell(_) => {
                    let width = if branch { 6 } else { 3 };
                    if at + width > last {
                        return Err(DecodeFault::Cut(found.len()));
                    }
                    let head = self.point(ids, at + width - 3)?;
                    let parent = if branch { self.point(ids, at)? } else { previous.unwrap_or(head) };
                    found.push(Found { head, parent, branch });
                    (previous, branch) = (Some(head), false);
                    at += width;
                    continue;
                }
                Meaning::Branch if !branch => (previous, branch) = (None, true),
                Meaning::Spring => parts.push(None),
                Meaning::Part(part) => parts.push(Some(part)),
                // Anywhere, and the last wins, where the released decoders are followed.
                Meaning::Class(which) if at == 1 || self.config.lenient => class = Some(which),
                Meaning::NoClass if at == 1 || self.config.lenient => class = None,
                Meaning::Branch if self.config.lenient => previous = None,
                _ => return Err(vocabulary.unexpected(at, ids[at], "a coordinate, a part or a branch")),
            }
            at += 1;
        }
        if branch && !self.config.lenient {
            return Err(DecodeFault::Cut(found.len()));
        }
        if found.len() < self.config.least_joints.max(1) {
            return Err(DecodeFault::TooFew(found.len()));
        }
        let class = class.map(|c| vocabulary.classes()[c].clone());
        let names = self.names(class.as_deref(), &parts, found.len())?;
        let usual = if self.config.known_parents { self.usual(class.as_deref(), &parts, found.len()) } else { vec![] };
        let parents = self.parents(&found, &usual)?;
        let named =
            |part: Option<usize>| part.map(|p| vocabulary.word(vocabulary.part(p)).trim_matches(['<', '>']).to_owned());
        let joints = found.into_iter().map(|f| f.head).collect();
        Ok(Decoded { joints, parents, names, class, parts: parts.into_iter().map(named).collect() })
    }

    /// The point of three ids. The released decoders read any id as a coordinate here.
    fn point(&self, ids: &[u32], at: usize) -> Result<[f32; 3], DecodeFault> {
        let point: &[u32; 3] = ids[at..at + 3].try_into().expect("three of them");
        // Cells are the first ids.
        if !self.config.lenient
            && let Some(k) = point.iter().position(|id| *id >= self.vocabulary.branch())
        {
            return Err(self.vocabulary.unexpected(at + k, point[k], "a coordinate"));
        }
        Ok(point.map(|id| self.quantiser.coordinate(id)))
    }

    fn names(&self, class: Option<&str>, parts: &[Option<usize>], count: usize) -> Result<Vec<String>, DecodeFault> {
        let mut names: Vec<String> = Vec::with_capacity(count);
        if self.config.templates {
            for part in parts.iter().flatten().filter_map(|p| self.vocabulary.part_named(class, *p)) {
                let (wanted, left) = (part.joints.len(), count - names.len());
                if left < wanted {
                    return Err(DecodeFault::ShortPart { part: part.name.into(), wanted, left });
                }
                names.extend(part.joints.iter().map(|name| (*name).to_owned()));
            }
        }
        names.extend((names.len()..count).map(numbered));
        Ok(names)
    }

    /// The parents of joints that are written without one, as [`Self::names`] has the parts: one after another.
    fn usual(&self, class: Option<&str>, parts: &[Option<usize>], count: usize) -> Vec<Option<usize>> {
        let mut start = 0;
        let named = parts.iter().flatten().filter_map(|p| self.vocabulary.part_named(class, *p));
        let placed: Vec<_> = named
            .map(|part| {
                start += part.joints.len();
                (start - part.joints.len(), part)
            })
            .collect();
        usual_parents(&placed, count)
    }

    /// Each joint's parent: the nearest joint before it to where its parent should be, the latest of
    /// equally near ones. `usual` has those of joints without a parent, where they are told.
    fn parents(&self, found: &[Found], usual: &[Option<usize>]) -> Result<Vec<Option<usize>>, DecodeFault> {
        let mut parents = vec![None];
        for (joint, Found { parent, branch, .. }) in found.iter().enumerate().skip(1) {
            if let Some(known) = usual.get(joint).filter(|_| !branch) {
                parents.push(*known);
                continue;
            }
            // Mostly one stands there.
            if let Some(there) = found[..joint].iter().rposition(|f| f.head == *parent) {
                parents.push(Some(there));
                continue;
            }
            let (mut best, mut least) = (joint - 1, f32::INFINITY);
            for earlier in (0..joint).rev() {
                let head = found[earlier].head;
                let distance = (0..3).map(|k| (head[k] - parent[k]).powi(2)).sum::<f32>();
                if distance < least {
                    (best, least) = (earlier, distance);
                }
            }
            match self.config.merge {
                Merge::Within(reach) if least > reach * reach => return Err(DecodeFault::NoParent(joint)),
                _ => parents.push(Some(best)),
            }
        }
        Ok(parents)
    }
}

#[cfg(test)]
mod tests {
    use super::numbered;

    #[test]
    fn names_go_on_behind_those_that_are_made_once() {
        assert_eq!([0, 255, 256, 1000].map(numbered), ["bone_0", "bone_255", "bone_256", "bone_1000"]);
    }
}
