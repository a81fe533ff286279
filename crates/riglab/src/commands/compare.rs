//! `riglab compare`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_compare::{Comparison, Failures, Kind, Predictions, Status, System, Truths, score};
use riglab_files::make_folder_of;
use riglab_metric::{Preset, SkinBaseline};
use riglab_report::{Block, Page, Table};
use riglab_train::Progress;

use super::alike::by_reason;
use super::earlier::{Written, keep_others};

/// Score rigs that other systems wrote against true ones.
///
/// Files are matched to true assets by their path without ending, or by their name alone. Every true asset is
/// counted: scored, failed (with the reason) or missing. Metrics follow each paper's own formulas (--preset), named beside
/// each number. Weights are compared only where a prediction has the joints of the true rig.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab compare predictions/ --truth rigs.h5 --split test_new
  riglab compare unirig=out/unirig puppeteer=out/puppeteer --truth rigs/ --preset skintokens --markdown
  riglab compare out/ --truth rigs/ -o scores.csv
  riglab compare --baselines --truth rigs.h5        # the baselines alone")]
pub struct Args {
    /// Folders of predictions, files of several assets, or corpora; NAME=DIR names a system in the tables.
    #[arg(required_unless_present_any = ["published", "baselines"], value_name = "[NAME=]DIR")]
    systems: Vec<String>,
    /// True rigs: a corpus, a folder of rigged files, or a file.
    #[arg(long, required_unless_present = "published", value_name = "CORPUS_OR_DIR")]
    truth: Option<PathBuf>,
    /// Of a corpus, this split alone.
    #[arg(long)]
    split: Option<String>,
    /// Which files are predictions: auto, glb (also gltf, vrm), fbx, rignet (texts, Puppeteer's too), npz, h5 or pt.
    #[arg(long, default_value = "auto", value_parser = kind)]
    format: Kind,
    /// Whose formulas, as often as needed [default: all]: skintokens, unirig, rignet, magicarticulate, puppeteer,
    /// anymate or riglab.
    #[arg(long = "preset", value_name = "NAME", value_parser = preset)]
    presets: Vec<Preset>,
    /// How failed and missing assets count: apart (not in the means), or worst (as the worst weights, and one joint at the
    /// centre).
    #[arg(long, default_value = "apart", value_parser = failures)]
    failures: Failures,
    /// Add baselines that skin the true skeletons without learning: nearest bone, inverse distance, geodesic, heat diffusion.
    #[arg(long)]
    baselines: bool,
    /// Show published numbers below: the name of a table; `list`, alone, tells the names.
    #[arg(long, value_name = "TABLE")]
    published: Vec<String>,
    /// Show every asset instead of means.
    #[arg(long)]
    assets: bool,
    /// Everything as JSON.
    #[arg(long, group = "form")]
    json: bool,
    /// Comma-separated values: every asset.
    #[arg(long, group = "form")]
    csv: bool,
    /// Tables in Markdown.
    #[arg(long, group = "form")]
    markdown: bool,
    /// Tables in LaTeX, with booktabs; tables wider than a page with graphicx, too.
    #[arg(long, group = "form")]
    latex: bool,
    /// A page.
    #[arg(long, group = "form")]
    html: bool,
    /// Write to a file instead of standard output: FILE.txt, .html, .md, .tex, .csv or .json is of that form, and without an
    /// ending, where no option says the form, all but the first are written.
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
}

/// What a comparison is written as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Form {
    Text,
    Html,
    Markdown,
    Latex,
    Csv,
    Json,
}

impl Form {
    /// By the ending of their files.
    const ALL: [(&str, Self); 6] = [
        ("txt", Self::Text),
        ("html", Self::Html),
        ("md", Self::Markdown),
        ("tex", Self::Latex),
        ("csv", Self::Csv),
        ("json", Self::Json),
    ];

    /// The one that an option asks for.
    fn asked(args: &Args) -> Option<Self> {
        let asked = [
            (args.html, Self::Html),
            (args.markdown, Self::Markdown),
            (args.latex, Self::Latex),
            (args.csv, Self::Csv),
            (args.json, Self::Json),
        ];
        asked.into_iter().find(|(asked, _)| *asked).map(|(_, form)| form)
    }
}

/// The files to write, each with its form: as the option says, else as the ending does; all forms without either, as
/// `riglab report` has it.
fn files(out: &Path, asked: Option<Form>) -> Result<Vec<(PathBuf, Form)>> {
    let ending = out.extension().map(|e| e.to_string_lossy().into_owned());
    let told = ending.as_ref().and_then(|e| Form::ALL.iter().find(|(own, _)| own == e)).map(|(_, form)| *form);
    match (asked, told, ending) {
        // A text may be of any form.
        (Some(asked), Some(told), _) if told != asked && told != Form::Text => {
            let (fits, _) = Form::ALL.iter().find(|(_, form)| *form == asked).unwrap_or(&Form::ALL[0]);
            bail!(
                "{} does not end as the form does that an option asks for: leave the option out, or give a name that ends in \
                 .{fits}",
                out.display()
            )
        }
        (Some(asked), ..) => Ok(vec![(out.into(), asked)]),
        (None, Some(told), _) => Ok(vec![(out.into(), told)]),
        (None, None, Some(e)) => {
            let there = Form::ALL.map(|(own, _)| own).join(", .");
            bail!("{}: no form has the ending .{e}; there are .{there}", out.display())
        }
        (None, None, None) => {
            Ok(Form::ALL.iter().skip(1).map(|(ending, form)| (out.with_extension(ending), *form)).collect())
        }
    }
}

fn kind(name: &str) -> Result<Kind, String> {
    let found = Kind::all().find(|(n, _)| *n == name).map(|(_, kind)| kind);
    found.ok_or_else(|| format!("there are {}", Kind::all().map(|(n, _)| n).collect::<Vec<_>>().join(", ")))
}

fn preset(name: &str) -> Result<Preset, String> {
    Preset::named(name).ok_or_else(|| format!("there are {}", Preset::ALL.map(Preset::name).join(", ")))
}

fn failures(name: &str) -> Result<Failures, String> {
    match name {
        "apart" => Ok(Failures::Apart),
        "worst" => Ok(Failures::Worst),
        _ => Err("there are apart and worst".into()),
    }
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let files = args.out.as_deref().map_or(Ok(Vec::new()), |out| files(out, Form::asked(args)))?;
    files.iter().try_for_each(|(file, _)| keep_others(file, Written::Comparison))?;
    if args.published.iter().any(|name| name == "list") {
        riglab_report::published::names().iter().for_each(|name| say!("{name}"));
        return Ok(ExitCode::SUCCESS);
    }
    let published = published(&args.published)?;
    let Some(truth) = args.truth.as_ref().filter(|_| args.baselines || !args.systems.is_empty()) else {
        match args.published.first() {
            Some(name) => bail!(
                "--published shows a table below a comparison, so give folders of predictions and what they are compared \
                 with, too: riglab compare out/ --truth rigs.h5 --published {name}; `--published list` tells the names"
            ),
            None => bail!("give folders of predictions, and with --truth what they are compared with"),
        }
    };
    let truths = Truths::open(truth, args.split.as_deref())?;
    let mut systems: Vec<(String, Predictions)> = Vec::new();
    for text in &args.systems {
        let (name, folder) = named(text);
        if systems.iter().any(|(taken, _)| *taken == name) {
            bail!("two systems are called `{name}`; name them: NAME=DIR");
        }
        systems.push((name, Predictions::find(&folder, args.format)?));
    }
    // A file may hold many.
    let total = truths.len() as u64;
    let mut progress = Progress::new("scoring", total, 0);
    let baselines: Vec<SkinBaseline> = SkinBaseline::compared().filter(|_| args.baselines).collect();
    let scored =
        score(&truths, &systems, &baselines, args.failures, |done| progress.set(total.min(done as u64), String::new));
    progress.finish();
    let (systems, unread_truth) = scored?;
    let truth = match &args.split {
        Some(split) => format!("{}, split {split}", truth.display()),
        None => truth.display().to_string(),
    };
    let comparison = Comparison { truth, failures: args.failures, unread_truth, systems };
    let (said, cut) = told(&comparison);
    said.iter().for_each(|line| tell!("{line}"));
    if cut {
        tell!("{}", whole(args, &files));
    }
    let presets = if args.presets.is_empty() { &Preset::ALL[..] } else { &args.presets };
    let text = |form| text(args, form, &comparison, presets, &published);
    for (path, form) in &files {
        let text = text(*form)?;
        let written = make_folder_of(path).and_then(|()| riglab_files::write(path, text.as_bytes()));
        written.with_context(|| format!("{} cannot be written", path.display()))?;
        say!("{}", path.display());
    }
    if files.is_empty() {
        say!("{}", text(Form::asked(args).unwrap_or(Form::Text))?.trim_end());
    }
    let any = comparison.systems.iter().any(|s| s.counts()[0] > 0);
    Ok(if any { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// What was asked for, in a form.
fn text(args: &Args, form: Form, comparison: &Comparison, presets: &[Preset], published: &[Table]) -> Result<String> {
    match form {
        Form::Json => return Ok(serde_json::to_string_pretty(&comparison.to_json(presets))? + "\n"),
        Form::Csv => return Ok(comparison.assets(presets, true).to_csv()),
        _ => {}
    }
    let mut tables = vec![comparison.counts()];
    tables.extend(if args.assets { vec![comparison.assets(presets, false)] } else { comparison.tables(presets) });
    tables.extend_from_slice(published);
    if form == Form::Html {
        let title = "Comparison".to_owned();
        let names: Vec<&str> = comparison.systems.iter().map(|s| s.name.as_str()).collect();
        let subtitle = format!("{} against {}", names.join(", "), comparison.truth);
        let blocks = tables.into_iter().map(Block::Table).collect();
        return Ok(Page { title, subtitle, blocks }.to_html()?);
    }
    let latex = form == Form::Latex;
    let to = match form {
        Form::Markdown => Table::to_markdown,
        Form::Latex => Table::to_latex,
        _ => Table::to_text,
    };
    let needs = if latex { "% Needs \\usepackage{booktabs}.\n\n" } else { "" };
    Ok(needs.to_owned() + &tables.iter().map(to).collect::<Vec<_>>().join("\n"))
}

/// The name of a system and its folder; without a name, that of the folder.
fn named(text: &str) -> (String, PathBuf) {
    match text.split_once('=') {
        Some((name, folder)) if !name.is_empty() && !Path::new(text).exists() => (name.into(), folder.into()),
        _ => {
            let path = PathBuf::from(text);
            let name = path.canonicalize().ok().and_then(|p| Some(p.file_name()?.to_string_lossy().into_owned()));
            (name.unwrap_or_else(|| text.to_owned()), path)
        }
    }
}

/// The published tables asked for.
fn published(names: &[String]) -> Result<Vec<Table>> {
    let known = riglab_report::published::names();
    let known = || known.join(", ");
    let table = |name: &String| match riglab_report::published::table(name) {
        Some(table) => Ok(table),
        None => bail!("there is no published table `{name}`; there are {}", known()),
    };
    names.iter().map(table).collect()
}

/// What became of assets, in lines; and whether some are not named in them.
fn told(comparison: &Comparison) -> (Vec<String>, bool) {
    let both = |unread: &'_ [(String, String)]| unread.to_vec();
    let mut said =
        vec![("warning: not compared with, as it cannot be read: ".to_owned(), both(&comparison.unread_truth))];
    // Of predictions without truth nothing is said elsewhere.
    let mut others = Vec::new();
    for System { name, rows, unread, unmatched, .. } in &comparison.systems {
        said.push((format!("warning: {name}: "), both(unread)));
        let (mut missing, mut failed, mut noted) = (Vec::new(), Vec::new(), Vec::new());
        for row in rows {
            let of = |reason: &str| (row.asset.clone(), reason.to_owned());
            match &row.status {
                Status::Failed(reason) => failed.push(of(reason)),
                Status::Missing => missing.push(of("there is no prediction")),
                Status::Scored => {
                    let reasons = std::iter::once(&row.without_weights).filter(|s| !s.is_empty()).chain(&row.notes);
                    noted.extend(reasons.map(|note| of(note)));
                }
            }
        }
        for (what, of) in [("missing", missing), ("failed", failed), ("note", noted)] {
            said.push((format!("{what}: {name}: "), of));
        }
        let unmatched: Vec<_> =
            unmatched.iter().map(|key| (key.clone(), "no true asset has this name".to_owned())).collect();
        others.extend(by_reason(&format!("note: {name}: "), &unmatched).0);
    }
    let lines: Vec<(Vec<String>, bool)> = said.iter().map(|(of, said)| by_reason(of, said)).collect();
    let cut = lines.iter().any(|(_, cut)| *cut);
    (lines.into_iter().flat_map(|(lines, _)| lines).chain(others).collect(), cut)
}

/// Where all that was said in short is to be found.
fn whole(args: &Args, files: &[(PathBuf, Form)]) -> String {
    let all = "every asset with what is said of it";
    match files.iter().find(|(_, form)| args.assets || [Form::Csv, Form::Json].contains(form)) {
        Some((file, _)) => format!("{all}: {}", file.display()),
        None if files.is_empty() && (args.json || args.csv || args.assets) => format!("{all} follows"),
        None => format!("--assets shows {all}; -o FILE.csv and -o FILE.json write it"),
    }
}

#[cfg(test)]
mod tests {
    use riglab_compare::Row;

    use super::*;

    #[test]
    fn an_option_or_an_ending_names_the_form_and_neither_takes_all() {
        let of = |out: &str, asked| files(Path::new(out), asked);
        let one = |out: &str, form| vec![(PathBuf::from(out), form)];
        assert_eq!(of("a/b.md", None).unwrap(), one("a/b.md", Form::Markdown));
        assert_eq!(of("b.txt", None).unwrap(), one("b.txt", Form::Text));
        for out in ["b", "b.json", "b.txt", "b.v2"] {
            assert_eq!(of(out, Some(Form::Json)).unwrap(), one(out, Form::Json));
        }
        let all = of("a/b", None).unwrap();
        let names: Vec<_> = all.iter().map(|(file, _)| file.to_str().unwrap()).collect();
        assert_eq!(names, ["a/b.html", "a/b.md", "a/b.tex", "a/b.csv", "a/b.json"]);
        let said = of("b.html", Some(Form::Csv)).unwrap_err().to_string();
        assert!(said.contains("b.html does not end as the form does") && said.contains("ends in .csv"), "{said}");
        let said = of("b.pdf", None).unwrap_err().to_string();
        assert!(said.contains("no form has the ending .pdf; there are .txt, .html"), "{said}");
    }

    #[test]
    fn systems_have_names() {
        assert_eq!(named("a=b/c"), ("a".into(), "b/c".into()));
        assert_eq!(named("nowhere/x"), ("nowhere/x".into(), "nowhere/x".into()));
        let dir = tempfile::tempdir().unwrap();
        let odd = dir.path().join("k=1");
        std::fs::create_dir(&odd).unwrap();
        assert_eq!(named(odd.to_str().unwrap()), ("k=1".into(), odd));
    }

    #[test]
    fn many_failures_are_few_lines() {
        let row = |k: usize| {
            let status = match k % 100 {
                0 => Status::Missing,
                1 => Status::Scored,
                _ => Status::Failed(format!("out/a{k}.glb: it holds no skeleton")),
            };
            let asset = format!("a{k}.glb");
            let (without_weights, notes, measures) = ("other joints".into(), Vec::new(), Vec::new());
            Row { asset, status, joints: 1, true_joints: 1, without_weights, notes, measures }
        };
        let of = |count: usize| {
            let rows = (0..count).map(row).collect();
            let (name, folder) = ("ours".into(), "out".into());
            let unmatched = vec!["x".into(), "y".into()];
            let system = System { name, folder, baseline: false, rows, unmatched, unread: Vec::new() };
            let (truth, unread_truth) = ("t".into(), vec![("b.glb".into(), "it is empty".into())]);
            told(&Comparison { truth, failures: Failures::Apart, unread_truth, systems: vec![system] })
        };
        let (lines, cut) = of(1000);
        assert_eq!(
            lines,
            [
                "warning: not compared with, as it cannot be read: b.glb: it is empty",
                "missing: ours: a0.glb, a100.glb, a200.glb and 7 more: there is no prediction",
                "failed: ours: a2.glb, a3.glb, a4.glb and 977 more: it holds no skeleton",
                "note: ours: a1.glb, a101.glb, a201.glb and 7 more: other joints",
                "note: ours: x, y: no true asset has this name",
            ]
        );
        let (few, all) = of(4);
        assert!(cut && !all && few[2] == "failed: ours: a2.glb, a3.glb: it holds no skeleton", "{few:?}");
    }

    #[test]
    fn published_tables_are_found_or_listed() {
        assert_eq!(published(&["skintokens.table3".into()]).unwrap().len(), 1);
        let e = published(&["table3".into()]).unwrap_err().to_string();
        assert!(e.contains("skintokens.table3"), "{e}");
    }
}
