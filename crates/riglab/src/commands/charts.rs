//! Charts of a page as files, for papers.

use std::path::{Path, PathBuf};

use anyhow::{Result, anyhow, bail};
use riglab_report::Page;

use super::earlier::{Written, keep_others};

/// The files of a page's charts in a folder, each as SVG and as numbers, with what to write into them.
///
/// # Errors
/// Where one would take the place of what is no chart of ours: told before any of them is written.
pub fn charts(page: &Page, folder: &Path) -> Result<Vec<(PathBuf, String)>> {
    no_file(folder)?;
    let mut files = Vec::new();
    for figure in page.figures()? {
        let path = |ending: &str| folder.join(format!("{}.{ending}", figure.name));
        files.extend([(path("svg"), figure.svg), (path("csv"), figure.csv)]);
    }
    files.iter().try_for_each(|(path, _)| keep_others(path, Written::Chart))?;
    if files.is_empty() {
        tell!("note: there is no chart to write into {}: nothing was logged yet", folder.display());
    }
    Ok(files)
}

/// Refuses a folder where charts cannot be written, or where one that `may` be called so would take the place of what is no
/// chart of ours.
///
/// # Errors
/// As told, and before the work that the charts are of.
pub fn spare(folder: &Path, may: impl Fn(&str) -> bool) -> Result<()> {
    no_file(folder)?;
    let remedy = "give --charts a folder where you may write, or make this one so";
    riglab_files::may_write(folder).map_err(|e| anyhow!("no charts can be written into {e}; {remedy}"))?;
    let mut there: Vec<PathBuf> = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).collect();
    there.retain(|path| {
        let (stem, ending) = (path.file_stem().unwrap_or_default(), path.extension().unwrap_or_default());
        (ending == "svg" || ending == "csv") && stem.to_str().is_some_and(&may)
    });
    there.sort();
    there.iter().try_for_each(|path| keep_others(path, Written::Chart))
}

/// Refuses a file where the charts' folder is to be.
pub fn no_file(folder: &Path) -> Result<()> {
    if folder.is_file() {
        bail!("{} is a file, where the charts' folder is to be; give --charts another folder", folder.display());
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
        let (kind, blocks) = (riglab_report::PageKind::Report, vec![Block::Charts(vec![chart])]);
        let page = Page { kind, title: "t".into(), subtitle: "s".into(), blocks };
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("paper/figures");
        let files = charts(&page, &folder).unwrap();
        let [(svg, drawing), (csv, numbers)] = &files[..] else { panic!("{files:?}") };
        assert!(svg.ends_with("figures/iou-val.svg") && drawing.starts_with("<?xml"));
        assert!(csv.ends_with("figures/iou-val.csv") && numbers.starts_with("line,step,value\r\nours,0,1"));
        // Earlier ones are replaced, what is another's is not, nor a file in the folder's place.
        std::fs::create_dir_all(&folder).unwrap();
        files.iter().for_each(|(path, content)| std::fs::write(path, content).unwrap());
        assert_eq!(charts(&page, &folder).unwrap(), files);
        std::fs::write(csv, "step,mine\n1,2\n").unwrap();
        let said = charts(&page, &folder).unwrap_err().to_string();
        assert!(said.contains("iou-val.csv is there already") && said.contains("--charts another folder"), "{said}");
        assert!(charts(&page, csv).unwrap_err().to_string().contains("is a file"));
        // Nothing to draw is no fault.
        assert!(charts(&Page { blocks: Vec::new(), ..page }, &dir.path().join("none")).unwrap().is_empty());
    }
}
