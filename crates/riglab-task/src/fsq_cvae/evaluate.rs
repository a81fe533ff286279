//! Evaluation on whole meshes.

use std::collections::BTreeMap;
use std::sync::Arc;

use riglab_core::{DecodeRule, JointId};
use riglab_geom::voxel::SolidConfig;
use riglab_metric::{Codebook, SkinMetrics, SkinTally, compression_ratio, every_rule, nan_for_null};
use riglab_nn::fsq::Fsq;
use riglab_nn::fsq_cvae::{Coded, GaussianCode};
use riglab_nn::params::Weights;
use riglab_random::{Draw, Stream, stream};
use riglab_train::At;
use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

use super::FsqCvaeTask;
use super::batch::prepared;
use super::coder::Coder;
use super::gallery::finite;
use super::prepare::{Point, Prepared};
use crate::assets::AssetId;

/// Metrics of one way to get weights, over a split.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// The split.
    pub split: String,
    /// `raw` (the network's output), `rule` (after the decode rule) or a baseline's name.
    pub method: String,
    /// Codes kept; 0 for baselines, and for the network where it is told by a prior alone.
    pub tokens: usize,
    /// Assets.
    pub assets: usize,
    /// Numerators and denominators summed over all assets.
    pub pooled: SkinMetrics,
    /// Mean of the assets' own metrics; undefined ones left out.
    pub per_rig: SkinMetrics,
}

impl Row {
    /// Whether it is the network's, not a rule's without learning.
    pub fn own(&self) -> bool {
        self.tokens > 0 || ["raw", "rule"].contains(&self.method.as_str())
    }
}

/// One asset's own metrics.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AssetRow {
    /// The split.
    pub split: String,
    /// The asset's name.
    pub name: String,
    /// Its category; empty where it has none.
    #[serde(default)]
    pub category: String,
    /// Vertices and skinned bones.
    pub vertices: usize,
    /// Bones that are encoded.
    pub bones: usize,
    /// After the decode rule, of the most codes of `eval.prefixes`.
    #[serde(deserialize_with = "nan_for_null")]
    pub iou: f64,
    /// As above.
    #[serde(deserialize_with = "nan_for_null")]
    pub l1: f64,
    /// Of as many codes, without the rule.
    #[serde(deserialize_with = "nan_for_null")]
    pub raw_iou: f64,
}

/// What an evaluation found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Which formulas: SkinTokens' as `design` reads them, over the skinned bones of each asset.
    pub convention: String,
    /// The decode rule's cut, chosen on the validation split by pooled IoU with all codes.
    pub cut: f32,
    /// Tables.
    pub rows: Vec<Row>,
    /// Assets.
    pub assets: Vec<AssetRow>,
    /// Codes of all tokens of each split: tokens, distinct codes, utilisation, perplexity.
    pub codebook: BTreeMap<String, CodebookRow>,
    /// Every bone's codes: a file of its own.
    #[serde(skip)]
    pub codes: Vec<BoneCodes>,
}

/// A bone as the codes that its weights became.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct BoneCodes {
    /// The split.
    pub split: String,
    /// The asset's name.
    pub asset: String,
    /// Its category; empty where it has none.
    pub category: String,
    /// The joint's name.
    pub bone: String,
    /// All codes, each the number of its place in the codebook: the level of axis k times the product of the numbers
    /// of levels of the axes before it, summed.
    pub codes: Vec<i64>,
}

/// How the codebook is used by a split; codes that are real numbers have none, and only `tokens` and `bits`.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CodebookRow {
    /// Tokens counted: few of them cannot use many codes.
    pub tokens: u64,
    /// Different codes among them.
    pub distinct: usize,
    /// Of all codes.
    #[serde(deserialize_with = "nan_for_null")]
    pub utilisation: f64,
    /// exp of the entropy.
    #[serde(deserialize_with = "nan_for_null")]
    pub perplexity: f64,
    /// What a code tells at most, each axis by itself: the entropy of its levels over the split; of an axis that is a
    /// real number the mean divergence from N(0, 1), which is what its draws tell (`rule, drawn`), not its mean.
    #[serde(default = "not_known", deserialize_with = "nan_for_null")]
    pub bits: f64,
    /// Mean over assets of dense 16-bit weights over codes of ⌈log2 C⌉ bits, all codes kept.
    #[serde(deserialize_with = "nan_for_null")]
    pub compression_ratio: f64,
    /// The same with 2 bytes a code.
    #[serde(deserialize_with = "nan_for_null")]
    pub compression_ratio_16_bit: f64,
}

fn not_known() -> f64 {
    f64::NAN
}

/// Sums of how codes are used.
#[derive(Default)]
struct Use {
    codes: Codebook,
    /// Of each axis that has levels.
    axes: Vec<Codebook>,
    divergence: f64,
    tokens: u64,
}

impl Use {
    /// Adds codes [m, t, axes]; with a divergence [m, t], the last `learned` axes of them are real numbers.
    fn add(&mut self, fsq: &Fsq, codes: &Tensor, divergence: Option<&Tensor>, learned: usize) {
        let whole = |t: Tensor| Vec::<i64>::try_from(t.contiguous().view([-1])).unwrap_or_default();
        self.tokens += (codes.size()[0] * codes.size()[1]) as u64;
        let rounded = if divergence.is_some() { fsq.levels().len() - learned } else { fsq.levels().len() };
        self.axes.resize_with(rounded, Codebook::default);
        let digits = fsq.digits(codes);
        for (k, axis) in self.axes.iter_mut().enumerate() {
            axis.add(whole(digits.select(-1, k as i64)));
        }
        match divergence {
            Some(divergence) => self.divergence += divergence.sum(Kind::Double).double_value(&[]),
            None => self.codes.add(whole(fsq.ids(codes))),
        }
    }

    fn bits(&self) -> f64 {
        let levels: f64 = self.axes.iter().map(|axis| axis.perplexity().log2()).sum();
        levels + self.divergence / self.tokens as f64 / std::f64::consts::LN_2
    }
}

/// An asset encoded: what decoding needs.
pub struct Encoded {
    /// The asset.
    pub rig: Arc<Prepared>,
    /// Its shape tokens, [1, s, l].
    pub cond: Tensor,
    /// [m, t, axes]
    pub codes: Tensor,
    /// [m, t]: of rounded codes, their places in the codebook.
    pub ids: Option<Tensor>,
    /// Of codes that are real numbers, how far they scatter and what they tell.
    pub said: Option<GaussianCode>,
    /// Draws the points at which the bones were seen.
    seen: Stream,
}

/// Sums over a split of one method.
#[derive(Default)]
pub(crate) struct Sums {
    pooled: SkinTally,
    each: Vec<SkinMetrics>,
}

impl Sums {
    pub(crate) fn add(&mut self, tally: &SkinTally) {
        self.pooled.add(tally);
        self.each.push(tally.metrics());
    }

    /// Pooled metrics, and the mean of the assets' own.
    pub(crate) fn metrics(&self) -> (SkinMetrics, SkinMetrics) {
        let mean = |f: fn(&SkinMetrics) -> f64| {
            let defined: Vec<f64> = self.each.iter().map(f).filter(|v| !v.is_nan()).collect();
            defined.iter().sum::<f64>() / defined.len() as f64
        };
        let per_rig = SkinMetrics {
            l1: mean(|m| m.l1),
            l1_var: mean(|m| m.l1_var),
            precision: mean(|m| m.precision),
            recall: mean(|m| m.recall),
            iou: mean(|m| m.iou),
            mask_cover_bone: mean(|m| m.mask_cover_bone),
            mask_cover_vertex: mean(|m| m.mask_cover_vertex),
            mask_entry: mean(|m| m.mask_entry),
        };
        (self.pooled.metrics(), per_rig)
    }

    pub(crate) fn row(&self, split: &str, method: &str, tokens: usize) -> Row {
        let (pooled, per_rig) = self.metrics();
        Row { split: split.into(), method: method.into(), tokens, assets: self.each.len(), pooled, per_rig }
    }
}

/// Sums of every way to get weights, in the order in which they came.
#[derive(Default)]
pub(crate) struct Methods(Vec<(String, Sums)>);

impl Methods {
    pub(crate) fn add(&mut self, name: String, tally: &SkinTally) {
        match self.0.iter_mut().find(|(n, _)| *n == name) {
            Some((_, sums)) => sums.add(tally),
            None => {
                let mut sums = Sums::default();
                sums.add(tally);
                self.0.push((name, sums));
            }
        }
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &(String, Sums)> {
        self.0.iter()
    }
}

/// Vertices of an asset to look at, with the true weights of its bones there.
pub struct Truth {
    /// The points.
    pub points: Vec<Point>,
    /// A row of shares a point, a column a bone.
    pub dense: Vec<f32>,
}

impl Truth {
    /// All vertices, or at most `limit` of them drawn by a stream.
    pub fn new(rig: &Prepared, limit: Option<(usize, u64)>) -> Self {
        let n = rig.rig.mesh().positions().len();
        let mut chosen: Vec<u32> = (0..n as u32).collect();
        if let Some((limit, seed)) = limit.filter(|(limit, _)| *limit < n) {
            stream(seed, "validation vertices", &[]).shuffled(&mut chosen);
            chosen.truncate(limit);
            chosen.sort_unstable();
        }
        let mut place = vec![u32::MAX; n];
        for (k, &v) in chosen.iter().enumerate() {
            place[v as usize] = k as u32;
        }
        let joints = rig.bones.len();
        let mut dense = vec![0.0; chosen.len() * joints];
        for (j, bone) in rig.bones.iter().enumerate() {
            for &(v, w) in bone.weights() {
                if let Some(k) = Some(place[v as usize]).filter(|&k| k != u32::MAX) {
                    dense[k as usize * joints + j] = w;
                }
            }
        }
        Self { points: chosen.iter().map(|&v| rig.vertex(v)).collect(), dense }
    }
}

impl FsqCvaeTask {
    /// Encodes an asset: its shape, and all its bones with all codes. The points that the encoders
    /// see are drawn by the evaluation seed and the asset's number.
    ///
    /// # Errors
    /// When the asset cannot be read.
    pub fn encode(&self, w: &Weights, id: AssetId) -> Result<Encoded, String> {
        let rig = prepared(&self.assets, &self.cache, id, self.config.model.extensions.prior)?;
        let mut random = stream(self.config.eval.seed, "evaluation", &[id.key()]);
        let coder = self.coder(w);
        let cond = coder.shape(&rig, &mut random);
        let seen = random.clone();
        let Coded { codes, said } = coder.encode(&rig, self.config.model.skin_tokens, &mut random);
        let ids = said.is_none().then(|| self.net.fsq().ids(&codes));
        Ok(Encoded { rig, cond, codes, ids, said, seen })
    }

    /// The codes of bones that get `k` each, [m, k, axes], as they are learned and used: of the same points, yet not the
    /// first of all codes (`FsqCvae::encode_skin`).
    pub(super) fn codes(&self, w: &Weights, encoded: &Encoded, k: usize) -> Tensor {
        if k == 0 || k == self.config.model.skin_tokens {
            return encoded.codes.narrow(1, 0, k as i64);
        }
        self.coder(w).encode(&encoded.rig, k, &mut encoded.seen.clone()).codes
    }

    /// Raw shares at points, a row a point, a column a bone, from the codes of each bone.
    ///
    /// # Errors
    /// When the network gives what is no number.
    pub fn decode(&self, w: &Weights, encoded: &Encoded, codes: &Tensor, points: &[Point]) -> Result<Vec<f32>, String> {
        let rig = &encoded.rig;
        let raw = self.coder(w).decode(&encoded.cond, codes, points, &rig.segments(), rig.told());
        finite(&raw)?;
        Ok(raw)
    }

    fn coder<'a>(&'a self, weights: &'a Weights) -> Coder<'a> {
        Coder { config: &self.config, net: &self.net, weights, device: self.device }
    }

    /// The assets that validation looks at while training, not empty.
    pub(super) fn validated(&self) -> Vec<AssetId> {
        let eval = &self.config.eval;
        self.config.data.some_of(&self.validation_assets, eval.validation_assets, eval.seed)
    }

    /// Validation: pooled and per-rig IoU, raw and after the rule, on a sample of vertices. Ranks share the assets.
    pub(super) fn validation(&self, w: &Weights, at: At) -> Result<Vec<(String, f64)>, String> {
        let split = self.config.data.validate.clone();
        let limit = self.config.eval.validation_vertices;
        let tokens = self.config.model.skin_tokens;
        let mut raw = Sums::default();
        let mut rules: Vec<Sums> = self.config.eval.cuts.iter().map(|_| Sums::default()).collect();
        let ids = self.validated();
        let tallies = |k: usize| {
            let id = ids[k];
            let encoded = self.encode(w, id)?;
            let joints = encoded.rig.bones.len();
            let truth = Truth::new(&encoded.rig, Some((limit, at.seed ^ id.key())));
            let predicted = self.decode(w, &encoded, &encoded.codes, &truth.points)?;
            let cuts = self.config.eval.cuts.iter();
            let ruled = cuts.map(|&cut| SkinTally::of(&truth.dense, &ruled(&predicted, joints, cut), joints)).collect();
            Ok((SkinTally::of(&truth.dense, &predicted, joints), ruled))
        };
        let shared = at.ranks.share::<(SkinTally, Vec<SkinTally>)>(ids.len(), tallies, |_| {});
        for (own, ruled) in shared.map_err(|e| e.to_string())? {
            raw.add(&own);
            rules.iter_mut().zip(&ruled).for_each(|(sums, tally)| sums.add(tally));
        }
        let raw = raw.row(&split, "raw", tokens);
        let rule = best(&rules, &split, tokens);
        Ok(vec![
            ("iou_rule@val".into(), rule.pooled.iou),
            ("iou_rule_per_rig@val".into(), rule.per_rig.iou),
            ("l1_rule@val".into(), rule.pooled.l1),
            ("iou_raw@val".into(), raw.pooled.iou),
            ("precision_raw@val".into(), raw.pooled.precision),
            ("recall_raw@val".into(), raw.pooled.recall),
        ])
    }

    /// Evaluates on whole meshes: the test splits at every prefix, raw and after the decode rule,
    /// beside the baselines, and with all bones' codes exchanged (what do the codes tell?).
    /// `progress` is told how many assets are done.
    ///
    /// # Errors
    /// When an asset cannot be read, or none is there to choose a cut by.
    pub fn evaluate(&self, w: &Weights, mut progress: impl FnMut(usize)) -> Result<Report, String> {
        self.config.data.can_choose(&self.config.eval.cuts, &self.validation_assets)?;
        let mut done = 0;
        let mut rules: Vec<Sums> = self.config.eval.cuts.iter().map(|_| Sums::default()).collect();
        for &id in &self.validation_assets {
            let encoded = self.encode(w, id)?;
            let joints = encoded.rig.bones.len();
            let truth = Truth::new(&encoded.rig, None);
            let predicted = self.decode(w, &encoded, &encoded.codes, &truth.points)?;
            for (sums, &cut) in rules.iter_mut().zip(&self.config.eval.cuts) {
                sums.add(&SkinTally::of(&truth.dense, &ruled(&predicted, joints, cut), joints));
            }
            done += 1;
            progress(done);
        }
        let cut = self.config.eval.cuts[best_index(&rules)];
        let mut report = Report {
            convention: "skintokens".into(),
            cut,
            rows: Vec::new(),
            assets: Vec::new(),
            codebook: BTreeMap::new(),
            codes: Vec::new(),
        };
        for split in &self.config.data.test {
            self.evaluate_split(w, split, &mut report, || {
                done += 1;
                progress(done);
            })?;
        }
        Ok(report)
    }

    /// How many assets [`Self::evaluate`] goes over.
    ///
    /// # Errors
    /// When a column of a corpus cannot be read.
    pub fn evaluation_assets(&self) -> Result<usize, String> {
        let tests = self.config.data.test.iter().map(|s| self.assets.split(s).map(|a| a.len()));
        let tests: Result<Vec<usize>, _> = tests.collect();
        Ok(self.validation_assets.len() + tests.map_err(|e| e.to_string())?.iter().sum::<usize>())
    }

    fn evaluate_split(
        &self,
        w: &Weights,
        split: &str,
        report: &mut Report,
        mut progress: impl FnMut(),
    ) -> Result<(), String> {
        let all = self.config.model.skin_tokens;
        let mut methods: BTreeMap<(usize, String), Sums> = BTreeMap::new();
        let mut rules = Methods::default();
        let body = SolidConfig { resolution: self.config.eval.baseline_resolution, ..SolidConfig::DEFAULT };
        let (mut used, mut ratios) = (Use::default(), Vec::new());
        let fsq = self.net.fsq();
        let ids = self.assets.split(split).map_err(|e| e.to_string())?;
        if ids.is_empty() {
            // It has no figures, and who evaluates is told.
            return Ok(());
        }
        for id in ids {
            let encoded = self.encode(w, id)?;
            let (rig, joints) = (encoded.rig.clone(), encoded.rig.bones.len());
            let truth = Truth::new(&rig, None);
            let ids = encoded.ids.as_ref().and_then(|ids| Vec::<i64>::try_from(ids.view([-1])).ok());
            let ids = ids.unwrap_or_default();
            for (bone, codes) in rig.bones.iter().zip(ids.chunks(all)) {
                report.codes.push(BoneCodes {
                    split: split.into(),
                    asset: rig.name.clone(),
                    category: self.assets.category(id)?,
                    bone: rig.rig.skeleton().name(bone.joint).into(),
                    codes: codes.to_vec(),
                });
            }
            used.add(
                fsq,
                &encoded.codes,
                encoded.said.as_ref().map(|s| &s.divergence),
                self.config.model.learned_axes(),
            );
            ratios.push([1 << 16, fsq.size()].map(|c| compression_ratio(truth.points.len(), all, c)));
            let mut tally = |key: (usize, &str), predicted: &[f32]| {
                let t = SkinTally::of(&truth.dense, predicted, joints);
                methods.entry((key.0, key.1.into())).or_default().add(&t);
                t.metrics()
            };
            for &k in &self.config.eval.prefixes {
                let predicted = self.decode(w, &encoded, &self.codes(w, &encoded, k), &truth.points)?;
                let raw = tally((k, "raw"), &predicted);
                let rule = tally((k, "rule"), &ruled(&predicted, joints, report.cut));
                if k == self.ranked() {
                    report.assets.push(AssetRow {
                        split: split.into(),
                        name: rig.name.clone(),
                        category: self.assets.category(id)?,
                        vertices: truth.points.len(),
                        bones: joints,
                        iou: rule.iou,
                        l1: rule.l1,
                        raw_iou: raw.iou,
                    });
                }
            }
            if let Some(said) = &encoded.said {
                let mut random = stream(self.config.eval.seed, "evaluation noise", &[id.key()]);
                let noise: Vec<f32> = (0..said.deviation.numel()).map(|_| random.normal()).collect();
                let away = Tensor::from_slice(&noise).view_as(&said.deviation).to_device(self.device) * &said.deviation;
                // What is told does not scatter.
                let told = encoded.codes.size()[2] - away.size()[2];
                let drawn = &encoded.codes + away.constant_pad_nd([told, 0]);
                let predicted = self.decode(w, &encoded, &drawn, &truth.points)?;
                tally((all, "rule, drawn"), &ruled(&predicted, joints, report.cut));
            }
            // Every bone decoded with the codes of the next: the difference is what codes tell. A single bone has none.
            if joints > 1 {
                let next = Tensor::from_slice(&(0..joints as i64).map(|j| (j + 1) % joints as i64).collect::<Vec<_>>());
                let exchanged = encoded.codes.index_select(0, &next.to_device(self.device));
                let predicted = self.decode(w, &encoded, &exchanged, &truth.points)?;
                tally((all, "rule, codes exchanged"), &ruled(&predicted, joints, report.cut));
            }

            let joints_of: Vec<JointId> = rig.bones.iter().map(|b| b.joint).collect();
            every_rule(&rig.rig, &joints_of, &body, |name, weights| {
                rules.add(name, &SkinTally::of(&truth.dense, weights, joints));
            });
            progress();
        }
        report.rows.extend(methods.iter().map(|((k, method), sums)| sums.row(split, method, *k)));
        report.rows.extend(rules.iter().map(|(name, sums)| sums.row(split, name, 0)));
        let of_codes = |x: f64| if used.codes.tokens() == 0 { f64::NAN } else { x };
        let mean = |k: usize| ratios.iter().map(|r: &[f64; 2]| r[k]).sum::<f64>() / ratios.len().max(1) as f64;
        report.codebook.insert(
            split.into(),
            CodebookRow {
                tokens: used.tokens,
                distinct: used.codes.distinct(),
                utilisation: of_codes(used.codes.utilisation(fsq.size())),
                perplexity: of_codes(used.codes.perplexity()),
                bits: used.bits(),
                compression_ratio: of_codes(mean(1)),
                compression_ratio_16_bit: of_codes(mean(0)),
            },
        );
        Ok(())
    }
}

/// The decode rule applied to every row.
pub fn ruled(raw: &[f32], joints: usize, cut: f32) -> Vec<f32> {
    use rayon::prelude::*;
    let rule = DecodeRule { cut, influences: 4 };
    let mut out = raw.to_vec();
    out.par_chunks_exact_mut(joints).for_each(|row| rule.apply(row));
    out
}

fn best_index(rules: &[Sums]) -> usize {
    let iou = |s: &Sums| s.pooled.metrics().iou;
    (0..rules.len()).max_by(|&a, &b| iou(&rules[a]).total_cmp(&iou(&rules[b])).then(b.cmp(&a))).unwrap_or(0)
}

fn best(rules: &[Sums], split: &str, tokens: usize) -> Row {
    rules[best_index(rules)].row(split, "rule", tokens)
}

#[cfg(test)]
mod tests {
    use riglab_core::{Asset, Joint, Provenance, Rig, Skeleton, SkinWeights};
    use riglab_data::CorpusWriter;
    use riglab_nn::fsq_cvae::Bottleneck;
    use tch::Device;

    use super::*;
    use crate::fsq_cvae::FsqCvaeTaskConfig;
    use crate::tokenrig::testing::tetrahedron;

    /// A task whose codes are real numbers, and a rig of so many bones to look at.
    fn task(joints: u16, dir: &std::path::Path) -> FsqCvaeTask {
        let path = dir.join("one.h5");
        let joint = |j: u16| Joint { name: format!("j{j}"), parent: j.checked_sub(1).map(JointId), head: [0.0; 3] };
        let skeleton = Skeleton::new((0..joints).map(joint).collect()).unwrap();
        let weights = SkinWeights::normalized((0..4u16).map(|v| [(v % joints, 1.0)])).unwrap();
        let rig = Rig::new(skeleton, tetrahedron(), weights).unwrap();
        let mut writer = CorpusWriter::create(&path).unwrap();
        let asset = |name: &str| Asset {
            name: name.into(),
            rig: rig.clone(),
            clips: Vec::new(),
            provenance: Provenance::default(),
        };
        ["a", "b", "c"].iter().for_each(|name| writer.add(&asset(name)).unwrap());
        writer.finish(&["train", "val", "test"]).unwrap();
        let mut config = FsqCvaeTaskConfig::default();
        let m = &mut config.model;
        (m.encoder_width, m.decoder_width, m.heads, m.latent) = (16, 16, 2, 8);
        (m.encoder_layers, m.decoder_layers, m.shape_tokens, m.skin_tokens) = (1, 1, 4, 4);
        (m.levels, m.bottleneck) = (vec![4, 3], Bottleneck::Gaussian);
        (config.data.corpora, config.data.test) = (vec![path], vec!["test".into()]);
        (config.eval.prefixes, config.eval.baseline_resolution) = (vec![2, 4], 16);
        FsqCvaeTask::new(config, Device::Cpu).unwrap()
    }

    #[test]
    fn bones_that_get_fewer_codes_are_encoded_with_as_many() {
        let dir = tempfile::tempdir().unwrap();
        let task = task(2, dir.path());
        let w = task.params.weights();
        let encoded = task.encode(w, task.validation_assets[0]).unwrap();
        let [none, two, all] = [0, 2, 4].map(|k| task.codes(w, &encoded, k));
        assert_eq!([&none, &two, &all].map(|codes| codes.size()), [[2, 0, 2], [2, 2, 2], [2, 4, 2]]);
        assert!(all.equal(&encoded.codes) && !two.equal(&encoded.codes.narrow(1, 0, 2)));
        assert!(two.equal(&task.codes(w, &encoded, 2)));
    }

    #[test]
    fn assets_are_shown_with_the_codes_that_they_are_ranked_by() {
        let dir = tempfile::tempdir().unwrap();
        let mut task = task(2, dir.path());
        task.config.eval.prefixes = vec![2, 1];
        let w = task.params.weights();
        let report = task.evaluate(w, |_| {}).unwrap();
        let shown = &task.gallery(w, &report, 1).unwrap()[0].1.png;
        let encoded = task.encode(w, task.assets.split("test").unwrap()[0]).unwrap();
        let [two, all] = [2, 4].map(|most| task.sheet(w, &encoded, (report.cut, most)).unwrap().1.to_png());
        assert!(*shown == two && *shown != all);
    }

    #[test]
    fn codes_are_exchanged_where_there_are_others() {
        let rows = [1, 2].map(|joints| {
            let dir = tempfile::tempdir().unwrap();
            let task = task(joints, dir.path());
            let report = task.evaluate(task.params.weights(), |_| {}).unwrap();
            let of = |method: &str| report.rows.iter().filter(|row| row.method == method).count();
            (of("rule"), of("rule, codes exchanged"))
        });
        assert_eq!(rows, [(2, 0), (2, 1)]);
    }

    #[test]
    fn what_codes_tell_is_their_entropy_or_their_divergence() {
        let fsq = Fsq::new(&[4, 3]).unwrap();
        let ids = Tensor::arange(12, (Kind::Int64, Device::Cpu)).view([3, 4]);
        let codes = fsq.codes(&ids, Kind::Float);
        let of = |divergence: Option<&Tensor>| {
            let mut used = Use::default();
            used.add(&fsq, &codes, divergence, 1);
            (used.codes.distinct(), used.bits())
        };
        // Each code once: as much as codes can tell.
        let (distinct, bits) = of(None);
        assert!(distinct == 12 && (bits - 12f64.log2()).abs() < 1e-9);
        // The second axis a real number of one nat.
        let (distinct, bits) = of(Some(&Tensor::ones([3, 4], (Kind::Float, Device::Cpu))));
        assert!(distinct == 0 && (bits - 2.0 - std::f64::consts::E.log2()).abs() < 1e-9);
    }
}
