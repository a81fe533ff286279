//! Pictures of some of what is kept and of what each stage dropped.

use std::collections::{BTreeMap, HashMap, HashSet};

use riglab_core::Asset;
use riglab_render::{Picture, Theme, View, contact_sheet, render_skeleton};

use crate::config::ReportConfig;
use crate::judge::Judgement;
use crate::record::{READ, Record};

/// Pictures by the group they belong to.
pub struct Pictures {
    pixels: u32,
    /// The group of each name: `None` for what is kept, else a stage.
    wanted: HashMap<String, Option<String>>,
    drawn: BTreeMap<Option<String>, BTreeMap<String, Picture>>,
    /// What stands below each.
    captions: HashMap<String, String>,
}

impl Pictures {
    /// Chooses which assets to draw: as if at random, but always the same.
    pub fn choose(records: &[Record], judged: &Judgement, config: &ReportConfig) -> Self {
        let mut order: Vec<usize> = (0..records.len()).filter(|&i| records[i].facts.is_some()).collect();
        order.sort_by_cached_key(|&i| *blake3::hash(records[i].name.as_bytes()).as_bytes());
        let (mut wanted, mut captions) = (HashMap::new(), HashMap::new());
        let mut counts: HashMap<Option<String>, usize> = HashMap::new();
        for i in order {
            let group = judged.dropped[i].as_ref().map(|(stage, _)| stage.clone());
            if group.as_deref() == Some(READ) {
                continue;
            }
            let most = if group.is_none() { config.kept } else { config.dropped };
            let count = counts.entry(group.clone()).or_default();
            if *count < most {
                *count += 1;
                let name = records[i].name.clone();
                let label = judged.labels.get(&name).map_or(String::new(), |l| format!("\n{}", l.category));
                let stem = name.rsplit('/').next().unwrap_or(&name);
                captions.insert(name.clone(), format!("{stem}{label}"));
                wanted.insert(name, group);
            }
        }
        Self { pixels: config.pixels, wanted, drawn: BTreeMap::new(), captions }
    }

    /// Draws an asset, if it was chosen.
    pub fn draw(&mut self, asset: &Asset) {
        if let Some(group) = self.wanted.get(&asset.name) {
            let picture = render_skeleton(&asset.rig, &View::square(self.pixels));
            self.drawn.entry(group.clone()).or_default().insert(asset.name.clone(), picture);
        }
    }

    /// Records that were chosen and are not drawn yet.
    pub fn missing<'a>(&self, records: &'a [Record]) -> Vec<&'a Record> {
        let drawn: HashSet<&String> = self.drawn.values().flat_map(BTreeMap::keys).collect();
        records.iter().filter(|r| self.wanted.contains_key(&r.name) && !drawn.contains(&r.name)).collect()
    }

    /// One picture of all of a group; `None` for an empty one.
    pub fn sheet(&self, group: Option<&str>) -> Option<Vec<u8>> {
        let group = self.drawn.get(&group.map(String::from)).filter(|g| !g.is_empty())?;
        let caption = |name: &String| self.captions.get(name).cloned().unwrap_or_default();
        let cells: Vec<(String, Picture)> = group.iter().map(|(name, p)| (caption(name), p.clone())).collect();
        let columns = (1100 / self.pixels.max(1) as usize).clamp(1, 12);
        Some(contact_sheet(&cells, columns, Theme::Light).to_png())
    }
}
