//! Rows that go on by themselves: greedy, or by sampling.

use riglab_random::{Draw, Stream};

use super::processors::{process, softmax};
use super::{Decoder, GenerateConfig, Grammar, NotFinite};

/// The id of the highest score, the first of equals.
pub fn argmax(scores: &[f32]) -> u32 {
    let mut best = 0;
    for (id, score) in scores.iter().enumerate() {
        if *score > scores[best] {
            best = id;
        }
    }
    best as u32
}

/// An id drawn by probabilities that sum to about 1.
pub fn draw(probabilities: &[f32], random: &mut Stream) -> u32 {
    let total: f64 = probabilities.iter().map(|p| f64::from(*p)).sum();
    let mut left = f64::from(random.unit()) * total;
    let mut last = 0;
    for (id, p) in probabilities.iter().enumerate().filter(|(_, p)| **p > 0.0) {
        last = id;
        left -= f64::from(*p);
        if left < 0.0 {
            break;
        }
    }
    last as u32
}

/// Draws a sequence for each row, without the prompt and with the token that ends it.
///
/// `first`: each row's scores of the first token, after its prompt. `choose` is given row, step and processed
/// scores. Rows that have ended leave the batch, and the last ones take their places. A step is a token that is
/// read, which may be drawn in several parts.
///
/// # Errors
/// Scores that are no numbers: what is drawn by them keeps to no grammar.
pub fn rows<G: Grammar>(
    decoder: &mut dyn Decoder,
    first: Vec<Vec<f32>>,
    mut grammars: Vec<G>,
    config: &GenerateConfig,
    mut choose: impl FnMut(usize, usize, &[f32]) -> u32,
) -> Result<Vec<Vec<u32>>, NotFinite> {
    let mut drawn = vec![Vec::new(); grammars.len()];
    // Which row each row of the batch is.
    let mut live: Vec<usize> = (0..grammars.len()).collect();
    let mut scores = first;
    for step in 0..config.tokens {
        // Of each row of the batch, its next token where it goes on.
        let mut next: Vec<Option<u32>> = Vec::with_capacity(live.len());
        for (at, &row) in live.iter().enumerate() {
            let mut own = std::mem::take(&mut scores[at]);
            let id = loop {
                NotFinite::refuse(&own)?;
                process(&mut own, &drawn[row], Some(&grammars[row].allowed()), config, 1);
                let id = choose(row, step, &own);
                drawn[row].push(id);
                let ends = grammars[row].ends(id);
                grammars[row].accept(id);
                match decoder.within(at, id) {
                    Some(next) => own = next,
                    None => break Some(id).filter(|_| !ends),
                }
            };
            next.push(id);
        }
        let mut go_on: Vec<usize> = (0..live.len()).collect();
        let mut at = 0;
        while at < go_on.len() {
            if next[go_on[at]].is_some() {
                at += 1;
            } else {
                go_on.swap_remove(at);
            }
        }
        if go_on.is_empty() || step + 1 == config.tokens {
            break;
        }
        if go_on.len() < live.len() {
            decoder.select(&go_on);
            live = go_on.iter().map(|&at| live[at]).collect();
        }
        let ids: Vec<u32> = go_on.iter().filter_map(|&at| next[at]).collect();
        scores = decoder.next(&ids);
    }
    Ok(drawn)
}

/// As `choose` of [`rows`]: the likeliest token, or one drawn from the row's own stream.
pub fn chooser<'a>(
    config: &'a GenerateConfig,
    streams: &'a mut [Stream],
) -> impl FnMut(usize, usize, &[f32]) -> u32 + 'a {
    move |row, _, scores| {
        if config.sample { draw(&softmax(scores), &mut streams[row]) } else { argmax(scores) }
    }
}
