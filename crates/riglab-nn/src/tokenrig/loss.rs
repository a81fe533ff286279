//! Next-token loss of both parts of a sequence.

use tch::{Kind, Tensor};

use super::TokenRig;
use crate::grpo::{entropy, log_softmax_within};
use crate::layers::affine;
use crate::params::Weights;
use crate::skeleton::spread_likelihood;

/// Vectors and what should follow them.
pub struct NextTokens<'a> {
    /// [M, d], as [`TokenRig::forward`] gives them.
    pub hidden: &'a Tensor,
    /// Ids [M].
    pub targets: &'a Tensor,
    /// Ids below this are cells.
    pub bins: i64,
    /// Standard deviation, in cells, by which targets that are cells are spread; 0: not at all.
    pub spread: f64,
}

/// Sums of cross-entropies, and over how many tokens.
pub struct Parts {
    /// Of the skeleton, from after `bos` to its end.
    pub skeleton: Tensor,
    /// Tokens of it.
    pub skeleton_tokens: i64,
    /// Of the skin codes.
    pub skin: Tensor,
    /// Tokens of it, the end counted where it is scored.
    pub skin_tokens: i64,
}

impl Parts {
    /// Means of each part, the skeleton's first; 0 for a part without tokens.
    pub fn means(&self) -> [Tensor; 2] {
        [(&self.skeleton, self.skeleton_tokens), (&self.skin, self.skin_tokens)].map(|(sum, n)| sum / n.max(1) as f64)
    }
}

impl TokenRig {
    /// Scores of all skeleton ids and codes [M, v] with one softmax, in f32: of [`super::Head::Flat`].
    pub fn logits(&self, w: &Weights, hidden: &Tensor) -> Tensor {
        float(&self.decoder.logits(w, hidden))
    }

    /// `of` the scores of all ids [m, v], in f32, and of the other rows; `rows[0]` are vectors [m, d]. Rows go in runs of
    /// as many as are scored at once.
    pub(super) fn scored(
        &self,
        w: &Weights,
        rows: &[&Tensor],
        of: impl Fn(&Tensor, &[Tensor]) -> Vec<Tensor> + Clone + Send + 'static,
    ) -> Vec<Tensor> {
        let (count, step, table) = (rows[0].size()[0], self.scored_at_once, self.decoder.table());
        let part = move |w: &Weights, rows: &[Tensor]| {
            let scores = float(&affine(&rows[0], &w[table], None));
            of(&scores, &rows[1..])
        };
        if step == 0 || count <= step {
            return part(w, &rows.iter().map(|t| t.shallow_clone()).collect::<Vec<_>>());
        }
        let runs = (0..count).step_by(step as usize).map(|start| {
            let own: Vec<Tensor> = rows.iter().map(|t| t.narrow(0, start, step.min(count - start))).collect();
            w.again(&own.iter().collect::<Vec<_>>(), part.clone())
        });
        let runs: Vec<Vec<Tensor>> = runs.collect();
        (0..runs[0].len()).map(|k| Tensor::cat(&runs.iter().map(|run| &run[k]).collect::<Vec<_>>(), 0)).collect()
    }

    /// The cross-entropies of both parts.
    pub fn losses(&self, w: &Weights, asked: &NextTokens) -> Parts {
        let first = self.layout.skeleton();
        let in_skeleton = asked.targets.lt(first);
        let places = |mask: &Tensor| mask.nonzero().squeeze_dim(1);
        let (of_skeleton, mut of_skin) = (places(&in_skeleton), places(&in_skeleton.logical_not()));
        let pick = |t: &Tensor, rows: &Tensor| t.index_select(0, rows);
        let skeleton_targets = pick(asked.targets, &of_skeleton);
        let (skeleton, skin) = match &self.levels {
            None => {
                let (bins, spread) = (asked.bins, asked.spread);
                let skeleton = self.scored(w, &[&pick(asked.hidden, &of_skeleton), &skeleton_targets], move |s, t| {
                    vec![spread_likelihood(&s.log_softmax(-1, None::<Kind>), &t[0], bins, spread)]
                });
                let targets = pick(asked.targets, &of_skin);
                let skin = self.scored(w, &[&pick(asked.hidden, &of_skin), &targets], |s, t| {
                    vec![-s.log_softmax(-1, None::<Kind>).gather(1, &t[0].unsqueeze(1), false).squeeze_dim(1)]
                });
                let [skeleton, skin] = [skeleton, skin].map(|mut parts| parts.remove(0));
                (skeleton, skin)
            }
            Some(levels) => {
                let table = w[self.decoder.table()].narrow(0, 0, first);
                let scores = float(&affine(&pick(asked.hidden, &of_skeleton), &table, None));
                let likely = scores.log_softmax(-1, None::<Kind>);
                // The end follows by the grammar alone.
                of_skin = places(&in_skeleton.logical_or(&asked.targets.eq(self.layout.end())).logical_not());
                let ids = pick(asked.targets, &of_skin);
                let sum = self.level_loss(w, levels, &pick(asked.hidden, &of_skin), &ids);
                (spread_likelihood(&likely, &skeleton_targets, asked.bins, asked.spread), sum)
            }
        };
        Parts {
            skeleton: skeleton.sum(None::<Kind>),
            skeleton_tokens: of_skeleton.size()[0],
            skin: skin.sum(None::<Kind>),
            skin_tokens: of_skin.size()[0],
        }
    }

    /// Sums over levels, [m], of codes or empty bones `ids` [m] after `hidden` [m, d].
    fn level_loss(&self, w: &Weights, tables: &super::Levels, hidden: &Tensor, ids: &Tensor) -> Tensor {
        self.level_likelihood(w, tables, hidden, ids, &Freely::default()).0.neg()
    }

    /// Sums over levels of the log-probabilities of codes or empty bones `ids` [m] after `hidden` [m, d], [m]; and of
    /// the entropies, where they are asked for.
    pub(super) fn level_likelihood(
        &self,
        w: &Weights,
        tables: &super::Levels,
        hidden: &Tensor,
        ids: &Tensor,
        freely: &Freely,
    ) -> (Tensor, Option<Tensor>) {
        let (offsets, all) = self.layout.offsets();
        let empty = ids.eq(self.layout.empty());
        let rows = self.rows_of(ids);
        let (score, mut hidden) = (&w[tables.score], hidden.shallow_clone());
        let (mut sum, mut entropies): (Option<Tensor>, Option<Tensor>) = (None, None);
        for (k, (&at, &l)) in offsets.iter().zip(self.layout.levels()).enumerate() {
            let own = rows.select(-1, k as i64);
            let mut table = score.narrow(0, at, l);
            let mut target = &own - at;
            let mut allowed = None;
            if k == 0 {
                table = Tensor::cat(&[&table, &score.narrow(0, all, 1)], 0);
                target = target.masked_fill(&empty, l);
                allowed = freely.empty.map(|empty| {
                    let codes = Tensor::ones([ids.size()[0], l], (Kind::Bool, ids.device()));
                    Tensor::cat(&[codes, empty.unsqueeze(1)], 1)
                });
            }
            let scores = float(&affine(&hidden, &table, None));
            let likely = log_softmax_within(&scores, allowed.as_ref(), freely.temperature);
            let mut own_sum = likely.gather(1, &target.unsqueeze(1), false).squeeze_dim(1);
            let mut own_entropy = freely.entropies.then(|| entropy(&likely));
            if k > 0 {
                // An empty bone has no further levels.
                let present = empty.logical_not().to_kind(own_sum.kind());
                own_sum *= &present;
                own_entropy = own_entropy.map(|e| e * &present);
            }
            sum = Some(sum.map_or_else(|| own_sum.shallow_clone(), |sum| sum + &own_sum));
            entropies = match (entropies, own_entropy) {
                (Some(all), Some(own)) => Some(all + own),
                (_, own) => own,
            };
            hidden = &hidden + Tensor::embedding(&w[tables.chain], &own, -1, false, false);
        }
        (sum.unwrap_or_else(|| Tensor::zeros([ids.size()[0]], (Kind::Float, ids.device()))), entropies)
    }
}

/// How codes are drawn.
pub(super) struct Freely<'a> {
    /// Whether an empty bone may stand in a place, [m]; `None`: anywhere.
    pub empty: Option<&'a Tensor>,
    /// Scores are divided by it.
    pub temperature: f64,
    /// Whether entropies are asked for.
    pub entropies: bool,
}

impl Default for Freely<'_> {
    fn default() -> Self {
        Self { empty: None, temperature: 1.0, entropies: false }
    }
}

/// Losses are computed in at least f32.
pub(super) fn float(x: &Tensor) -> Tensor {
    if x.kind() == Kind::Double { x.shallow_clone() } else { x.to_kind(Kind::Float) }
}
