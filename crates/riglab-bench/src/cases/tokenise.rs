//! Skeletons as tokens and back, against UniRig's released algorithm in Python with numpy.
//!
//! Both sides have the rigs' skeletons as arrays and write and read the same sequences, which are compared, as are
//! the trees that come back. `tokenise/default` has riglab's own preset on our side, which also finds templates by
//! names, sorts siblings and keeps trees apart.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use riglab_data::Corpus;
use riglab_token::{Bones, Preset, Template, Tokenizer, TokenizerConfig};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};

use super::Context;
use crate::python::ARRAYS;
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

/// How often ours goes over all skeletons in a round; theirs takes long enough with one.
const TIMES: usize = 20;

#[derive(Deserialize, Serialize)]
struct Skeleton {
    joints: Vec<[f64; 3]>,
    parents: Vec<Option<usize>>,
    names: Vec<String>,
    class: Option<String>,
}

impl Skeleton {
    fn bones(&self) -> Bones<'_> {
        Bones { joints: &self.joints, parents: &self.parents, names: &self.names }
    }
}

#[derive(Deserialize, Serialize)]
struct Ran {
    seconds: f64,
    joints: usize,
}

/// The release, with a class for all that are of no template.
fn released() -> TokenizerConfig {
    Preset::UnirigReleased.config()
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let Some(corpus) = context.corpus()? else { return Ok(vec![Row::skipped("tokenise", recipe::NO_RIGS)]) };
    let file = context.path("skeletons.json");
    let (mut ours, mut theirs) = (context.ours("tokenise")?, ARRAYS.start("unirig_tokens.py")?);
    let a: Vec<Vec<u32>> = ours.ask(&json!({"do": "open", "corpus": corpus, "file": file}))?;
    let tokenizer = Tokenizer::new(released());
    let (ids, templates) = named(&tokenizer);
    let b: Vec<Vec<u32>> = theirs.ask(&json!({"do": "open", "file": file, "ids": ids, "templates": templates}))?;
    let differ = a.iter().zip(&b).filter(|(a, b)| a != b).count();
    ensure!(a.len() == b.len() && differ == 0, "{differ} of {} sequences differ", a.len());
    let c: Vec<Vec<Option<usize>>> = ours.ask(&json!({"do": "parents"}))?;
    let d: Vec<Vec<Option<usize>>> = theirs.ask(&json!({"do": "parents"}))?;
    ensure!(c == d, "other trees come back");
    let mut rows = Vec::new();
    for (label, preset) in [("tokenise", "released"), ("tokenise/default", "default")] {
        let rate = |ran: Ran, times: usize| 1e6 * ran.seconds / (times * a.len()) as f64;
        let one = json!({"do": "run", "times": TIMES, "preset": preset});
        let other = json!({"do": "run", "times": 1});
        let _: (Ran, Ran) = (ours.ask(&one)?, theirs.ask(&other)?);
        let found =
            in_turn(context.rounds(7), || Ok(rate(ours.ask(&one)?, TIMES)), || Ok(rate(theirs.ask(&other)?, 1)))?;
        let (x, y) = found.medians();
        let tokens = a.iter().map(Vec::len).sum::<usize>() as f64 / a.len() as f64;
        let note = format!("one thread, {} skeletons, {tokens:.0} tokens on average; {}", a.len(), found.spread());
        rows.push(Row::new(label, x, y, "µs/skeleton", Better::Lower).bar(50.0).note(note));
    }
    Ok(rows)
}

/// The tokens and templates as the other side knows them.
fn named(tokenizer: &Tokenizer) -> (Value, Value) {
    let (ids, config) = (tokenizer.vocabulary(), tokenizer.config());
    let parts: Map<String, Value> =
        config.parts.iter().enumerate().map(|(k, name)| (name.clone(), json!(ids.part(k)))).collect();
    let classes: Map<String, Value> =
        ids.classes().iter().enumerate().map(|(k, name)| (name.clone(), json!(ids.class(k)))).collect();
    let of =
        |t: &Template| -> Map<String, Value> { t.parts.iter().map(|p| (p.name.to_owned(), json!(p.joints))).collect() };
    let templates: Map<String, Value> = Template::ALL.iter().map(|t| (t.class.to_owned(), of(t).into())).collect();
    let all = json!({"bins": config.bins, "branch": ids.branch(), "bos": ids.bos(), "eos": ids.eos(),
                     "spring": ids.spring(), "none": ids.no_class(), "parts": parts, "classes": classes});
    (all, templates.into())
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { corpus: PathBuf, file: PathBuf },
    Parents,
    Run { times: usize, preset: String },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let mut skeletons: Vec<Skeleton> = Vec::new();
    let [released, default] = [released(), TokenizerConfig::default()].map(Tokenizer::new);
    side::serve(|request| match request {
        Request::Open { corpus, file } => {
            let corpus = Corpus::open(&corpus)?;
            let mut ids = Vec::new();
            for index in 0..corpus.len() {
                let own = skeleton(&corpus, index)?;
                // Bodies whose joints hang on each other in another order are refused by the release.
                if let Ok(encoded) = released.encode_bones(&own.bones(), own.class.as_deref())
                    && own.joints.len() > 1
                {
                    ids.push(encoded.ids);
                    skeletons.push(own);
                }
            }
            std::fs::write(file, serde_json::to_vec(&skeletons)?)?;
            Ok(json!(ids))
        }
        Request::Parents => {
            let back = |s: &Skeleton| -> Result<_> {
                let encoded = released.encode_bones(&s.bones(), s.class.as_deref())?;
                Ok(released.decode(&encoded.ids)?.parents)
            };
            Ok(json!(skeletons.iter().map(back).collect::<Result<Vec<_>>>()?))
        }
        Request::Run { times, preset } => {
            let own = preset == "default";
            let tokenizer = if own { &default } else { &released };
            let (start, mut joints) = (Instant::now(), 0);
            for _ in 0..times {
                for s in &skeletons {
                    let class = s.class.as_deref().filter(|_| !own);
                    let encoded = tokenizer.encode_bones(&s.bones(), class).context("a skeleton")?;
                    let decoded = tokenizer.decode(&encoded.ids)?;
                    joints += decoded.tails().len();
                }
            }
            Ok(json!(Ran { seconds: start.elapsed().as_secs_f64(), joints }))
        }
    })
}

fn skeleton(corpus: &Corpus, index: usize) -> Result<Skeleton> {
    let (rig, _) = corpus.asset(index)?.rig.normalized();
    let s = rig.skeleton();
    let class = Template::detect(s.names()).map_or("articulationxl", |t| t.class);
    Ok(Skeleton {
        joints: s.heads().iter().map(|p| p.map(f64::from)).collect(),
        parents: s.parents().iter().map(|p| p.map(riglab_core::JointId::index)).collect(),
        names: s.names().to_vec(),
        class: Some(class.into()),
    })
}
