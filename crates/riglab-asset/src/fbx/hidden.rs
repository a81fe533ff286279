//! Nodes that a file holds and does not show.
//!
//! What is hidden (`Visibility`, which goes down the tree but where `Visibility Inheritance` says otherwise), and of levels
//! of detail, the children of a node with an `LodGroup`, all but the first.

use ufbx::{LodDisplay, Node, as_lod_group, find_prop};

use super::scene::{Nodes, number};

/// Whether each node is one of them.
pub(super) fn hidden(nodes: &Nodes<'_>) -> Vec<bool> {
    let mut hidden = vec![false; nodes.all.len()];
    let mut coarser = vec![false; nodes.all.len()];
    for &at in &nodes.order {
        let node = nodes.all[at];
        let above = nodes.parent(at).filter(|_| inherits(node));
        hidden[at] = !node.visible || coarser[at] || above.is_some_and(|above| hidden[above]);
        // What is below a coarser level is of it, whatever else it says.
        coarser[at] |= nodes.parent(at).is_some_and(|above| coarser[above]);
        hidden[at] |= coarser[at];
        let levels = (&node.all_attribs).into_iter().find_map(|own| as_lod_group(own));
        let Some(levels) = levels else { continue };
        for (level, child) in (&node.children).into_iter().enumerate() {
            let display = levels.lod_levels.get(level).map_or(LodDisplay::UseLod, |own| own.display);
            coarser[number(child)] = display == LodDisplay::Hide || (level > 0 && display != LodDisplay::Show);
        }
    }
    hidden
}

fn inherits(node: &Node) -> bool {
    find_prop(&node.element.props, "Visibility Inheritance").is_none_or(|own| own.value_int != 0)
}
