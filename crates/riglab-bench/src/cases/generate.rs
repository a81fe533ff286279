//! Sequences drawn by a decoder behind a shape's tokens (UniRig's skeleton model, TokenRig), against transformers'
//! `generate` with the same weights.
//!
//! Both sides start from what the decoder reads of a mesh, draw under the strict grammar with UniRig's sampling
//! (temperature 1.5, top-k 5, top-p 0.95, repetition penalty 3), in fp32 with a cache, and stop where all
//! sequences have ended. The weights are those of the start of a training, so sequences end where the limits make
//! them: these are set so that lengths are about those of the rigs. Before times are taken, both take the likeliest
//! tokens, which must be the same; and the strict grammar of ours must take what theirs has drawn.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result, anyhow, ensure};
use riglab_nn::generate::GenerateConfig;
use riglab_token::{Tokenizer, TokenizerConfig, Vocabulary};
use riglab_train::Precision;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value, json};
use tch::Tensor;

use super::Context;
use super::subject::Subject;
use crate::python::TRANSFORMERS;
use crate::recipe;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side::{self, Side};

/// Likeliest tokens that are compared: further on, scores that are equal but for rounding may change places.
const COMPARED: usize = 60;

#[derive(Deserialize, Serialize)]
struct Drawn {
    seconds: f64,
    ids: Vec<Vec<u32>>,
}

#[derive(Deserialize, Serialize)]
struct Opened {
    settings: Value,
    tokenizer: TokenizerConfig,
    ends: Map<String, Value>,
}

/// UniRig's settings at inference, without its beams.
fn sampling(tokens: usize) -> GenerateConfig {
    GenerateConfig {
        tokens,
        sample: true,
        temperature: 1.5,
        top_k: 5,
        top_p: 0.95,
        repetition_penalty: 3.0,
        ..GenerateConfig::default()
    }
}

pub fn run<S: Subject>(context: &mut Context, rows: usize) -> Result<Vec<Row>> {
    let label = format!("generate/{}/b{rows}", S::NAME);
    let Some(corpus) = context.corpus()? else { return Ok(vec![Row::skipped(label, recipe::NO_RIGS)]) };
    let file = context.path(&format!("generate-{}-{rows}.safetensors", S::NAME));
    let (mut ours, mut theirs) = (context.ours(S::SIDES[1])?, TRANSFORMERS.start(S::DRAWS)?);
    let open = json!({"do": "open", "file": file, "corpus": corpus, "rows": rows, "threads": context.threads});
    let known: Opened = ours.ask(&open)?;
    let tokenizer = Tokenizer::new(known.tokenizer);
    let mut vocabulary = named(tokenizer.vocabulary());
    vocabulary.extend(known.ends);
    let sampling = || sampling(S::LIMITS.tokens);
    let open = json!({"do": "open", "file": file, "config": known.settings, "threads": context.threads,
                      "vocabulary": vocabulary});
    theirs.ask::<Value>(&open)?;
    let ask =
        |generate: &GenerateConfig, seed: u64| json!({"do": "draw", "rows": rows, "generate": generate, "seed": seed});
    let greedy = ask(&GenerateConfig { sample: false, repetition_penalty: 1.0, ..sampling() }, 0);
    let (a, b): (Drawn, Drawn) = (ours.ask(&greedy)?, theirs.ask(&greedy)?);
    let start = |d: &Drawn| d.ids[0].iter().take(COMPARED).copied().collect::<Vec<_>>();
    ensure!(start(&a) == start(&b), "the likeliest tokens differ: {:?} and {:?}", start(&a), start(&b));
    let fused = fused_is_faster(&mut theirs, &greedy)?;
    let (mut lengths, mut seed) = ([(0, 0); 2], 0);
    let rate = |drawn: Drawn, lengths: &mut (usize, usize)| -> Result<f64> {
        let tokens: usize = drawn.ids.iter().map(Vec::len).sum();
        *lengths = (lengths.0 + tokens, lengths.1 + drawn.ids.len());
        for ids in &drawn.ids {
            S::check(&known.settings, &tokenizer, ids)?;
        }
        Ok(tokens as f64 / drawn.seconds)
    };
    let [own, other] = &mut lengths;
    let mut next = || {
        seed += 1;
        ask(&sampling(), seed)
    };
    let requests: Vec<Value> = (0..=context.rounds(if rows == 1 { 9 } else { 5 })).map(|_| next()).collect();
    let (mut a, mut b) = (requests.iter(), requests.iter());
    // The first ones warm up.
    let one = a.next().context("a request")?;
    rate(ours.ask(one)?, own)?;
    rate(theirs.ask(b.next().context("a request")?)?, other)?;
    let found = in_turn(
        requests.len() - 1,
        || rate(ours.ask(a.next().context("a request")?)?, own),
        || rate(theirs.ask(b.next().context("a request")?)?, other),
    )?;
    let (x, y) = found.medians();
    let mean = |(tokens, count): (usize, usize)| tokens as f64 / count as f64;
    let note = format!(
        "{} threads, sequences of {:.0} and {:.0} tokens on average; theirs takes {} for attention, the faster one; {}",
        context.threads,
        mean(lengths[0]),
        mean(lengths[1]),
        if fused { "the fused kernel" } else { "plain products" },
        found.spread()
    );
    Ok(vec![Row::new(label, x, y, "tokens/s", Better::Higher).bar(3.0).note(note)])
}

/// Tries both kinds of attention, and leaves the faster one.
fn fused_is_faster(theirs: &mut Side, request: &Value) -> Result<bool> {
    let mut seconds = [f64::INFINITY; 2];
    for _ in 0..3 {
        for fused in [true, false] {
            theirs.ask::<Value>(&json!({"do": "attend", "fused": fused}))?;
            let best = &mut seconds[usize::from(fused)];
            *best = best.min(theirs.ask::<Drawn>(request)?.seconds);
        }
    }
    let fused = seconds[1] <= seconds[0];
    theirs.ask::<Value>(&json!({"do": "attend", "fused": fused}))?;
    Ok(fused)
}

/// The tokens as the other side's grammar knows them.
pub fn named(ids: &Vocabulary) -> Map<String, Value> {
    let parts = |class: &str| -> Vec<(u32, usize)> {
        ids.parts_of(class).into_iter().map(|(number, part)| (ids.part(number), part.joints.len())).collect()
    };
    let classes: Map<String, Value> =
        ids.classes().iter().enumerate().map(|(k, name)| (ids.class(k).to_string(), json!(parts(name)))).collect();
    let all = json!({"bins": ids.branch(), "branch": ids.branch(), "bos": ids.bos(), "eos": ids.eos(),
           "pad": ids.pad(), "spring": ids.spring(), "none": ids.no_class(), "classes": classes});
    all.as_object().cloned().unwrap_or_default()
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    Open { file: PathBuf, corpus: PathBuf, rows: usize, threads: usize },
    Draw { rows: usize, generate: GenerateConfig, seed: u64 },
}

/// riglab's side.
pub fn serve<S: Subject>() -> Result<()> {
    let mut loaded: Option<(S, Tensor)> = None;
    side::serve(|request| match (request, &mut loaded) {
        (Request::Open { file, corpus, rows, threads }, loaded) => {
            riglab_torch::init(riglab_torch::Settings { threads });
            let task = S::open(&corpus, Precision::Fp32, Some(rows))?;
            let batch = task.source().batch(0).map_err(|e| anyhow!(e))?;
            let _no_grad = tch::no_grad_guard();
            let prefix = task.prefix(&batch);
            let params = task.params();
            let mut tensors: Vec<(String, Tensor)> =
                params.named(params.weights()).map(|(name, t)| (format!("w/{name}"), t.detach())).collect();
            tensors.push(("prefix".into(), prefix.copy()));
            riglab_nn::io::write(&file, tensors.iter().map(|(n, t)| (n.as_str(), t)))?;
            let ends = task.ends().as_object().cloned().unwrap_or_default();
            let answer = json!(Opened { settings: task.settings(), tokenizer: task.tokenizer().clone(), ends });
            *loaded = Some((task, prefix));
            Ok(answer)
        }
        (Request::Draw { rows, generate, seed }, Some((task, prefix))) => {
            let keys: Vec<u64> = (0..rows as u64).map(|row| seed << 32 | row).collect();
            let start = Instant::now();
            let ids = task.draw(prefix, &keys, &generate).map_err(|e| anyhow!(e))?;
            Ok(json!(Drawn { seconds: start.elapsed().as_secs_f64(), ids }))
        }
        (Request::Draw { .. }, None) => Err(anyhow!("open first")),
    })
}
