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
    let most = scores.iter().copied().fold(f32::NEG_INFINITY, f32::max);
    if most == f32::NEG_INFINITY {
        return vec![0.0; scores.len()];
    }
    let mut p: Vec<f32> = scores.iter().map(|s| (s - most).exp()).collect();
    let sum: f32 = p.iter().sum();
    p.iter_mut().for_each(|x| *x /= sum);
    p
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
    let mut seen = before.to_vec();
    seen.sort_unstable();
    seen.dedup();
    for score in seen.into_iter().filter_map(|id| Some(id as usize).filter(|&id| id < scores.len())).collect::<Vec<_>>()
    {
        let score = &mut scores[score];
        *score = if *score < 0.0 { *score * penalty } else { *score / penalty };
    }
}

/// Keeps the `k` best, and whatever ties with the last of them.
fn top_k(scores: &mut [f32], k: usize) {
    if k >= scores.len() {
        return;
    }
    let mut sorted = scores.to_vec();
    sorted.sort_by(|a, b| b.total_cmp(a));
    let least = sorted[k - 1];
    scores.iter_mut().filter(|s| **s < least).for_each(|s| *s = f32::NEG_INFINITY);
}

/// From the least likely on, drops tokens while their probabilities sum to at most 1 - p.
fn top_p(scores: &mut [f32], p: f32, keep: usize) {
    let mut order: Vec<usize> = (0..scores.len()).collect();
    order.sort_by(|&a, &b| scores[a].total_cmp(&scores[b]));
    let likely = softmax(scores);
    let mut sum = 0.0;
    for &id in &order[..order.len().saturating_sub(keep)] {
        sum += likely[id];
        if sum > 1.0 - p {
            break;
        }
        scores[id] = f32::NEG_INFINITY;
    }
}
