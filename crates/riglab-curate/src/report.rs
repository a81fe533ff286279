//! The funnel as a page.

use riglab_report::{Bars, Block, Cell, Page, PageKind, Picture, Table, counted};

use crate::Category;
use crate::config::CurateConfig;
use crate::funnel::{BONES_STEP, Funnel};
use crate::pictures::Pictures;

/// Rows of a list that are shown; the rest is in `assets.jsonl`.
const SHOWN: usize = 200;

/// The page of a curation.
pub fn page(funnel: &Funnel, pictures: &Pictures, config: &CurateConfig) -> Page {
    let mut blocks = vec![Block::Facts(facts(funnel)), Block::Table(stages(funnel))];
    if !funnel.warnings.is_empty() {
        blocks.push(Block::Heading("Warnings".into()));
        blocks.extend(funnel.warnings.iter().map(|warning| Block::Text(sentence(warning))));
    }
    blocks.push(Block::Heading("What was kept".into()));
    blocks.push(Block::Bars(vec![categories(funnel), bones(funnel)]));
    blocks.push(Block::Table(statistics(funnel)));
    if funnel.agreement.of > 0 {
        blocks.push(Block::Table(confusion(funnel)));
    }
    if let Some(vlm) = &funnel.vlm {
        let gave_up = if vlm.gave_up { " No more were sent after several failures in a row." } else { "" };
        blocks.push(Block::Text(format!(
            "The model {} got {} requests; {} answers were cached, {} named no category, {} requests failed.{gave_up}",
            config.categories.vlm.model, vlm.requests, vlm.cached, vlm.senseless, vlm.failed
        )));
    }
    if let Some(png) = pictures.sheet(None) {
        blocks.push(Block::Pictures(vec![Picture { caption: "Some of the kept assets".into(), file: None, png }]));
    }
    blocks.push(Block::Heading("What was dropped".into()));
    for stage in funnel.stages.iter().filter(|s| !s.dropped.is_empty()) {
        let mut table =
            Table::new(format!("{}: {}", stage.stage, counted(stage.dropped.len(), "asset")), &["asset", "why"]);
        for (name, why) in stage.dropped.iter().take(SHOWN) {
            table.row(vec![Cell::text(name), Cell::text(why)]);
        }
        if stage.dropped.len() > SHOWN {
            table.note = format!("and {} more: see assets.jsonl", stage.dropped.len() - SHOWN);
        }
        blocks.push(Block::Table(table));
        if let Some(png) = pictures.sheet(Some(&stage.stage)) {
            let caption = format!("Some that `{}` dropped", stage.stage);
            blocks.push(Block::Pictures(vec![Picture { caption, file: None, png }]));
        }
    }
    if !funnel.duplicates.is_empty() {
        let mut table = Table::new("Groups of duplicates", &["kept", "the others"]);
        for group in funnel.duplicates.iter().take(SHOWN) {
            let others = group[1..].iter().take(12).cloned().collect::<Vec<_>>().join(", ");
            let more = if group.len() > 13 { format!(" and {} more", group.len() - 13) } else { String::new() };
            table.row(vec![Cell::text(&group[0]), Cell::text(others + &more)]);
        }
        if funnel.duplicates.len() > SHOWN {
            table.note = format!("and {} more: see funnel.json", funnel.duplicates.len() - SHOWN);
        }
        blocks.push(Block::Table(table));
    }
    let subtitle = format!("{} of {} assets kept", funnel.kept, funnel.assets);
    Page { kind: PageKind::Curation, title: "Curation".into(), subtitle, blocks }
}

/// A warning as a paragraph of its own: with a full stop, unless it ends as a sentence already.
fn sentence(warning: &str) -> String {
    let ends = warning.ends_with(['.', '?', '!']);
    format!("{warning}{}", if ends { "" } else { "." })
}

fn facts(funnel: &Funnel) -> Vec<(String, String)> {
    let list = |counts: &std::collections::BTreeMap<String, usize>| {
        let name = |n: &str| if n.is_empty() { "none".to_owned() } else { n.to_owned() };
        counts.iter().map(|(n, c)| format!("{} {c}", name(n))).collect::<Vec<_>>().join(", ")
    };
    let mut facts = vec![
        ("assets".into(), funnel.assets.to_string()),
        ("kept".into(), funnel.kept.to_string()),
        ("repaired".into(), funnel.repaired.to_string()),
        ("groups of duplicates".into(), funnel.duplicates.len().to_string()),
        ("splits".into(), list(&funnel.splits)),
        ("categories by".into(), list(&funnel.labelled_by)),
    ];
    if funnel.decisions > 0 {
        facts.push(("decisions applied".into(), funnel.decisions.to_string()));
    }
    facts
}

fn stages(funnel: &Funnel) -> Table {
    let mut table = Table::new("The funnel", &["stage", "came", "dropped", "left"]);
    for stage in &funnel.stages {
        let dropped = stage.dropped.len();
        table.row(vec![
            Cell::text(&stage.stage),
            Cell::count(stage.came),
            Cell::count(dropped),
            Cell::count(stage.came - dropped),
        ]);
    }
    table.note = "An asset is counted at the first stage that drops it.".into();
    table
}

fn categories(funnel: &Funnel) -> Bars {
    let bars = funnel.categories.iter().map(|(name, n)| (name.clone(), *n as f64)).collect();
    Bars { title: "Categories of the kept assets".into(), bars }
}

fn bones(funnel: &Funnel) -> Bars {
    let last = funnel.bones.len() - 1;
    let name = |k: usize| match k {
        k if k == last => format!("{} +", k * BONES_STEP),
        k => format!("{} to {}", k * BONES_STEP, (k + 1) * BONES_STEP - 1),
    };
    // Up to the last bar that has any.
    let end = funnel.bones.iter().rposition(|n| *n > 0).map_or(0, |k| k + 1);
    let bars = funnel.bones[..end].iter().enumerate().map(|(k, n)| (name(k), *n as f64)).collect();
    Bars { title: "Bones of the kept assets".into(), bars }
}

fn statistics(funnel: &Funnel) -> Table {
    let head =
        ["category", "assets", "topologies", "mean N", "mean triangles", "mean J", "J from", "J to", "sparsity %"];
    let mut table = Table::new("Statistics of the kept assets", &head);
    for row in &funnel.statistics {
        if row.of == "all" {
            table.line();
        }
        table.row(vec![
            Cell::text(&row.of),
            Cell::count(row.assets),
            Cell::count(row.topologies),
            Cell::number(row.vertices, 0),
            Cell::number(row.triangles, 0),
            Cell::number(row.joints, 1),
            Cell::count(row.joints_min),
            Cell::count(row.joints_max),
            Cell::number(row.sparsity_percent, 2),
        ]);
    }
    table.note =
        "N: vertices, J: joints; sparsity: share of the N × J weights that are not 0, mean over assets.".into();
    table
}

fn confusion(funnel: &Funnel) -> Table {
    let a = &funnel.agreement;
    let percent = 100.0 * a.same as f64 / a.of as f64;
    let head: Vec<&str> = std::iter::once("stated by the source").chain(Category::ALL.map(Category::name)).collect();
    let mut table =
        Table::new(format!("Categories by rules: {} of {} as the source states ({percent:.1} %)", a.same, a.of), &head);
    for stated in Category::ALL {
        let row = a.confusion.get(&stated);
        let count = |c: Category| row.and_then(|r| r.get(&c)).copied().unwrap_or(0);
        let cell =
            |c: Category| if count(c) == 0 { Cell::none() } else { Cell::count(count(c)).strong_if(c == stated) };
        table.row(std::iter::once(Cell::text(stated.name())).chain(Category::ALL.map(cell)).collect());
    }
    table.note = "Of all assets that can be read and whose source states one of the eight categories.".into();
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn warnings_end_once() {
        let said = ["is `a.glb` meant?", "b.glb is left out", "c.glb is left out."].map(sentence);
        assert_eq!(said, ["is `a.glb` meant?", "b.glb is left out.", "c.glb is left out."]);
    }
}
