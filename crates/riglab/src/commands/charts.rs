//! Charts of a page as files, for papers.

use std::path::Path;

use anyhow::Result;
use riglab_report::Page;

use super::report::write;

/// Writes a page's charts into a folder, each as SVG and as numbers.
pub fn charts(page: &Page, folder: &Path) -> Result<()> {
    let figures = page.figures()?;
    if figures.is_empty() {
        tell!("note: there is no chart to write into {}: nothing was logged yet", folder.display());
    }
    for figure in figures {
        let path = |ending: &str| folder.join(format!("{}.{ending}", figure.name));
        write(&path("svg"), &figure.svg)?;
        write(&path("csv"), &figure.csv)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use riglab_report::{Block, Chart, Series};

    use super::*;

    #[test]
    fn charts_become_files_beside_each_other() {
        let line = Series { name: "ours".into(), points: vec![(0.0, 1.0), (100.0, 0.5)] };
        let chart = Chart { title: "IoU, val".into(), x: "step".into(), series: vec![line], ..Chart::default() };
        let page = Page { title: "t".into(), subtitle: "s".into(), blocks: vec![Block::Charts(vec![chart])] };
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("paper/figures");
        charts(&page, &folder).unwrap();
        let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
        assert!(
            read("iou-val.svg").starts_with("<?xml") && read("iou-val.csv").starts_with("line,step,value\r\nours,0,1")
        );
        // Nothing to draw is no fault.
        charts(&Page { blocks: Vec::new(), ..page }, &dir.path().join("none")).unwrap();
        assert!(!dir.path().join("none").exists());
    }
}
