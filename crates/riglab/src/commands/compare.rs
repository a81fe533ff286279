//! `riglab compare`

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use riglab_compare::{Comparison, Failures, Kind, Predictions, Status, Summary, System, Truths, score};
use riglab_metric::{Preset, SkinBaseline};
use riglab_report::{PageKind, Table};
use riglab_train::Progress;

use super::alike::by_reason;
use super::earlier::Written;
use super::forms::{Form, Forms, systems};

/// Score rigs that other systems wrote against true ones.
///
/// Files are matched to true assets by their path without ending, with or without what systems add to names (`_rig`,
/// `_skin`), or by their name alone where only one asset has it; a file that is given for one asset is its own, whatever the
/// two are called. Of bird.glb and bird.fbx each has its own where the ending stays in the name, as bird.fbx.glb, and of two
/// assets in files of several where the file's name does, as set.npz#bird.glb; no file is compared with both. Every true asset
/// is counted: scored, failed (with the reason) or missing. What lies in a system's folder below that of the true rigs is
/// none of these. Metrics follow each paper's own formulas (--preset), named beside each number. Weights are compared only where
/// a prediction has the joints of the true rig.
///
/// A prediction is moved and scaled onto the true mesh, whatever its coordinates are. A skeleton without mesh is taken as it is,
/// or from a cube of side 1 or 2 around the truth where its joints then span clearly more nearly what the true ones do. The
/// notes of each asset say what was done.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab compare predictions/ --truth rigs.h5 --split test_new
  riglab compare unirig=out/unirig puppeteer=out/puppeteer --truth rigs/ --markdown
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
    /// How failed and missing assets, and figures that a prediction leaves undefined, count: apart (not in the means), or worst
    /// (as the worst weights, and one joint at the centre).
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
    #[command(flatten)]
    forms: Forms,
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
    let files = args.forms.files(Written::Comparison)?;
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
    let mut truths = Truths::open(truth, args.split.as_deref())?;
    let found = |(name, folder): (String, PathBuf)| Ok((name, Predictions::find(&folder, args.format)?));
    let systems: Vec<(String, Predictions)> = systems(&args.systems)?.into_iter().map(found).collect::<Result<_>>()?;
    truths.leave_out(systems.iter().map(|(_, predictions)| predictions.folder()))?;
    truths.notes.iter().for_each(|note| tell!("note: {note}"));
    for (name, Predictions { hidden, .. }) in &systems {
        hidden.iter().for_each(|hidden| tell!("note: {name}: {hidden}"));
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
    let summary = comparison.summary(presets);
    args.forms.write(&files, |form| text(args, form, &comparison, &summary, &published))?;
    // Baselines are always scored; they count where nothing else is asked for.
    let alone = comparison.systems.iter().all(|s| s.baseline);
    let any = comparison.systems.iter().any(|s| (alone || !s.baseline) && s.counts()[0] > 0);
    Ok(if any { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// What was asked for, in a form.
fn text(args: &Args, form: Form, comparison: &Comparison, summary: &Summary, published: &[Table]) -> Result<String> {
    match form {
        Form::Json => return Ok(serde_json::to_string_pretty(&summary.to_json())? + "\n"),
        Form::Csv => return Ok(summary.assets(true).to_csv()),
        _ => {}
    }
    let mut tables = vec![comparison.counts()];
    tables.extend(if args.assets { vec![summary.assets(false)] } else { summary.tables() });
    tables.extend_from_slice(published);
    let names: Vec<&str> = comparison.systems.iter().map(|s| s.name.as_str()).collect();
    form.of(tables, PageKind::Comparison, "Comparison", &format!("{} against {}", names.join(", "), comparison.truth))
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
    let mut said = vec![("warning: not compared with: ".to_owned(), both(&comparison.unread_truth))];
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
        None if files.is_empty() && (args.forms.json || args.forms.csv || args.assets) => format!("{all} follows"),
        None => format!("--assets shows {all}; -o FILE.csv and -o FILE.json write it"),
    }
}

#[cfg(test)]
mod tests {
    use riglab_compare::Row;

    use super::*;

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
                "warning: not compared with: b.glb: it is empty",
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
