//! Rows that go on by themselves: greedy, or by sampling.

use riglab_random::{Draw, Stream};

use super::processors::{log_share, process, softmax};
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
    grammars: Vec<G>,
    config: &GenerateConfig,
    choose: impl FnMut(usize, usize, &[f32]) -> u32,
) -> Result<Vec<Vec<u32>>, NotFinite> {
    likely_rows(decoder, first, grammars, config, choose, None)
}

/// As [`rows`]; `likelihood` is given, of each row, the sum of the log-probabilities that the network has for what was
/// chosen within the grammar: those of draws at any temperature, after any filter and penalty, can be compared.
///
/// # Errors
/// As [`rows`].
pub fn likely_rows<G: Grammar>(
    decoder: &mut dyn Decoder,
    first: Vec<Vec<f32>>,
    mut grammars: Vec<G>,
    config: &GenerateConfig,
    mut choose: impl FnMut(usize, usize, &[f32]) -> u32,
    mut likelihood: Option<&mut [f64]>,
) -> Result<Vec<Vec<u32>>, NotFinite> {
    let keep = likelihood.is_some() && config.changes();
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
                let (plain, allowed) = (keep.then(|| own.clone()), grammars[row].allowed());
                process(&mut own, &drawn[row], Some(&allowed), config, 1);
                let id = choose(row, step, &own);
                if let Some(all) = likelihood.as_deref_mut() {
                    all[row] += f64::from(log_share(plain.as_ref().unwrap_or(&own), &allowed, id));
                }
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

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::generate::{beam_chooser, beams, log_share};

    /// Gives the same scores after whatever was read.
    struct Gives([f32; 5]);

    impl Decoder for Gives {
        fn next(&mut self, ids: &[u32]) -> Vec<Vec<f32>> {
            vec![self.0.to_vec(); ids.len()]
        }

        fn select(&mut self, _: &[usize]) {}
    }

    /// The fourth token is not allowed, the fifth ends.
    #[derive(Clone)]
    struct AllButOne;

    const MAY: u64 = 0b10111;

    impl Grammar for AllButOne {
        fn allowed(&self) -> Vec<u64> {
            vec![MAY]
        }

        fn accept(&mut self, _: u32) {}

        fn ends(&self, id: u32) -> bool {
            id == 4
        }
    }

    #[test]
    fn how_likely_draws_are_does_not_depend_on_how_they_were_drawn() {
        let scores = [1.0, 0.5, 0.25, 4.0, 0.75];
        let likely = |ids: &[u32]| ids.iter().map(|&id| f64::from(log_share(&scores, &[MAY], id))).sum::<f64>();
        let plain = GenerateConfig { tokens: 6, ..GenerateConfig::default() };
        let cool = GenerateConfig { sample: true, temperature: 0.5, top_k: 3, top_p: 0.9, ..plain.clone() };
        let punished = GenerateConfig { repetition_penalty: 2.0, ..cool.clone() };
        for config in [plain.clone(), GenerateConfig { sample: true, ..plain }, cool, punished] {
            let mut streams: Vec<_> = (0..4).map(|k| stream(0, "test", &[k])).collect();
            let mut told = vec![0.0; 4];
            let (first, grammars) = (vec![scores.to_vec(); 4], vec![AllButOne; 4]);
            let choose = chooser(&config, &mut streams);
            let all = likely_rows(&mut Gives(scores), first, grammars, &config, choose, Some(&mut told)).unwrap();
            for (ids, told) in all.iter().zip(told) {
                assert!((told - likely(ids)).abs() < 1e-5, "{config:?}: {ids:?}");
            }
            let config = GenerateConfig { beams: 3, ..config };
            let random = &mut stream(1, "test", &[]);
            let all = beams(&mut Gives(scores), &scores, &AllButOne, &config, beam_chooser(&config, random)).unwrap();
            assert!(!all.is_empty());
            for own in all {
                assert!((own.likelihood - likely(&own.ids)).abs() < 1e-5, "{config:?}: {own:?}");
            }
        }
    }
}
