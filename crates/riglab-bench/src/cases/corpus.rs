//! A corpus of 100,000 assets: what one more costs as it grows, the memory it takes, and how fast it is read.
//!
//! Nothing usual keeps rigs so, so there is no other side: its column holds what is asked for, or, for the cost, the
//! same over the first ten thousand. The assets are small creatures, made outside of what is timed; one process writes
//! them, a second one opens what was written.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, ensure};
use rayon::prelude::*;
use riglab_core::Asset;
use riglab_data::{Corpus, CorpusWriter, Splitter};
use riglab_random::{Draw, stream};
use riglab_report::{Chart, Series};
use riglab_synth::{Options, Plan, creature};
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::Context;
use crate::rounds::median;
use crate::row::{Better, Row};
use crate::side;

const NAME: &str = "corpus/100000";
const COUNT: usize = 100_000;
/// Assets over which a cost is taken.
const WINDOW: usize = 1_000;
/// Windows that a point of the picture is the mean of.
const DRAWN: usize = 5;
/// Made at once, before they are written.
const AT_ONCE: usize = 250;
/// Assets read, wherever they stand.
const READ: usize = 2_000;
/// What is asked for: MB at most, seconds for opening, milliseconds for an asset.
const MEMORY: f64 = 2_000.0;
const OPEN: f64 = 1.0;
const ASSET: f64 = 2.0;
/// How far the cost of the last may be from that of the first and still be called the same.
const FLAT: f64 = 0.8;

/// What writing came to.
#[derive(Deserialize, Serialize)]
struct Written {
    /// Milliseconds an asset, window by window.
    costs: Vec<f64>,
    /// MB at most so far, at the end of each.
    memory: Vec<f64>,
    /// Seconds of the end: names, splits, and the last rows on the disk.
    finish: f64,
    megabytes: f64,
}

/// What reading came to.
#[derive(Deserialize, Serialize)]
struct Opened {
    /// Seconds until an asset can be asked for.
    open: f64,
    /// Milliseconds for each asset.
    assets: Vec<f64>,
    memory: f64,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let path = context.path("many.h5");
    let ask = json!({"do": "write", "path": path, "threads": context.threads});
    let written: Written = context.ours("corpus")?.ask(&ask)?;
    let opened: Opened = context.ours("corpus")?.ask(&json!({"do": "read", "path": path}))?;
    ensure!(written.costs.len() == COUNT / WINDOW && opened.assets.len() == READ, "not all was measured");
    if let Some(picture) = context.picture("corpus_100000.svg") {
        riglab_files::write(&picture, chart(&written).to_svg()?.as_bytes())?;
    }
    // A tenth of the windows on each side, so that one disturbed window does not decide.
    let tenth = written.costs.len() / 10;
    let (first, last) = (median(&written.costs[..tenth]), median(&written.costs[written.costs.len() - tenth..]));
    let memory = written.memory.iter().copied().fold(0.0, f64::max).max(opened.memory);
    let slowest = opened.assets.iter().copied().fold(0.0, f64::max);
    let about =
        format!("{COUNT} small creatures, {:.0} MB on disk, finished in {:.2} s", written.megabytes, written.finish);
    Ok(vec![
        Row::new(format!("{NAME}/cost"), last, first, "ms an asset", Better::Lower)
            .bar(FLAT)
            .note(format!("the last {} against the first; {about}", tenth * WINDOW)),
        Row::new(format!("{NAME}/memory"), memory, MEMORY, "MB", Better::Lower).bar(1.0).note(format!(
            "the other side is what is asked for; {:.0} MB after {WINDOW}, {:.0} MB reading",
            written.memory[0], opened.memory
        )),
        Row::new(format!("{NAME}/open"), opened.open, OPEN, "s", Better::Lower)
            .bar(1.0)
            .note("the other side is what is asked for"),
        Row::new(format!("{NAME}/asset"), median(&opened.assets), ASSET, "ms", Better::Lower)
            .bar(1.0)
            .note(format!("the other side is what is asked for; {READ} drawn, the slowest {slowest:.2} ms")),
    ])
}

/// What an asset costs as the corpus grows.
fn chart(written: &Written) -> Chart {
    let mean = |(k, costs): (usize, &[f64])| {
        let assets = (k + 1) * DRAWN * WINDOW;
        (assets as f64, costs.iter().sum::<f64>() / costs.len() as f64)
    };
    Chart {
        title: "Milliseconds to write one more asset".into(),
        x: "assets in the corpus".into(),
        series: vec![Series {
            name: "writing".into(),
            points: written.costs.chunks(DRAWN).enumerate().map(mean).collect(),
        }],
        ..Chart::default()
    }
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Write { path: PathBuf, threads: usize },
    Read { path: PathBuf },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    side::serve(|request: Request| match request {
        Request::Write { path, threads } => Ok(serde_json::to_value(write(&path, threads)?)?),
        Request::Read { path } => Ok(serde_json::to_value(read(&path)?)?),
    })
}

fn write(path: &Path, threads: usize) -> Result<Written> {
    let plans = vec![Plan::Prop, Plan::Machine, Plan::Fish, Plan::Snake];
    let options = Options { plans, triangles: 100..=300 };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let mut writer = CorpusWriter::create(path)?;
    let mut found = Written { costs: Vec::new(), memory: Vec::new(), finish: 0.0, megabytes: 0.0 };
    let mut keys = Vec::new();
    let mut spent = 0.0;
    for from in (0..COUNT).step_by(AT_ONCE) {
        let made: Vec<Asset> =
            pool.install(|| (from..from + AT_ONCE).into_par_iter().map(|k| creature(0, k as u64, &options)).collect());
        let start = Instant::now();
        for asset in &made {
            writer.add(asset)?;
            keys.push(Splitter::key(asset));
        }
        spent += start.elapsed().as_secs_f64();
        if (from + AT_ONCE).is_multiple_of(WINDOW) {
            found.costs.push(1e3 * std::mem::take(&mut spent) / WINDOW as f64);
            found.memory.push(side::peak_memory_mb());
        }
    }
    let start = Instant::now();
    writer.finish(&Splitter::ByTopology(0).assign(&keys))?;
    found.finish = start.elapsed().as_secs_f64();
    found.memory.push(side::peak_memory_mb());
    found.megabytes = std::fs::metadata(path)?.len() as f64 / 1e6;
    Ok(found)
}

fn read(path: &Path) -> Result<Opened> {
    let start = Instant::now();
    let corpus = Corpus::open(path)?;
    let open = start.elapsed().as_secs_f64();
    ensure!(corpus.len() == COUNT, "{} assets", corpus.len());
    let mut random = stream(0, "bench_corpus", &[]);
    let mut one = |_| -> Result<f64> {
        let start = Instant::now();
        let asset = corpus.asset(random.below(COUNT))?;
        ensure!(!asset.rig.mesh().triangles().is_empty(), "an empty asset");
        Ok(1e3 * start.elapsed().as_secs_f64())
    };
    let assets = (0..READ).map(&mut one).collect::<Result<_>>()?;
    Ok(Opened { open, assets, memory: side::peak_memory_mb() })
}
