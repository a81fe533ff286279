//! Beam search and beam sampling.

use riglab_random::{Draw, Stream};

use super::processors::{log_share, log_softmax, process, softmax};
use super::{Decoder, GenerateConfig, Grammar, NotFinite};

/// A sequence with its score.
#[derive(Clone, Debug, PartialEq)]
pub struct BeamDraw {
    /// The tokens after the prompt.
    pub ids: Vec<u32>,
    /// The sum of log-probabilities, over the number of tokens: those of the processed scores, as released systems have them.
    pub score: f32,
    /// The sum of log-probabilities that the network has for the tokens within the grammar, as of [`super::likely_rows`].
    pub likelihood: f64,
}

/// The first of sequences, which is the best; nothing where none ended.
pub fn best_of(all: Vec<BeamDraw>) -> BeamDraw {
    all.into_iter().next().unwrap_or(BeamDraw {
        ids: Vec::new(),
        score: f32::NEG_INFINITY,
        likelihood: f64::NEG_INFINITY,
    })
}

/// The `count` highest of (score, place), the first of equals first.
pub fn best(scores: &[f32], count: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]).then(a.cmp(&b)));
    order.truncate(count);
    order
}

/// `count` places drawn without replacement, in the order they came.
pub fn draws(probabilities: &[f32], count: usize, random: &mut Stream) -> Vec<usize> {
    let mut left = probabilities.to_vec();
    (0..count.min(left.len()))
        .map(|_| {
            if left.iter().all(|p| *p <= 0.0) {
                // Nothing possible is left: the first place not taken yet.
                let place = left.iter().position(|p| *p == 0.0).unwrap_or(0);
                left[place] = -1.0;
                return place;
            }
            let total: f64 = left.iter().map(|p| f64::from(p.max(0.0))).sum();
            let mut at = f64::from(random.unit()) * total;
            let mut place = 0;
            for (k, p) in left.iter().enumerate().filter(|(_, p)| **p > 0.0) {
                place = k;
                at -= f64::from(*p);
                if at < 0.0 {
                    break;
                }
            }
            left[place] = -1.0;
            place
        })
        .collect()
}

struct Beam<G> {
    ids: Vec<u32>,
    grammar: G,
    score: f32,
    likelihood: f64,
}

/// The best sequences of one prompt, the best first.
///
/// `first`: the scores of the first token, the same for all beams; the decoder has as many rows as there are
/// beams. `choose` is given the step and the sums of log-probabilities, beams × vocabulary, and gives 2 × beams
/// places of it ([`best`] of them, or [`draws`] of their softmax).
///
/// # Errors
/// Scores that are no numbers, as of [`super::rows`].
pub fn beams<G: Grammar>(
    decoder: &mut dyn Decoder,
    first: &[f32],
    grammar: &G,
    config: &GenerateConfig,
    mut choose: impl FnMut(usize, &[f32]) -> Vec<usize>,
) -> Result<Vec<BeamDraw>, NotFinite> {
    let (count, width) = (config.beams, first.len());
    let beam = |k: usize| Beam {
        ids: Vec::new(),
        grammar: grammar.clone(),
        score: if k == 0 { 0.0 } else { -1e9 },
        likelihood: 0.0,
    };
    let mut running: Vec<Beam<G>> = (0..count).map(beam).collect();
    let mut scores = vec![first.to_vec(); count];
    let mut finished: Vec<BeamDraw> = Vec::new();
    for step in 0..config.tokens {
        let mut sums = Vec::with_capacity(count * width);
        let allowed: Vec<Vec<u64>> = running.iter().map(|beam| beam.grammar.allowed()).collect();
        for ((beam, own), allowed) in running.iter().zip(&scores).zip(&allowed) {
            NotFinite::refuse(own)?;
            let mut own = own.clone();
            log_softmax(&mut own);
            process(&mut own, &beam.ids, Some(allowed), config, 2);
            sums.extend(own.iter().map(|s| s + beam.score));
        }
        let likelihood =
            |from: usize, id: u32| running[from].likelihood + f64::from(log_share(&scores[from], &allowed[from], id));
        let length = (step + 1) as f32;
        let last = step + 1 == config.tokens;
        let mut next: Vec<(usize, u32, f32)> = Vec::new();
        for (rank, place) in choose(step, &sums).into_iter().enumerate() {
            let (from, id, score) = (place / width, (place % width) as u32, sums[place]);
            if !last && !running[from].grammar.ends(id) {
                next.push((from, id, score));
            } else if rank < count {
                // One that ends counts where it is among the first.
                let mut ids = running[from].ids.clone();
                ids.push(id);
                finished.push(BeamDraw { ids, score: score / length, likelihood: likelihood(from, id) });
            }
        }
        finished.sort_by(|a, b| b.score.total_cmp(&a.score));
        finished.truncate(count);
        if last {
            break;
        }
        next.sort_by(|a, b| b.2.total_cmp(&a.2));
        next.truncate(count);
        let go_on = next.first().is_some_and(|(_, _, score)| {
            let worst = finished.last().filter(|_| finished.len() == count).map_or(-1e9, |f| f.score);
            score / length > worst
        });
        if !go_on {
            break;
        }
        let rows: Vec<usize> = next.iter().map(|(from, _, _)| *from).collect();
        running = next
            .iter()
            .map(|&(from, id, score)| {
                let (mut ids, mut grammar) = (running[from].ids.clone(), running[from].grammar.clone());
                ids.push(id);
                grammar.accept(id);
                Beam { ids, grammar, score, likelihood: likelihood(from, id) }
            })
            .collect();
        decoder.select(&rows);
        scores = decoder.next(&next.iter().map(|(_, id, _)| *id).collect::<Vec<_>>());
    }
    Ok(finished)
}

/// As `choose` of [`beams`]: the best sums, or draws from their softmax.
pub fn chooser<'a>(config: &'a GenerateConfig, random: &'a mut Stream) -> impl FnMut(usize, &[f32]) -> Vec<usize> + 'a {
    let count = 2 * config.beams;
    move |_, sums| {
        if config.sample { draws(&softmax(sums), count, random) } else { best(sums, count) }
    }
}
