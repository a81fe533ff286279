//! `riglab report`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_files::make_folder_of;
use riglab_report::shell::command;
use riglab_report::{Block, Checkpoints, Compared, Page, PageKind, RunView, versus};
use riglab_train::without_best;

use super::charts::{charts, no_file};
use super::earlier::{Written, keep_others};
use super::{file_to_write, shown, some_of, whose};
use crate::presets;
use crate::registry::{self, Evaluated, TaskConfig};

/// Write the report of a run, or compare several.
///
/// Of one run: curves, tables with spread, published numbers and pictures. Of several: tables side by side, settings
/// that differ, paired tests against the first, the assets that changed most, categories, curves laid over each other;
/// runs evaluated on different corpora, splits or assets are refused. As one HTML file that works offline, as Markdown, LaTeX
/// (booktabs) and comma-separated values; several runs have every asset in a file FILE.assets.csv of its own.
///
/// A view of what is in the runs' folders; what is not there yet (an evaluation) is left out of a run's report.
#[derive(Clone, clap::Args)]
#[command(after_help = "\
Examples:
  riglab report runs/fsq_cvae/001                   # report.html, .md, ... in the run's folder
  riglab report runs/fsq_cvae/001 -o table.tex      # one form, by the ending
  riglab report runs/a runs/b runs/c -o comparison.html
  riglab report with=runs/a without=runs/b          # names in the tables; comparison.html, .md, ...
  riglab report runs/a runs/b --charts figures      # each chart as a file, for a paper, too")]
pub struct Args {
    /// A run's folder, or several; NAME=DIR names a run in the tables.
    #[arg(required = true, value_name = "[NAME=]RUN")]
    runs: Vec<String>,
    /// Where to write it: FILE.html, .md, .tex or .csv for one form, without an ending all of them [default:
    /// RUN/report, or comparison for several runs].
    #[arg(long, short, value_name = "FILE", value_parser = file_to_write())]
    out: Option<PathBuf>,
    /// Of one run: another evaluation of it, as `riglab eval --out` wrote it [default: RUN/eval.json].
    #[arg(long, value_name = "FILE")]
    eval: Option<PathBuf>,
    /// Title of the page [default: the run's folder].
    #[arg(long)]
    title: Option<String>,
    /// Write each chart into this folder, too: NAME.svg, dark on white and as wide as a column, and NAME.csv with all its
    /// numbers. For LaTeX, `rsvg-convert -f pdf -o NAME.pdf NAME.svg` makes a PDF, and so does Inkscape.
    #[arg(long, value_name = "DIR", value_parser = super::place_to_write())]
    charts: Option<PathBuf>,
}

/// The forms, by the ending of their files.
const FORMS: [&str; 4] = ["html", "md", "tex", "csv"];

pub fn run(args: &Args) -> Result<ExitCode> {
    let args = &Args { runs: folders(&args.runs), ..args.clone() };
    let files = match &args.out {
        Some(path) => files(path)?,
        None => match args.runs.as_slice() {
            [run] => files(&named(run).1.join("report"))?,
            _ => files(Path::new("comparison"))?,
        },
    };
    for run in args.runs.iter().map(|run| named(run).1) {
        if run.join("sweep.json").is_file() && !run.join("config.toml").is_file() {
            bail!(
                "{0}: a sweep, and no run; `{1} --status` shows its table, `{1}` writes {0}/report.html, and its runs lie \
                 below {0}/jobs",
                run.display(),
                command(["sweep", &shown(&run)])
            );
        }
    }
    for file in &files {
        keep_others(file, Written::Report)?;
        if file.extension().is_some_and(|e| e == "csv") && args.runs.len() > 1 {
            keep_others(&file.with_extension("assets.csv"), Written::Report)?;
        }
    }
    args.charts.as_deref().map_or(Ok(()), no_file)?;
    if let Some(file) = args.eval.as_ref().filter(|file| !file.is_file()) {
        bail!("{}: there is no such evaluation; `riglab eval RUN --out FILE` writes one", file.display());
    }
    let page = match (args.runs.as_slice(), &args.eval) {
        ([run], _) => single(args, &named(run).1, &evaluated_in(args, run))?,
        (_, Some(file)) => bail!("--eval {} is of one run; give that run alone", file.display()),
        (runs, None) => comparison(runs, args.title.as_deref())?,
    };
    let charts = args.charts.as_deref().map_or(Ok(Vec::new()), |folder| charts(&page, folder))?;
    for path in files {
        let text = match path.extension().and_then(|e| e.to_str()) {
            Some("md") => page.to_markdown() + &linked(args, &path),
            Some("tex") => page.to_latex(),
            Some("csv") => page.to_csv(),
            _ => page.to_html()?,
        };
        write(&path, &text)?;
        if let Some(sheet) = page.sheet().filter(|_| path.extension().is_some_and(|e| e == "csv")) {
            write(&path.with_extension("assets.csv"), &sheet)?;
        }
    }
    charts.iter().try_for_each(|(path, content)| write(path, content))?;
    Ok(ExitCode::SUCCESS)
}

/// The evaluation of a run that is shown.
fn evaluated_in(args: &Args, run: &str) -> PathBuf {
    args.eval.clone().unwrap_or_else(|| named(run).1.join("eval.json"))
}

/// Writes a file and names it.
pub fn write(path: &Path, content: impl AsRef<[u8]>) -> Result<()> {
    let written = make_folder_of(path).and_then(|()| riglab_files::write(path, content.as_ref()));
    written.with_context(|| format!("{} cannot be written", path.display()))?;
    say!("{}", path.display());
    Ok(())
}

/// Links of a report in Markdown to the pictures of the run's evaluation, which lie beside it; nothing for several runs.
fn linked(args: &Args, report: &Path) -> String {
    let [run] = args.runs.as_slice() else { return String::new() };
    let evaluated = evaluated_in(args, run);
    let (home, folder) = (evaluated.parent().unwrap_or(Path::new("")), registry::pictures_there(&evaluated));
    let text = std::fs::read_to_string(&evaluated).unwrap_or_default();
    let evaluation: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let of = |shown: &serde_json::Value| {
        let file = format!("{name}/{}", shown["file"].as_str()?);
        let words: Vec<&str> = ["name", "split", "why"].iter().filter_map(|key| shown[key].as_str()).collect();
        let said = if words.is_empty() { file.clone() } else { words.join(", ").replace(['[', ']'], " ") };
        Some((file, said))
    };
    let files: Vec<_> = evaluation["gallery"].as_array().into_iter().flatten().filter_map(of).collect();
    // From elsewhere, by the whole path.
    let beside = report.parent().is_some_and(|folder| folder == home);
    let place = |file: &String| match std::path::absolute(home.join(file)) {
        Ok(whole) if !beside => whole.display().to_string(),
        _ => file.clone(),
    };
    let there = files.iter().filter(|(file, _)| home.join(file).is_file());
    let links: String = there.map(|(file, said)| format!("\n![{said}](<{}>)\n", place(file))).collect();
    if links.is_empty() { links } else { format!("\n## Pictures as files\n{links}") }
}

/// The files to write: one by its ending, all forms without one.
fn files(out: &Path) -> Result<Vec<PathBuf>> {
    let ending = out.extension().map(|e| e.to_string_lossy().into_owned());
    match ending {
        Some(e) if FORMS.contains(&e.as_str()) => Ok(vec![out.into()]),
        // What only looks like an ending, such as `v1.2`, does not: it would be replaced by others.
        Some(e) => bail!("{}: no form has the ending .{e}; there are .{}", out.display(), FORMS.join(", .")),
        None => Ok(FORMS.iter().map(|form| out.with_extension(form)).collect()),
    }
}

/// The report of one run.
fn single(args: &Args, run: &Path, evaluation: &Path) -> Result<Page> {
    let view = RunView::read(run)?;
    let evaluated = registry::evaluation(&view.task(), run, evaluation)?;
    if args.eval.is_some() {
        whose::of_run(evaluation, run, &view)?;
    }
    let subject = evaluated.as_ref().map(|evaluated| ("evaluated".to_string(), subject(evaluated, &view)));
    let mut blocks = vec![view.facts(subject)];
    match evaluated {
        Some(evaluated) => {
            if let Some(note) = outdated(&evaluated, run) {
                tell!("note: {note}");
                blocks.push(Block::Text(note));
            }
            blocks.extend(evaluated.blocks);
            let spread: Vec<Block> = evaluated.findings.iter().flat_map(|f| f.blocks()).collect();
            if !spread.is_empty() {
                blocks.push(Block::Heading("Spread, and what others published".into()));
                blocks.extend(spread);
            }
        }
        None => {
            let none =
                "No checkpoint is the best: none passed guard.worse, or what they are chosen by was never finite. ";
            let none = if without_best(run) { none } else { "" };
            let text = format!("{none}Not evaluated yet; to evaluate it: {}", evaluating(run));
            blocks.push(Block::Text(text.clone()));
            tell!("note: {text}");
        }
    }
    // A model that was exported has none.
    let curves = view.curves();
    if !matches!(&curves, Block::Charts(charts) if charts.is_empty()) {
        blocks.extend([Block::Heading("Training".into()), curves]);
    }
    blocks.extend(view.repeat());
    let title = args.title.clone().unwrap_or_else(|| run.display().to_string());
    Ok(Page { kind: PageKind::Report, title, subtitle: view.subtitle(), blocks })
}

/// The command that evaluates a run: of one that no checkpoint was the best of, as where a guard refused all, the last.
fn evaluating(run: &Path) -> String {
    match without_best(run) {
        true => command(["eval", &shown(run), "--checkpoint", "last"]),
        false => command(["eval", &shown(run)]),
    }
}

/// What the figures are of.
fn subject(evaluated: &Evaluated, view: &RunView) -> String {
    let of =
        |(path, checksum): &(String, String)| format!("{path} ({})", checksum.chars().take(12).collect::<String>());
    let corpora = if evaluated.corpora.is_empty() { view.corpora() } else { evaluated.corpora.clone() };
    let step = evaluated.step.map_or(String::new(), |step| format!("the checkpoint of step {step} on "));
    let with = evaluated.sets.iter().map(|set| format!(", with {set}")).collect::<String>();
    step + &corpora.iter().map(of).collect::<Vec<_>>().join(", ") + &with
}

/// Tells where the run went on after it was evaluated.
fn outdated(evaluated: &Evaluated, run: &Path) -> Option<String> {
    let now = Checkpoints::of(run);
    let (step, best, last) = (evaluated.step?, now.best?, now.last?);
    (step != best && step != last).then(|| {
        format!(
            "The figures are of step {step}, neither the best checkpoint (step {best}) nor the last (step {last}); `{}` \
             evaluates the best.",
            evaluating(run)
        )
    })
}

/// A run's config as this version writes it, so that settings that are written otherwise are not taken for others; `None` of
/// one that it does not understand.
fn rewritten(config: &str) -> Option<String> {
    TaskConfig::read(&presets::parse("config.toml", config, &[]).ok()?).ok()?.to_toml().ok()
}

/// Several runs side by side.
fn comparison(runs: &[String], title: Option<&str>) -> Result<Page> {
    let runs: Vec<(String, PathBuf)> = runs.iter().map(|r| named(r)).collect();
    let (mut compared, mut old) = (Vec::new(), Vec::new());
    for (name, dir) in names(runs)? {
        let view = RunView::read(&dir)?;
        let view = match rewritten(view.config()) {
            Some(config) => view.with_config(config),
            None => view,
        };
        let Some(evaluated) = registry::evaluation(&view.task(), &dir, &dir.join("eval.json"))? else {
            let first = evaluating(&dir);
            bail!("{}: not evaluated yet, there is nothing to compare; run `{first}` first", dir.display());
        };
        if let Some(note) = outdated(&evaluated, &dir) {
            tell!("note: {name}: {note}");
            old.push(Block::Text(format!("{name}: {note}")));
        }
        // Older evaluations do not say what they saw: it was what the run was trained on.
        let corpora = if evaluated.corpora.is_empty() { view.corpora() } else { evaluated.corpora };
        let (step, sets, warning) = (evaluated.step, evaluated.sets, evaluated.warning);
        compared.push(Compared { name, view, corpora, step, sets, warning, findings: evaluated.findings });
    }
    let mut blocks = old;
    blocks.extend(versus(&compared)?);
    blocks.push(Block::Heading("To repeat it".into()));
    for run in &compared {
        blocks.push(Block::Text(format!("{}:", run.name)));
        blocks.extend(run.view.repeat().into_iter().filter(|b| !matches!(b, Block::Heading(_))));
    }
    let names: Vec<&str> = compared.iter().map(|c| c.name.as_str()).collect();
    let title = title.map_or_else(|| "Comparison".into(), String::from);
    let assets = compared.first().map_or(0, |c| c.findings.iter().map(|f| f.singles.len()).max().unwrap_or(0));
    let corpora = compared.first().map(|c| c.corpora.iter().map(|(path, _)| path.as_str()).collect::<Vec<_>>());
    // Some evaluations hold totals alone.
    let count = if assets == 0 { String::new() } else { format!("{assets} ") };
    let subtitle = format!(
        "{}: the same {count}assets of {}; the others are tested against {}",
        names.join(", "),
        corpora.unwrap_or_default().join(", "),
        names.first().unwrap_or(&"")
    );
    Ok(Page { kind: PageKind::Report, title, subtitle, blocks })
}

/// The name of a run and its folder; without a name, an empty one.
fn named(text: &str) -> (String, PathBuf) {
    match text.split_once('=') {
        Some((name, dir)) if !name.is_empty() && !Path::new(text).exists() => (name.into(), dir.into()),
        _ => (String::new(), text.into()),
    }
}

/// Without the files that a pattern of a shell, such as `sweeps/NAME/jobs/*/*`, finds among the runs' folders.
fn folders(runs: &[String]) -> Vec<String> {
    let (files, folders): (Vec<String>, Vec<String>) = runs.iter().cloned().partition(|run| named(run).1.is_file());
    if files.is_empty() || folders.is_empty() {
        return runs.to_vec();
    }
    tell!("note: left out, being files and not runs' folders: {}", some_of(&files));
    folders
}

/// Names for runs that have none: the last parts of their paths, of all runs as many as tell them apart, as
/// `with/seed-0`, `with/seed-1` and `without/seed-0`.
fn names(runs: Vec<(String, PathBuf)>) -> Result<Vec<(String, PathBuf)>> {
    let with = |parts: usize| -> Vec<String> {
        runs.iter().map(|(name, dir)| if name.is_empty() { tail(dir, parts) } else { name.clone() }).collect()
    };
    let doubled = |all: &[String]| all.iter().enumerate().find(|(k, name)| all[..*k].contains(name)).map(|(k, _)| k);
    let most = runs.iter().map(|(_, dir)| dir.components().count()).max().unwrap_or(1);
    let told = (1..=most).map(with).find(|all| doubled(all).is_none()).unwrap_or_else(|| with(most));
    if let Some(k) = doubled(&told) {
        bail!("two runs are called `{}`; name them: NAME=RUN", told[k]);
    }
    Ok(told.into_iter().zip(runs.into_iter().map(|(_, dir)| dir)).collect())
}

/// The last parts of a path, so many of them.
fn tail(dir: &Path, parts: usize) -> String {
    let all: Vec<_> = dir.components().collect();
    all[all.len().saturating_sub(parts)..].iter().collect::<PathBuf>().display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_ending_names_the_form_and_none_takes_all() {
        assert_eq!(files(Path::new("a/b.tex")).unwrap(), [Path::new("a/b.tex")]);
        let all = files(Path::new("a/b")).unwrap();
        assert_eq!(all, ["a/b.html", "a/b.md", "a/b.tex", "a/b.csv"].map(PathBuf::from));
        let e = files(Path::new("a.pdf")).unwrap_err().to_string();
        assert!(e.contains(".pdf") && e.contains(".html, .md, .tex, .csv"), "{e}");
    }

    #[test]
    fn a_run_without_a_best_checkpoint_is_evaluated_at_its_last() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("my run");
        std::fs::create_dir_all(run.join("checkpoints/last")).unwrap();
        let quoted = format!("riglab eval '{}'", run.display());
        assert_eq!(evaluating(&run), format!("{quoted} --checkpoint last"));
        std::fs::create_dir_all(run.join("checkpoints/best")).unwrap();
        assert_eq!(evaluating(&run), quoted);
    }

    #[test]
    fn settings_written_by_another_version_are_the_same() {
        let of = |weights: &str| rewritten(&format!("task = 'grpo'\n[reward]\nweights = {weights}\n"));
        let list = of("[4.0, 1.0, 1.0, 1.0]");
        assert!(list.is_some() && list == of("{ coverage = 4.0 }") && list != of("{ coverage = 5.0 }"));
        assert_eq!(rewritten("task = 'unknown'"), None);
    }

    #[test]
    fn files_among_runs_are_left_out() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name).display().to_string();
        let (run, file, missing) = (path("a"), path("job.log"), path("b"));
        std::fs::create_dir(&run).unwrap();
        std::fs::write(&file, "").unwrap();
        // What is nowhere stays, to be missed.
        assert_eq!(folders(&[run.clone(), file.clone(), missing.clone()]), [run, missing]);
        assert_eq!(folders(std::slice::from_ref(&file)), [&file[..]]);
    }

    #[test]
    fn runs_are_told_apart() {
        let of = |texts: &[&str]| {
            let named: Vec<_> = texts.iter().map(|t| named(t)).collect();
            names(named).map(|all| all.into_iter().map(|(name, _)| name).collect::<Vec<_>>())
        };
        assert_eq!(of(&["runs/x/001", "runs/x/002"]).unwrap(), ["001", "002"]);
        assert_eq!(of(&["runs/x/001", "runs/y/001"]).unwrap(), ["x/001", "y/001"]);
        // Each as the others: a short name among long ones does not say whose it is.
        let seeds = ["jobs/with/seed-0", "jobs/with/seed-1", "jobs/without/seed-0"];
        assert_eq!(of(&seeds).unwrap(), ["with/seed-0", "with/seed-1", "without/seed-0"]);
        assert_eq!(of(&["a/001", "b/a/001"]).unwrap(), ["a/001", "b/a/001"]);
        assert_eq!(of(&["001=runs/x/1", "runs/x/001"]).unwrap(), ["001", "x/001"]);
        assert!(of(&["runs/x", "runs/x"]).unwrap_err().to_string().contains("`runs/x`"));
        assert_eq!(of(&["a=runs/x/001", "runs/y/001"]).unwrap(), ["a", "001"]);
        assert!(of(&["a=x", "a=y"]).unwrap_err().to_string().contains("`a`"));
    }
}
