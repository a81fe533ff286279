//! `riglab tokens`

use std::collections::{BTreeMap, HashSet};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;

use anyhow::{Result, bail};
use rayon::prelude::*;
use riglab_asset::{ImportOptions, import_each};
use riglab_core::Asset;
use riglab_data::Corpus;
use riglab_token::{Encoded, Grammar, Limits, Parents, Preset, Tokenizer, naive_length};
use riglab_train::Progress;
use serde_json::json;

/// Show skeletons as tokens: the sequence in words, what it saves, and what a round trip costs.
///
/// Of a file, the sequence. Of a corpus, a table by category as UniRig has it: tokens of the plain format
/// (every joint with its parent's coordinates), tokens of this one, how far joints come back from where
/// they were. Assets are set into the cube from -1 to 1 first.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab tokens fox.glb
  riglab tokens corpus.h5
  riglab tokens corpus.h5 --preset unirig-released --json")]
pub struct Args {
    /// Rigged files or corpora.
    #[arg(required = true)]
    inputs: Vec<PathBuf>,
    /// How skeletons become tokens.
    #[arg(long, value_enum, default_value = "riglab")]
    preset: Tokens,
    /// The class to write for every asset [default: with the preset riglab what the joints' names tell, with others none].
    #[arg(long, value_name = "NAME")]
    class: Option<String>,
    /// Print as JSON: a line an asset of a file, a line a category of a corpus, and a line for each that has no sequence, with
    /// the reason.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Tokens {
    /// Unbiased, every tree told apart.
    Riglab,
    /// UniRig's paper.
    Paper,
    /// UniRig's release.
    UnirigReleased,
    /// SkinTokens' release.
    SkintokensReleased,
}

impl Tokens {
    fn preset(self) -> Preset {
        match self {
            Self::Riglab => Preset::Riglab,
            Self::Paper => Preset::Paper,
            Self::UnirigReleased => Preset::UnirigReleased,
            Self::SkintokensReleased => Preset::SkintokensReleased,
        }
    }
}

/// What a round trip of an asset shows.
struct Trip {
    joints: usize,
    tokens: usize,
    /// Mean distance of joints from where they were, in the cube.
    error: f64,
    /// Joints that came back below another parent.
    astray: usize,
    moved: usize,
    /// Joints outside the range, written at its border.
    clamped: usize,
    /// Whether the strict grammar takes the sequence.
    strict: bool,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let tokenizer = Tokenizer::new(args.preset.preset().config());
    if let Some(class) = args.class.as_deref().filter(|c| tokenizer.vocabulary().class_named(c).is_none()) {
        bail!("--class {class}: this preset has the classes {}", tokenizer.vocabulary().classes().join(", "));
    }
    let mut failed = false;
    for input in &args.inputs {
        if let Ok(corpus) = Corpus::open(input) {
            match of_corpus(&corpus, &tokenizer, args) {
                Ok(whole) => failed |= !whole,
                Err(e) => {
                    tell!("error: {e:#}");
                    failed = true;
                }
            }
            continue;
        }
        import_each(input, &ImportOptions::default(), |imported| {
            match imported.and_then(riglab_asset::Imported::into_asset) {
                Ok(asset) => {
                    if let Err(e) = show(&asset, &tokenizer, args) {
                        tell!("error: {}: {e:#}", asset.provenance.source);
                        refused(args, json!({"file": input, "name": asset.name, "error": format!("{e:#}")}));
                        failed = true;
                    }
                }
                Err(e) => {
                    tell!("error: {e}");
                    refused(args, json!({"file": input, "error": e.to_string()}));
                    failed = true;
                }
            }
            ControlFlow::Continue(())
        });
    }
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Tells who reads lines of JSON what has no sequence.
fn refused(args: &Args, line: serde_json::Value) {
    if args.json {
        say!("{line}");
    }
}

fn trip(asset: &Asset, tokenizer: &Tokenizer, class: Option<&str>) -> Result<(Encoded, Trip)> {
    let (rig, _) = asset.rig.normalized();
    let skeleton = rig.skeleton();
    let encoded = tokenizer.encode(skeleton, class)?;
    let decoded = tokenizer.decode(&encoded.ids)?;
    let mut place = vec![0; encoded.order.len()];
    encoded.order.iter().enumerate().for_each(|(at, &j)| place[j] = at);
    let (mut error, mut astray) = (0.0, 0);
    for (at, &joint) in encoded.order.iter().enumerate() {
        let (was, is) = (skeleton.heads()[joint], decoded.joints[at]);
        error += (0..3).map(|k| f64::from(is[k] - was[k]).powi(2)).sum::<f64>().sqrt();
        astray += usize::from(decoded.parents[at] != skeleton.parents()[joint].map(|p| place[p.index()]));
    }
    let joints = skeleton.len();
    let limits = Limits { joints, tokens: encoded.ids.len() };
    let mut grammar = Grammar::new(tokenizer, limits, Parents::Anywhere);
    let strict = encoded.ids.iter().all(|&id| grammar.advance(id).is_ok()) && grammar.is_done();
    let (tokens, moved, clamped) = (encoded.ids.len(), encoded.moved, encoded.clamped);
    let trip = Trip { joints, tokens, error: error / joints as f64, astray, moved, clamped, strict };
    Ok((encoded, trip))
}

fn show(asset: &Asset, tokenizer: &Tokenizer, args: &Args) -> Result<()> {
    let (encoded, trip) = trip(asset, tokenizer, args.class.as_deref())?;
    let words: Vec<String> = encoded.ids.iter().map(|&id| tokenizer.vocabulary().word(id)).collect();
    let plain = naive_length(trip.joints);
    let saved = 100.0 * (1.0 - trip.tokens as f64 / plain as f64);
    if args.json {
        say!(
            "{}",
            json!({"name": asset.name, "joints": trip.joints, "ids": encoded.ids, "words": words, "order": encoded.order,
            "plain": plain, "saved_percent": saved, "joint_error": trip.error, "astray": trip.astray, "moved": trip.moved,
            "clamped": trip.clamped})
        );
        return Ok(());
    }
    say!("{}  ({} joints, {} tokens; plain {plain}, {saved:.1} % saved)", asset.name, trip.joints, trip.tokens);
    say!("  {}", lines(&words).join("\n  "));
    say!(
        "  round trip: joints {:.5} off on average, {} with another parent, {} moved to a free cell, {} clamped to the \
         border",
        trip.error,
        trip.astray,
        trip.moved,
        trip.clamped
    );
    Ok(())
}

/// A line a joint.
fn lines(words: &[String]) -> Vec<String> {
    let mut lines: Vec<String> = vec![String::new()];
    let mut numbers = 0;
    let mut width = 3;
    for word in words {
        let number = !word.starts_with('<');
        if number && numbers == width || !number && numbers > 0 {
            lines.push(String::new());
            (numbers, width) = (0, 3);
        }
        if word == "<branch>" {
            width = 6;
        }
        numbers += usize::from(number);
        let line = lines.last_mut().expect("there is a line");
        if !line.is_empty() {
            line.push_str(if number && numbers == 4 { " > " } else { " " });
        }
        line.push_str(word);
    }
    lines
}

/// Sums over assets of a category.
#[derive(Default)]
struct Sum {
    assets: usize,
    plain: usize,
    tokens: usize,
    error: f64,
    astray: usize,
    moved: usize,
    clamped: usize,
    loose: usize,
}

impl Sum {
    fn add(&mut self, trip: &Trip) {
        self.assets += 1;
        self.plain += naive_length(trip.joints);
        self.tokens += trip.tokens;
        self.error += trip.error;
        self.astray += usize::from(trip.astray > 0);
        self.moved += trip.moved;
        self.clamped += trip.clamped;
        self.loose += usize::from(!trip.strict);
    }
}

/// Whether all assets with a rig have a sequence.
fn of_corpus(corpus: &Corpus, tokenizer: &Tokenizer, args: &Args) -> Result<bool> {
    let (categories, bare) = (corpus.texts("category")?, HashSet::<usize>::from_iter(corpus.bare()?));
    if !bare.is_empty() {
        let meshes = if bare.len() == 1 { "mesh" } else { "meshes" };
        tell!("note: {}: {} {meshes} without a rig left out", corpus.path().display(), bare.len());
    }
    let progress = Mutex::new((Progress::new("encoding", (corpus.len() - bare.len()) as u64, 0), 0));
    let trips: Vec<(usize, Result<Trip>)> = (0..corpus.len())
        .into_par_iter()
        .filter(|index| !bare.contains(index))
        .map(|index| {
            let found = corpus.asset(index).map_err(anyhow::Error::from);
            let found = found.and_then(|asset| trip(&asset, tokenizer, args.class.as_deref())).map(|(_, trip)| trip);
            if let Ok(mut progress) = progress.lock() {
                let (shown, done) = &mut *progress;
                *done += 1;
                shown.set(*done, String::new);
            }
            (index, found)
        })
        .collect();
    if let Ok((mut progress, _)) = progress.into_inner() {
        progress.finish();
    }
    let (mut sums, mut all, names) = (BTreeMap::<&str, Sum>::new(), Sum::default(), corpus.names()?);
    for (index, found) in &trips {
        match found {
            Ok(trip) => {
                sums.entry(&categories[*index]).or_default().add(trip);
                all.add(trip);
            }
            Err(e) => {
                tell!("left out: {}: {e:#}", names[*index]);
                refused(args, json!({"corpus": corpus.path(), "name": names[*index], "error": format!("{e:#}")}));
            }
        }
    }
    if all.assets == 0 {
        bail!("{}: no asset has a sequence", corpus.path().display());
    }
    if !args.json {
        say!("{}", corpus.path().display());
        say!(
            "{:20} {:>7} {:>9} {:>9} {:>8} {:>12} {:>7} {:>6} {:>7} {:>7}",
            "category",
            "assets",
            "plain",
            "tokens",
            "saved %",
            "joint error",
            "astray",
            "moved",
            "clamped",
            "refused"
        );
    }
    for (name, sum) in
        sums.iter().map(|(name, sum)| (if name.is_empty() { "none" } else { name }, sum)).chain([("all", &all)])
    {
        let n = sum.assets as f64;
        let (plain, tokens, error) = (sum.plain as f64 / n, sum.tokens as f64 / n, sum.error / n);
        let saved = 100.0 * (1.0 - tokens / plain);
        if args.json {
            say!(
                "{}",
                json!({"corpus": corpus.path(), "category": name, "assets": sum.assets, "plain": plain, "tokens": tokens, "saved_percent": saved,
                "joint_error": error, "astray_assets": sum.astray, "moved_joints": sum.moved, "clamped_joints": sum.clamped, "refused_by_grammar": sum.loose})
            );
        } else {
            say!(
                "{name:20} {:>7} {plain:>9.2} {tokens:>9.2} {saved:>8.2} {error:>12.6} {:>7} {:>6} {:>7} {:>7}",
                sum.assets,
                sum.astray,
                sum.moved,
                sum.clamped,
                sum.loose
            );
        }
    }
    if !args.json {
        say!(
            "plain and tokens: mean length of a sequence; joint error: mean distance of joints after the round trip, in a cube \
             from -1 to 1; astray: assets with another topology after it; moved and clamped: joints set to a free cell, or \
             to the border of the range; refused: by the strict grammar"
        );
    }
    let without = trips.iter().filter(|(_, found)| found.is_err()).count();
    if without > 0 {
        tell!("warning: {without} of {} assets have no sequence, for the reasons above", trips.len());
    }
    Ok(without == 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_a_joint() {
        let words = "<bos> <mixamo> <body> 1 2 3 4 5 6 <branch> 1 2 3 7 8 9 <spring> 1 1 1 <eos>";
        let words: Vec<String> = words.split(' ').map(str::to_owned).collect();
        let wanted = ["<bos> <mixamo> <body> 1 2 3", "4 5 6", "<branch> 1 2 3 > 7 8 9", "<spring> 1 1 1", "<eos>"];
        assert_eq!(lines(&words), wanted);
    }
}
