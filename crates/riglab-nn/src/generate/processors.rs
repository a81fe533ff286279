//! What happens to scores before a token is chosen, in this order: repetition penalty, grammar,
//! temperature, top-k, top-p.

use super::GenerateConfig;

/// log softmax.
pub fn log_softmax(scores: &mut [f32]) {
    let most = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let sum = scores.iter().map(|s| (s - most).exp()).sum::<f32>().ln();
    scores.iter_mut().for_each(|s| *s -= most + sum);
}

/// softmax; all zero where nothing is possible.
pub fn softmax(scores: &[f32]) -> Vec<f32> {
    shares(scores).0
}

/// [`softmax`], and what [`log_softmax`] takes from each score.
pub fn shares(scores: &[f32]) -> (Vec<f32>, f32) {
    let most = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if most == f32::NEG_INFINITY {
        return (vec![0.0; scores.len()], most);
    }
    // Where few are possible, most exponentials need not be taken.
    let share = |s: &f32| if *s == f32::NEG_INFINITY { 0.0 } else { (s - most).exp() };
    let mut p: Vec<f32> = scores.iter().map(share).collect();
    let sum: f32 = p.iter().sum();
    p.iter_mut().for_each(|x| *x /= sum);
    (p, most + sum.ln())
}

/// The log-probability of a token among those that are `allowed`, by scores as the network gives them: whatever is made of
/// these before one is drawn, what different draws are told by it can be compared.
pub fn log_share(scores: &[f32], allowed: &[u64], id: u32) -> f32 {
    let mut possible = Vec::with_capacity(allowed.iter().map(|word| word.count_ones() as usize).sum());
    for (start, word) in (0..).step_by(64).zip(allowed) {
        let mut left = *word;
        while left != 0 {
            possible.extend(scores.get(start + left.trailing_zeros() as usize));
            left &= left - 1;
        }
    }
    let most = possible.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    let sum: f32 = possible.iter().map(|s| (s - most).exp()).sum();
    let id = id as usize;
    let may = allowed.get(id / 64).is_some_and(|word| word >> (id % 64) & 1 == 1);
    if may { scores[id] - (most + sum.ln()) } else { f32::NEG_INFINITY }
}

/// Applies all of them. `before`: tokens drawn so far; `allowed`: a bit an id; `keep`: tokens that top-k and
/// top-p leave at least. What cannot be drawn becomes -∞.
pub fn process(scores: &mut [f32], before: &[u32], allowed: Option<&[u64]>, config: &GenerateConfig, keep: usize) {
    repetition(scores, before, config.repetition_penalty);
    if let Some(allowed) = allowed {
        for (id, score) in scores.iter_mut().enumerate() {
            if allowed.get(id / 64).is_none_or(|word| word >> (id % 64) & 1 == 0) {
                *score = f32::NEG_INFINITY;
            }
        }
    }
    if !config.sample {
        return;
    }
    if config.temperature != 1.0 {
        scores.iter_mut().for_each(|s| *s /= config.temperature);
    }
    if config.top_k > 0 {
        top_k(scores, config.top_k.max(keep));
    }
    if config.top_p < 1.0 {
        top_p(scores, config.top_p, keep);
    }
}

fn repetition(scores: &mut [f32], before: &[u32], penalty: f32) {
    if penalty == 1.0 {
        return;
    }
    // A bit an id: each is punished once.
    let mut seen = vec![0u64; scores.len().div_ceil(64)];
    for &id in before {
        let id = id as usize;
        let Some(score) = scores.get_mut(id) else { continue };
        let (word, bit) = (&mut seen[id / 64], 1 << (id % 64));
        if *word & bit == 0 {
            *word |= bit;
            *score = if *score < 0.0 { *score * penalty } else { *score / penalty };
        }
    }
}

/// Keeps the `k` best, and whatever ties with the last of them.
fn top_k(scores: &mut [f32], k: usize) {
    // What is impossible is among the best only where fewer than k are possible.
    let mut possible: Vec<f32> = scores.iter().copied().filter(|s| *s > f32::NEG_INFINITY).collect();
    if k >= possible.len() {
        return;
    }
    let (_, least, _) = possible.select_nth_unstable_by(k - 1, |a, b| b.total_cmp(a));
    let least = *least;
    scores.iter_mut().filter(|s| **s < least).for_each(|s| *s = f32::NEG_INFINITY);
}

/// From the least likely on, drops tokens while their probabilities sum to at most 1 - p.
fn top_p(scores: &mut [f32], p: f32, keep: usize) {
    // What is impossible adds nothing to the sum.
    let mut order: Vec<usize> = (0..scores.len()).filter(|&id| scores[id] > f32::NEG_INFINITY).collect();
    // Equal ones in the order of ids; adding 0 makes -0 and +0 equal.
    order.sort_by(|&a, &b| (scores[a] + 0.0).total_cmp(&(scores[b] + 0.0)));
    let own: Vec<f32> = order.iter().map(|&id| scores[id]).collect();
    let most = own.last().copied().unwrap_or(f32::NEG_INFINITY);
    // The sum in the order of ids, as over all scores.
    let sum: f32 = scores.iter().filter(|s| **s > f32::NEG_INFINITY).map(|s| (s - most).exp()).sum();
    let mut dropped = 0.0;
    for (&id, score) in order.iter().zip(&own).take(order.len().saturating_sub(keep)) {
        dropped += (score - most).exp() / sum;
        if dropped > 1.0 - p {
            break;
        }
        scores[id] = f32::NEG_INFINITY;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_equal_scores_the_first_is_dropped_whatever_the_sign_of_zero() {
        for (first, second) in [(0.0, -0.0), (-0.0, 0.0), (1.0, 1.0)] {
            let mut scores = [first, second];
            top_p(&mut scores, 0.5, 1);
            assert_eq!(scores, [f32::NEG_INFINITY, second]);
        }
    }

    #[test]
    fn a_share_is_among_what_is_allowed_whatever_else_is_done() {
        // The third word of the mask is missing: nothing there is allowed.
        let (mut scores, mask) = ([0.0f32; 130], [0b1011, 1 << 63]);
        (scores[0], scores[1], scores[2], scores[3], scores[127], scores[129]) = (0.5, -1.0, 9.0, 2.0, 1.5, 9.0);
        let mut allowed = scores;
        process(&mut allowed, &[], Some(&mask), &GenerateConfig::default(), 1);
        let (p, _) = shares(&allowed);
        for id in [0, 1, 3, 127] {
            assert!((log_share(&scores, &mask, id as u32) - p[id].ln()).abs() < 1e-6, "{id}");
        }
        assert_eq!(p.iter().filter(|p| **p > 0.0).count(), 4);
        assert_eq!([2, 129].map(|id| log_share(&scores, &mask, id)), [f32::NEG_INFINITY; 2]);
    }

    #[test]
    fn shares_say_what_a_log_softmax_takes_off() {
        let scores = [0.5, f32::NEG_INFINITY, -1.0, 3.25, f32::NEG_INFINITY];
        let (p, off) = shares(&scores);
        let mut logs = scores;
        log_softmax(&mut logs);
        for ((p, log), score) in p.iter().zip(logs).zip(scores) {
            assert_eq!(score - off, log, "the same bits");
            assert!((p - log.exp()).abs() < 1e-6);
        }
        assert_eq!(shares(&[f32::NEG_INFINITY; 2]).0, [0.0; 2]);
    }
}
