//! Files that a command may write its result over: what riglab wrote, and what others wrote in the same format where
//! `--overwrite` says so. A file of another kind always stays, and so does one that is write-protected.

use std::io::Read;
use std::path::Path;

use anyhow::{Result, anyhow, bail};
use riglab_asset::Target;
use riglab_data::Corpus;
use riglab_render::is_own_png;
use riglab_report::{PageKind, counted};
use serde_json::Value;

use super::short;

/// What a command writes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Written {
    /// `riglab compare`, in whatever form.
    Comparison,
    /// `riglab rewards`, in whatever form.
    Rewards,
    /// `riglab report`, in whatever form.
    Report,
    /// `riglab eval`.
    Evaluation,
    /// `--charts`: a drawing, or its numbers.
    Chart,
    /// `--png`.
    Picture,
    /// A rigged model, or one without its rig.
    Glb,
    /// `riglab checkpoint export` and `import`.
    Model,
    /// `riglab convert`.
    Format(Target),
}

impl Written {
    fn name(self) -> String {
        let name = match self {
            Self::Comparison => "comparison",
            Self::Rewards => "table of rewards",
            Self::Report => "report",
            Self::Evaluation => "evaluation",
            Self::Chart => "chart of riglab's",
            Self::Picture => "PNG picture",
            Self::Glb => "GLB",
            Self::Model => "exported model",
            Self::Format(target) => return format!("file of {target}"),
        };
        name.into()
    }

    /// What to do where another file is there.
    fn remedy(self) -> &'static str {
        match self {
            Self::Chart => "give --charts another folder",
            Self::Picture => "give --png another name",
            Self::Glb => "give the output another name",
            Self::Format(_) => "give another name or folder to write",
            _ => "give --out another name",
        }
    }

    /// Whether a file is one: large ones are known by how they begin.
    pub fn is_at(self, path: &Path) -> bool {
        match self {
            Self::Picture => start(path).starts_with(b"\x89PNG\r\n\x1a\n"),
            Self::Glb => Target::GLB.is_at(path),
            Self::Model => riglab_task::bundle::kind(path).is_some(),
            Self::Format(target) => target.is_at(path),
            _ => std::fs::read_to_string(path).is_ok_and(|text| self.is(&text)),
        }
    }

    /// Whether riglab wrote a file that is one: of most kinds it alone writes any.
    fn is_own(self, path: &Path) -> bool {
        match self {
            Self::Picture => is_own_png(&start(path)),
            Self::Glb => Target::GLB.is_own(path),
            Self::Format(target) => target.is_own(path),
            _ => true,
        }
    }

    /// Whether a text is one, by what each of them begins with or holds.
    fn is(self, text: &str) -> bool {
        let object = || serde_json::from_str::<Value>(text).unwrap_or_default();
        match self {
            Self::Comparison => {
                let tables = ["Assets of ", "**Assets of ", "system,asset,status,"].iter().any(|s| text.starts_with(s));
                let latex = || text.contains("\\begin{table}\n") && text.contains("\\caption{Assets of ");
                let page = || PageKind::Comparison.is(text);
                tables || latex() || page() || object().get("systems").zip(object().get("truth")).is_some()
            }
            Self::Rewards => {
                let tables = ["Rewards: ", "**Rewards: ", "system,rig,joints,"].iter().any(|s| text.starts_with(s));
                let latex = || text.contains("\\begin{table}\n") && text.contains("\\caption{Rewards: ");
                let page = || PageKind::Rewards.is(text);
                tables || latex() || page() || object().get("systems").zip(object().get("reward")).is_some()
            }
            Self::Report => {
                let csv = ["table,row,column,value,published", "about,metric,convention,better,first run,"]
                    .iter()
                    .any(|s| text.starts_with(s));
                let latex = || text.starts_with("% ") && text.lines().nth(1).is_some_and(|l| l.starts_with("% Needs "));
                let heading = |line: &str| ["## Training", "## To repeat it"].contains(&line);
                let page = || PageKind::Report.is(text);
                csv || latex() || page() || (text.starts_with("# ") && text.lines().any(heading))
            }
            Self::Evaluation => object()["checkpoint"]["step"].is_u64(),
            Self::Chart => {
                let drawing = || {
                    text.starts_with("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg ")
                        && text.contains("\n<rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>")
                };
                let head = text.split_once("\r\n").map_or("", |(head, _)| head);
                head == "name,value" || head.starts_with("line,") || drawing()
            }
            Self::Picture | Self::Glb | Self::Model | Self::Format(_) => false,
        }
    }
}

/// How large pictures begin.
fn start(path: &Path) -> Vec<u8> {
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|file| file.take(1 << 10).read_to_end(&mut start));
    read.map_or(Vec::new(), |_| start)
}

/// Of commands whose results are of formats that others write, too.
#[derive(Clone, Copy, Default, clap::Args)]
pub struct Overwrite {
    /// Let the output also replace a file of its format that riglab did not write.
    #[arg(long)]
    overwrite: bool,
}

impl Overwrite {
    /// Refuses to write over a file that riglab did not write, unless it is of the format and may go: it may be what was read,
    /// or somebody's work.
    ///
    /// # Errors
    /// Where there is such a file, or a write-protected one: told before the work, not after it.
    pub fn keep_others(self, out: &Path, written: Written) -> Result<()> {
        // Before what a format takes for its own: a corpus is HDF5 as well.
        super::keep_corpus(out)?;
        riglab_files::may_replace(out).map_err(|e| anyhow!("{} {e}", out.display()))?;
        // An empty file loses nothing, as one that `mktemp` made.
        if !out.is_file() || out.metadata().is_ok_and(|meta| meta.len() == 0) {
            return Ok(());
        }
        let (what, remedy) = (written.name(), written.remedy());
        match written.is_at(out) {
            true if self.overwrite || written.is_own(out) => Ok(()),
            true => bail!(
                "{} is there already and not marked as written by riglab; {remedy}, or --overwrite to replace it",
                out.display()
            ),
            false => {
                bail!("{} is there already and no {what}, which another {what} may replace; {remedy}", out.display())
            }
        }
    }
}

/// The same where nobody else writes files of the kind.
///
/// # Errors
/// As [`Overwrite::keep_others`].
pub fn keep_others(out: &Path, written: Written) -> Result<()> {
    Overwrite::default().keep_others(out, written)
}

/// The corpus that stood where another is written: how many assets, and its checksum.
pub struct Earlier(Option<(usize, String)>);

impl Earlier {
    pub fn at(out: &Path) -> Self {
        Self(Corpus::open(out).ok().and_then(|corpus| Some((corpus.len(), corpus.checksum().ok()?))))
    }

    /// Says that it was another one: runs begun on it do not go on with this.
    pub fn tell_replaced(&self, out: &Path) {
        let (Some((assets, sum)), Self(Some((_, now)))) = (&self.0, Self::at(out)) else { return };
        if *sum != now {
            let assets = counted(*assets, "asset");
            tell!("note: {} was another corpus before, of {assets} ({}), and is replaced", out.display(), short(sum));
        }
    }
}

#[cfg(test)]
mod tests {
    use riglab_compare::{Comparison, Failures};
    use riglab_render::{Picture, Rgb};
    use riglab_report::{Bars, Block, Chart, Page, Series, Table};

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
        assert!(may(all.summary(&[]).assets(true).to_csv(), Written::Comparison));
        assert!(may(all.summary(&[]).to_json().to_string(), Written::Comparison));
        let page = |heading: &str| {
            let blocks = vec![Block::Heading(heading.into()), Block::Table(all.counts())];
            Page { kind: PageKind::Report, title: "t".into(), subtitle: "s".into(), blocks }
        };
        for heading in ["Training", "To repeat it"] {
            let page = page(heading);
            for text in [page.to_html().unwrap(), page.to_markdown(), page.to_latex(), page.to_csv()] {
                assert!(may(&text, Written::Report), "{text}");
            }
        }
        // Each by its own kind alone.
        let all_kinds = [
            (PageKind::Comparison, Written::Comparison),
            (PageKind::Rewards, Written::Rewards),
            (PageKind::Report, Written::Report),
        ];
        for (kind, own) in all_kinds {
            let html = Page { kind, ..page("") }.to_html().unwrap();
            for (_, other) in all_kinds {
                assert_eq!(may(&html, other), other == own, "{kind:?} {other:?}");
            }
        }
        for kind in [PageKind::Curation, PageKind::Sweep] {
            assert!(!may(Page { kind, ..page("") }.to_html().unwrap(), Written::Report));
        }
        assert!(may("{\"data\": [], \"checkpoint\": {\"step\": 3}}", Written::Evaluation));
        let series = vec![Series { name: "ours".into(), points: vec![(0.0, 1.0), (100.0, 0.5)] }];
        let chart = Chart { title: "IoU".into(), x: "codes, kept".into(), series, ..Chart::default() };
        let bars = Bars { title: "a & b".into(), bars: vec![("x".into(), 2.0)] };
        let blocks = vec![Block::Charts(vec![chart]), Block::Bars(vec![bars])];
        for figure in (Page { blocks, ..page("") }).figures().unwrap() {
            assert!(may(&figure.svg, Written::Chart) && may(&figure.csv, Written::Chart), "{figure:?}");
        }
        assert!(may(Picture::filled(2, 2, Rgb([0; 3])).to_png(), Written::Picture));
        // Nothing is lost with it.
        assert!(may("", Written::Evaluation));
        assert!(keep_others(Path::new("nowhere/at-all.json"), Written::Evaluation).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn what_is_write_protected_stays() {
        use std::os::unix::fs::PermissionsExt;
        for content in ["", "# riglab 0: a mesh\nv 0 0 0\n"] {
            let file = tempfile::NamedTempFile::new().unwrap();
            std::fs::write(file.path(), content).unwrap();
            let kept = || Overwrite { overwrite: true }.keep_others(file.path(), Written::Format(Target::OBJ));
            assert!(kept().is_ok());
            std::fs::set_permissions(file.path(), std::fs::Permissions::from_mode(0o444)).unwrap();
            assert!(kept().unwrap_err().to_string().ends_with("allow writing, or give another name"));
        }
    }

    #[test]
    fn what_others_wrote_in_the_format_goes_on_request_alone() {
        let file = tempfile::NamedTempFile::new().unwrap();
        for (content, written) in [
            (&b"\x89PNG\r\n\x1a\n\0\0"[..], Written::Picture),
            (b"glTF\x02\xff", Written::Glb),
            (b"v 0 0 0\n", Written::Format(Target::OBJ)),
        ] {
            std::fs::write(file.path(), content).unwrap();
            let said = keep_others(file.path(), written).unwrap_err().to_string();
            assert!(said.contains("not marked as written by riglab") && said.contains("--overwrite"), "{said}");
            assert!(Overwrite { overwrite: true }.keep_others(file.path(), written).is_ok());
            std::fs::write(file.path(), "mine").unwrap();
            assert!(Overwrite { overwrite: true }.keep_others(file.path(), written).is_err());
        }
    }

    #[test]
    fn what_is_none_stays() {
        let evaluation = "{\"checkpoint\": {\"step\": 3}}";
        let all = [
            Written::Comparison,
            Written::Rewards,
            Written::Report,
            Written::Evaluation,
            Written::Chart,
            Written::Picture,
        ];
        for written in all.into_iter().chain([Written::Glb, Written::Model]) {
            for other in [
                "task = \"fsq_cvae\"\n",
                "{\"train\": [\"a.glb\"]}",
                "joints a 0 0 0\n",
                "# Notes\n\nmine\n",
                "a,b\n1,2\n",
                "<svg xmlns=\"http://www.w3.org/2000/svg\"/>",
                "line,of,mine\n",
            ] {
                assert!(!may(other, written), "{written:?}: {other}");
            }
            assert!(!may(b"glTF\x02\xff\xfe", written));
            assert!(written == Written::Evaluation || !may(evaluation, written), "{written:?}");
        }
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "mine").unwrap();
        let said = keep_others(file.path(), Written::Report).unwrap_err().to_string();
        assert!(said.contains("no report") && said.contains("--out another name"), "{said}");
        let said = keep_others(file.path(), Written::Chart).unwrap_err().to_string();
        assert!(said.contains("no chart of riglab's") && said.contains("--charts another folder"), "{said}");
    }
}
