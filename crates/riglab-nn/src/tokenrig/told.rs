//! What a code is told of the joint that it belongs to.

use super::{Layout, TokenRigConfig};

/// Numbers that geometry says of a joint: where it and its parent are, and what of the surface lies near its bones: the
/// centre of that, the deviation from it by axis, its share of all area, and how surely any of it is theirs (0 to 1).
pub const GEOMETRY: usize = 14;

/// What a joint's codes are told.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointTold {
    /// See [`GEOMETRY`].
    pub geometry: [f32; GEOMETRY],
    /// Of the codes that a rule's weights have, the levels ([`Layout::levels_of`]), those of the first code first; empty
    /// where the rule gives the joint nothing, or is not told.
    pub rule: Vec<f32>,
}

/// Numbers that tell a rule's codes: the levels of so many, and 1 where there are any.
pub(super) fn rule(layout: &Layout, codes: usize) -> usize {
    codes * layout.levels().len() + 1
}

impl TokenRigConfig {
    /// Numbers that tell a place, with so many codes a bone.
    pub fn told(&self, layout: &Layout, codes: usize) -> usize {
        GEOMETRY + 1 + if self.tell_rule { rule(layout, codes) } else { 0 }
    }
}

impl JointTold {
    /// Writes what a place is told whose next token is the joint's code at `slot`: geometry's numbers, 1 + the slot, and,
    /// where there is room for them, the levels of the rule's codes and whether there are any.
    pub fn at(&self, slot: usize, place: &mut [f32]) {
        let (geometry, rest) = place.split_at_mut(GEOMETRY);
        geometry.copy_from_slice(&self.geometry);
        let Some((number, rule)) = rest.split_first_mut() else { return };
        *number = (slot + 1) as f32;
        if let (Some((any, levels)), false) = (rule.split_last_mut(), self.rule.is_empty()) {
            levels.iter_mut().zip(&self.rule).for_each(|(place, level)| *place = *level);
            *any = 1.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tokenrig::Head;

    #[test]
    fn a_place_is_told_its_joint_and_where_it_has_room_the_rules_codes() {
        let layout = Layout::new(10, &[3, 5], Head::Levels);
        // The second level of the first axis is in the middle, the last of the other at its end.
        let levels: Vec<f32> = [1 + 3 * 4, 0].iter().flat_map(|&code| layout.levels_of(code)).collect();
        assert_eq!(levels, [0.0, 1.0, -1.0, -1.0]);
        let told = JointTold { geometry: [0.5; GEOMETRY], rule: levels };
        let none = JointTold { rule: Vec::new(), ..told.clone() };
        let row = |told: &JointTold, tell_rule| {
            let config = TokenRigConfig { tell_rule, ..TokenRigConfig::default() };
            let mut row = vec![0.0; config.told(&layout, 2)];
            told.at(1, &mut row);
            assert_eq!((&row[..GEOMETRY], row[GEOMETRY]), (&[0.5; GEOMETRY][..], 2.0));
            row.split_off(GEOMETRY + 1)
        };
        assert_eq!(row(&told, true), [0.0, 1.0, -1.0, -1.0, 1.0]);
        assert_eq!(row(&none, true), [0.0; 5]);
        assert!(row(&told, false).is_empty());
    }
}
