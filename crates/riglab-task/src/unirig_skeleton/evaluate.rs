//! Evaluation by generating skeletons for whole meshes.

use riglab_geom::CloudSampler;
use riglab_metric::{Joints, SkeletonConvention, SkeletonDistances, nan_for_null};
use riglab_nn::generate::NotFinite;
use riglab_nn::params::Weights;
use riglab_random::stream;
use riglab_ranks::Ranks;
use riglab_token::Decoded;
use riglab_train::Validation;
use serde::{Deserialize, Serialize};

use super::agree::Chosen;
use super::batch::{Batch, encode, normalized, shape};
use super::generate::SkeletonSample;
use super::retrieval::{Offered, Retrieval};
use super::{SkeletonTask, loss_of};
use crate::assets::AssetId;

/// Metrics of one way to get skeletons, over a split.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// The split.
    pub split: String,
    /// `model`, or a baseline's name.
    pub method: String,
    /// Assets.
    pub assets: usize,
    /// Of them, those that can be compared by every method: decoded, with at least a bone on both sides.
    pub compared: usize,
    /// Mean over the compared, in shares of the cube's edge.
    #[serde(deserialize_with = "nan_for_null")]
    pub j2j: f64,
    /// As above.
    #[serde(deserialize_with = "nan_for_null")]
    pub j2b: f64,
    /// As above.
    #[serde(deserialize_with = "nan_for_null")]
    pub b2b: f64,
    /// Share of sequences that are skeletons.
    #[serde(deserialize_with = "nan_for_null")]
    pub valid: f64,
    /// Mean number of joints.
    #[serde(deserialize_with = "nan_for_null")]
    pub joints: f64,
    /// Mean number of joints of the truth.
    #[serde(deserialize_with = "nan_for_null")]
    pub true_joints: f64,
    /// Mean of |joints - true joints| / true joints.
    #[serde(deserialize_with = "nan_for_null")]
    pub joints_off: f64,
}

impl Row {
    /// As what a validation logs; `j2j_all@val` counts one that cannot be compared as wrong as can be.
    pub(crate) fn validation(&self) -> Vec<(String, f64)> {
        let missing = (self.assets - self.compared) as f64;
        let of_compared = if self.compared == 0 { 0.0 } else { self.j2j * self.compared as f64 };
        let all = (of_compared + missing) / self.assets as f64;
        let named = [
            ("j2j_all@val", all),
            ("j2j@val", self.j2j),
            ("j2b@val", self.j2b),
            ("b2b@val", self.b2b),
            ("valid@val", self.valid),
            ("joints_off@val", self.joints_off),
        ];
        named.map(|(name, value)| (name.to_string(), value)).to_vec()
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
    /// Its joints.
    pub true_joints: usize,
    /// Joints of the model's skeleton.
    pub joints: usize,
    /// The model's distances.
    pub model: SkeletonDistances,
    /// Those of the nearest training shape's skeleton.
    pub retrieval: SkeletonDistances,
    /// Those of that skeleton, fitted to the mesh.
    #[serde(default = "not_known")]
    pub template_fit: SkeletonDistances,
    /// How far the model's skeleton is from its draws on average, where it is one of several: the mean of J2J, J2B and B2B
    /// ([`riglab_metric::apart_from`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub apart: Option<f64>,
}

fn not_known() -> SkeletonDistances {
    SkeletonDistances { j2j: f64::NAN, j2b: f64::NAN, b2b: f64::NAN }
}

/// What an evaluation found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Which formulas.
    pub convention: String,
    /// How many skeletons were sampled for each mesh, of which the one counts that the others agree with most.
    #[serde(default = "one")]
    pub consensus: usize,
    /// What was changed about the model's distribution before they were sampled
    /// ([`riglab_nn::generate::GenerateConfig::draws`]).
    #[serde(default)]
    pub draws: String,
    /// Tables.
    pub rows: Vec<Row>,
    /// Assets.
    pub assets: Vec<AssetRow>,
}

fn one() -> usize {
    1
}

/// Sums over a split of one method.
#[derive(Default)]
pub(crate) struct Sums {
    assets: usize,
    valid: usize,
    distances: Vec<SkeletonDistances>,
    joints: usize,
    true_joints: usize,
    off: f64,
}

impl Sums {
    fn add(&mut self, found: Option<&Joints>, truth: &Joints) -> SkeletonDistances {
        let own = found.map_or(not_known(), |found| SkeletonConvention::Unirig.distances(found, truth));
        let (count, wanted) = (found.map_or(0, |f| f.positions.len()), truth.positions.len());
        self.assets += 1;
        self.valid += usize::from(found.is_some());
        self.joints += count;
        self.true_joints += wanted;
        self.off += count.abs_diff(wanted) as f64 / wanted as f64;
        own
    }

    /// Adds a skeleton that is compared with nothing but the truth.
    pub(crate) fn add_alone(&mut self, found: Option<&Joints>, truth: &Joints) -> SkeletonDistances {
        let own = self.add(found, truth);
        if own.j2j.is_finite() {
            self.distances.push(own);
        }
        own
    }

    /// Adds the skeletons of a part.
    pub(crate) fn add_all(&mut self, part: &Validated) {
        for (found, truth) in &part.skeletons {
            self.add_alone(found.as_ref(), truth);
        }
    }

    pub(crate) fn row(&self, split: &str, method: &str) -> Row {
        let mean =
            |f: fn(&SkeletonDistances) -> f64| self.distances.iter().map(f).sum::<f64>() / self.distances.len() as f64;
        let n = self.assets as f64;
        Row {
            split: split.into(),
            method: method.into(),
            assets: self.assets,
            compared: self.distances.len(),
            j2j: mean(|d| d.j2j),
            j2b: mean(|d| d.j2b),
            b2b: mean(|d| d.b2b),
            valid: self.valid as f64 / n,
            joints: self.joints as f64 / n,
            true_joints: self.true_joints as f64 / n,
            joints_off: self.off / n,
        }
    }
}

/// A model's skeletons beside those without learning, over a split.
#[derive(Default)]
pub(crate) struct Beside {
    sums: [Sums; 3],
    /// Whether there are training shapes to be compared with.
    rivals: bool,
}

impl Beside {
    const METHODS: [&'static str; 3] = ["model", "retrieval", "template fit"];

    pub(crate) fn to(retrieval: &Retrieval) -> Self {
        Self { rivals: !retrieval.is_empty(), ..Self::default() }
    }

    /// Adds what was found for an asset; gives the distances of each method.
    pub(crate) fn add(
        &mut self,
        found: Option<&Joints>,
        offered: Option<&Offered>,
        truth: &Joints,
    ) -> [SkeletonDistances; 3] {
        let all = [found, offered.map(|o| &o.nearest), offered.map(|o| &o.fitted)];
        let own = std::array::from_fn(|k| self.sums[k].add(all[k], truth));
        // Means are over the assets that all can be compared for.
        let compared = if self.rivals { &own[..] } else { &own[..1] };
        if compared.iter().all(|d: &SkeletonDistances| d.j2j.is_finite()) {
            self.sums.iter_mut().zip(compared).for_each(|(sums, d)| sums.distances.push(*d));
        }
        own
    }

    pub(crate) fn rows(&self, split: &str) -> impl Iterator<Item = Row> {
        let methods = if self.rivals { &Self::METHODS[..] } else { &Self::METHODS[..1] };
        self.sums.iter().zip(methods).map(move |(sums, method)| sums.row(split, method))
    }
}

pub(crate) fn joints(decoded: &Decoded) -> Joints {
    Joints { positions: decoded.joints.iter().map(|p| p.map(f64::from)).collect(), parents: decoded.parents.clone() }
}

/// What a part of a validation found; ranks tell it each other.
#[derive(Default, Serialize, Deserialize)]
pub(crate) struct Validated {
    /// Sums of losses, and of how many tokens.
    pub losses: Vec<(f64, f64)>,
    /// What was generated, if it could be decoded, and the truth.
    pub skeletons: Vec<(Option<Joints>, Joints)>,
}

impl SkeletonTask {
    /// Assets of the test splits.
    pub(super) fn examined_assets(&self) -> Result<usize, String> {
        let mut count = 0;
        for split in &self.config.data.test {
            count += self.assets.split(split).map_err(|e| e.to_string())?.len();
        }
        Ok(count)
    }

    /// Loss of what follows, and distances of what is generated, on the validation split. Ranks share the assets.
    pub(super) fn validation(&self, w: &Weights, ranks: &Ranks) -> Result<Validation, String> {
        let _no_grad = tch::no_grad_guard();
        let (mut sums, mut loss, mut tokens) = (Sums::default(), 0.0, 0.0);
        let (data, eval) = (&self.config.data, &self.config.eval);
        let assets = data.some_of(&self.validation_assets, eval.validation_assets, eval.seed);
        let mut plain = self.config.clone();
        (plain.loss.spread, plain.loss.distance, plain.loss.next) = (0.0, 0.0, 1.0);
        let parts: Vec<_> = assets.chunks(self.config.eval.rows).collect();
        let found = |k: usize| {
            let ids = parts[k];
            let mut part = Validated::default();
            let rigs =
                ids.iter().map(|&id| normalized(&self.assets, &self.cache, id)).collect::<Result<Vec<_>, _>>()?;
            let mut batch = Batch::default();
            for (rig, id) in rigs.iter().zip(ids) {
                let c = &self.config;
                let Ok(encoded) = encode(&self.tokenizer, &c.class, rig.skeleton(), true) else { continue };
                // As in training.
                if !c.limits.hold(rig.skeleton().len(), encoded.ids.len()) {
                    continue;
                }
                let mut random = stream(c.eval.seed, "skeleton evaluation", &[id.key()]);
                let (cloud, mesh) = (c.eval_cloud(), rig.mesh());
                let sampler = CloudSampler::new(mesh, &cloud);
                shape(&cloud, &c.model.shape, &sampler, &mut random, &mut batch);
                batch.lengths.push(encoded.ids.len() as i64);
                batch.ids.extend(encoded.ids.iter().map(|&id| i64::from(id)));
            }
            if batch.rigs > 0 {
                let count = (batch.ids.len() - batch.rigs) as f64;
                let own = loss_of(&self.net, &plain, w, &batch, self.device, false)?;
                part.losses = vec![(own.total().double_value(&[]) * count, count)];
            }
            let asked: Vec<_> = rigs.iter().zip(ids).map(|(rig, id)| (rig.mesh(), id.key())).collect();
            // Of a network that diverged the run goes on to say so: it makes no skeleton.
            let how = self.config().eval.generate.while_training();
            let drawn = NotFinite::unless(self.drawer().draw_as(w, &asked, &how))?;
            for (k, rig) in rigs.iter().enumerate() {
                let found = drawn.as_ref().and_then(|drawn| drawn.get(k)?.decoded.as_ref().ok());
                part.skeletons.push((found.map(joints), Joints::of(rig.skeleton())));
            }
            Ok(part)
        };
        for part in ranks.share(parts.len(), found, |_| {}).map_err(|e| e.to_string())? {
            for (own, count) in &part.losses {
                (loss, tokens) = (loss + own, tokens + count);
            }
            sums.add_all(&part);
        }
        let row = sums.row("val", "model");
        let mut metrics = row.validation();
        metrics.push(("next@val".into(), loss / tokens));
        Ok(Validation { metrics, ..Validation::default() })
    }

    /// Generates a skeleton for each asset of the test splits. Gives the report, and the skeletons in the order
    /// of its assets.
    ///
    /// # Errors
    /// When an asset cannot be read.
    pub fn evaluate(
        &self,
        w: &Weights,
        mut progress: impl FnMut(usize),
    ) -> Result<(Report, Vec<(AssetId, SkeletonSample)>), String> {
        let ids: Vec<_> = self.train_assets.iter().flat_map(|(_, ids)| ids).copied().collect();
        let (points, seed) = (self.config.eval.retrieval_points, self.config.eval.seed);
        let retrieval = Retrieval::new(&self.assets, &self.cache, &ids, points, seed)?;
        let (mut rows, mut assets, mut skeletons) = (Vec::new(), Vec::new(), Vec::new());
        for split in &self.config.data.test {
            let ids = self.assets.split(split).map_err(|e| e.to_string())?;
            let mut ways = Beside::to(&retrieval);
            for ids in ids.chunks((self.config.eval.rows / self.config.eval.consensus).max(1)) {
                let each = ids.iter().map(|&id| self.assets.read(id).map(|a| a.name).map_err(|e| e.to_string()));
                let names = each.collect::<Result<Vec<_>, _>>()?;
                let rigs =
                    ids.iter().map(|&id| normalized(&self.assets, &self.cache, id)).collect::<Result<Vec<_>, _>>()?;
                let asked: Vec<_> = rigs.iter().zip(ids).map(|(rig, id)| (rig.mesh(), id.key())).collect();
                let drawn = self.drawer().draw_agreed(w, &asked)?;
                for (((Chosen { apart, drawn, .. }, rig), name), &id) in
                    drawn.into_iter().zip(&rigs).zip(names).zip(ids)
                {
                    let truth = Joints::of(rig.skeleton());
                    let found = drawn.decoded.as_ref().ok().map(joints);
                    let offered = retrieval.offer(rig, id);
                    let [model, nearest, fitted] = ways.add(found.as_ref(), offered.as_ref(), &truth);
                    assets.push(AssetRow {
                        split: split.clone(),
                        name,
                        category: self.assets.category(id)?,
                        true_joints: truth.positions.len(),
                        joints: found.as_ref().map_or(0, |f| f.positions.len()),
                        model,
                        retrieval: nearest,
                        template_fit: fitted,
                        apart,
                    });
                    skeletons.push((id, drawn));
                    progress(assets.len());
                }
            }
            if !ids.is_empty() {
                rows.extend(ways.rows(split));
            }
        }
        if assets.is_empty() {
            let splits = self.config.data.test.join(", ");
            return Err(format!(
                "data.test: the corpora have no asset in `{splits}`; `riglab dataset inspect` shows their splits"
            ));
        }
        let c = &self.config.eval;
        let (consensus, draws) = (c.consensus, c.agreement().told(&c.generate));
        Ok((Report { convention: "unirig".into(), consensus, draws, rows, assets }, skeletons))
    }
}
