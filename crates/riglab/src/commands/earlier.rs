//! Files that a command may write its result over: its own earlier ones alone.

use std::path::Path;

use anyhow::{Result, bail};
use serde_json::Value;

/// What a command writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Written {
    /// `riglab compare`, in whatever form.
    Comparison,
    /// `riglab report`, in whatever form.
    Report,
    /// `riglab eval`.
    Evaluation,
}

impl Written {
    fn name(self) -> &'static str {
        match self {
            Self::Comparison => "comparison",
            Self::Report => "report",
            Self::Evaluation => "evaluation",
        }
    }

    /// Whether a text is one, by what each of them begins with or holds.
    fn is(self, text: &str) -> bool {
        let object = || serde_json::from_str::<Value>(text).unwrap_or_default();
        let page =
            || text.starts_with("<!doctype html>") && text.contains("content=\"default-src 'none'; img-src data:");
        match self {
            Self::Comparison => {
                let tables = ["Assets of ", "**Assets of ", "system,asset,status,"].iter().any(|s| text.starts_with(s));
                let latex = || text.contains("\\begin{table}\n") && text.contains("\\caption{Assets of ");
                tables || latex() || page() || object().get("systems").zip(object().get("truth")).is_some()
            }
            Self::Report => {
                let csv = ["table,row,column,value,published", "about,metric,convention,better,first run,"]
                    .iter()
                    .any(|s| text.starts_with(s));
                let latex = || text.starts_with("% ") && text.lines().nth(1).is_some_and(|l| l.starts_with("% Needs "));
                let heading = |line: &str| ["## Training", "## To repeat it"].contains(&line);
                csv || latex() || page() || (text.starts_with("# ") && text.lines().any(heading))
            }
            Self::Evaluation => object()["checkpoint"]["step"].is_u64(),
        }
    }
}

/// Refuses to write over a file that is no earlier result of the same command: it may be what was read, or somebody's work.
///
/// # Errors
/// Where there is such a file: told before the work, not after it.
pub fn keep_others(out: &Path, written: Written) -> Result<()> {
    super::keep_corpus(out)?;
    if !out.is_file() {
        return Ok(());
    }
    let text = std::fs::read(out).map(String::from_utf8);
    // An empty file loses nothing, as one that `mktemp` made.
    if matches!(&text, Ok(Ok(text)) if text.is_empty() || written.is(text)) {
        return Ok(());
    }
    let what = written.name();
    bail!("{} is there already and no {what}, which another {what} may replace; give --out another name", out.display())
}

#[cfg(test)]
mod tests {
    use riglab_compare::{Comparison, Failures};
    use riglab_report::{Block, Page, Table};

    use super::*;

    /// Whether a content may be written over.
    fn may(content: impl AsRef<[u8]>, written: Written) -> bool {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), content).unwrap();
        keep_others(file.path(), written).is_ok()
    }

    #[test]
    fn earlier_results_are_replaced_in_every_form() {
        let all =
            Comparison { truth: "t".into(), failures: Failures::Apart, unread_truth: Vec::new(), systems: Vec::new() };
        let forms =
            [Table::to_text, Table::to_markdown, Table::to_latex].map(|form: fn(&Table) -> String| form(&all.counts()));
        assert!(forms.iter().all(|text| may(text, Written::Comparison)), "{forms:?}");
        assert!(may(all.assets(&[], true).to_csv(), Written::Comparison));
        assert!(may(all.to_json(&[]).to_string(), Written::Comparison));
        let page = |heading: &str| {
            let blocks = vec![Block::Heading(heading.into()), Block::Table(all.counts())];
            Page { title: "t".into(), subtitle: "s".into(), blocks }
        };
        for heading in ["Training", "To repeat it"] {
            let page = page(heading);
            for text in [page.to_html().unwrap(), page.to_markdown(), page.to_latex(), page.to_csv()] {
                assert!(may(&text, Written::Report), "{text}");
            }
        }
        assert!(may(page("").to_html().unwrap(), Written::Comparison));
        assert!(may("{\"data\": [], \"checkpoint\": {\"step\": 3}}", Written::Evaluation));
        // Nothing is lost with it.
        assert!(may("", Written::Evaluation));
        assert!(keep_others(Path::new("nowhere/at-all.json"), Written::Evaluation).is_ok());
    }

    #[test]
    fn what_is_none_stays() {
        let evaluation = "{\"checkpoint\": {\"step\": 3}}";
        for written in [Written::Comparison, Written::Report, Written::Evaluation] {
            for other in [
                "task = \"fsq_cvae\"\n",
                "{\"train\": [\"a.glb\"]}",
                "joints a 0 0 0\n",
                "# Notes\n\nmine\n",
                "a,b\n1,2\n",
            ] {
                assert!(!may(other, written), "{written:?}: {other}");
            }
            assert!(!may(b"glTF\x02\xff\xfe", written));
            assert!(written == Written::Evaluation || !may(evaluation, written), "{written:?}");
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "mine").unwrap();
        let said = keep_others(file.path(), Written::Report).unwrap_err().to_string();
        assert!(said.contains("no report") && said.contains("another name"), "{said}");
    }
}
