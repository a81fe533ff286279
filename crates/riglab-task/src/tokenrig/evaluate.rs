//! Evaluation by generating whole rigs.

use std::sync::Arc;

use riglab_core::{JointId, Mesh, Rig, RigError, Similarity, Skeleton, SkinWeights};
use riglab_geom::voxel::SolidConfig;
use riglab_metric::{Joints, SkinMetrics, SkinTally, every_rule, nan_for_null};
use riglab_nn::generate::NotFinite;
use riglab_nn::params::Weights;
use riglab_random::stream;
use riglab_ranks::Ranks;
use riglab_token::Decoded;
use riglab_train::Validation;
use serde::{Deserialize, Serialize};

use super::complete::part;
use super::facing::Facing;
use super::sample::{codes, sample};
use super::skin::{Codes, Hold, in_order};
use super::{Batch, Condition, RigSample, TokenRigTask, parts_of};
use crate::assets::AssetId;
use crate::fsq_cvae::evaluate::Methods;
use crate::fsq_cvae::{Prepared, Row as SkinRow};
use crate::sequences::Unfit;
use crate::unirig_skeleton::agree::Chosen;
use crate::unirig_skeleton::batch::{encode, normalized, shape};
use crate::unirig_skeleton::evaluate::{Beside, Sums, Validated, joints};
use crate::unirig_skeleton::generate::streams;
use crate::unirig_skeleton::retrieval::Retrieval;
use crate::unirig_skeleton::{AssetRow, Report as SkeletonReport};

/// What an evaluation found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// The skeletons.
    pub skeletons: SkeletonReport,
    /// The weights. `generated`: on the model's own skeleton, against the true weights, each joint's given to the
    /// generated joint nearest to it. `given`: on the true skeleton.
    pub skin: Vec<SkinRow>,
    /// Which formulas, of the weights.
    pub convention: String,
    /// The model's weights of each asset, on both skeletons.
    #[serde(default)]
    pub skin_assets: Vec<SkinAsset>,
}

/// One asset's own figures of weights.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SkinAsset {
    /// The split.
    pub split: String,
    /// The asset's name.
    pub name: String,
    /// Its category; empty where it has none.
    pub category: String,
    /// `generated` or `given`: whose skeleton.
    pub mode: String,
    /// NaN where nothing came out.
    #[serde(deserialize_with = "nan_for_null")]
    pub iou: f64,
    /// As above.
    #[serde(deserialize_with = "nan_for_null")]
    pub l1: f64,
    /// Why the true skeleton cannot be written as tokens, whatever the limits; empty where it can.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unwritten: String,
}

/// What was generated for an asset. Its rig, which has a copy of the mesh, is made again where it is to be seen
/// ([`TokenRigTask::seen_again`]): a corpus may hold more meshes than memory does.
pub(super) struct Rigged {
    /// The asset.
    pub id: AssetId,
    /// The skeleton and the codes of its skins; `None` where no skeleton came out.
    pub drawn: Option<(Decoded, Vec<Codes>)>,
    facing: Facing,
}

/// A rig as it is looked at, in the cube.
struct Posed {
    rig: Arc<Rig>,
    facing: Facing,
    /// Into the cube, after the turn.
    map: Similarity,
}

impl Posed {
    fn of(rig: &Arc<Rig>, facing: Facing) -> Result<Self, String> {
        if facing.is_none() {
            return Ok(Self { rig: rig.clone(), facing, map: Similarity::NONE });
        }
        let (rig, map) = facing.rig(rig).map_err(|e| e.to_string())?;
        Ok(Self { rig: Arc::new(rig), facing, map })
    }

    /// Joints of the turned rig, where they are in the rig as it is.
    fn joints_back(&self, mut joints: Joints) -> Joints {
        if !self.facing.is_none() {
            let back = self.map.inverse();
            let turned = |p: [f64; 3]| self.facing.back(back.apply(p.map(|x| x as f32))).map(f64::from);
            joints.positions.iter_mut().for_each(|p| *p = turned(*p));
        }
        joints
    }

    /// A rig of the turned mesh, for the mesh as it is.
    fn rig_back(&self, rig: Rig, as_it_is: &Rig) -> Result<Rig, RigError> {
        if self.facing.is_none() {
            return Ok(rig);
        }
        let back = self.map.inverse();
        let heads = rig.skeleton().heads().iter().map(|&p| self.facing.back(back.apply(p))).collect();
        Rig::new(rig.skeleton().with_heads(heads)?, as_it_is.mesh().clone(), rig.weights().clone())
    }
}

/// The ways to get weights, and what rules need to know.
struct Ways {
    methods: Methods,
    /// Where rules look for ways through the body.
    body: SolidConfig,
}

impl Ways {
    /// Adds weights, and what rules without learning make of the same skeleton and the same joints; gives the weights'
    /// own figures.
    fn all(&mut self, mode: &str, rig: &Rig, truth: &[f32], claimed: &[JointId]) -> SkinMetrics {
        let joints = rig.skeleton().len();
        let own = SkinTally::of(truth, &dense(rig.weights(), joints), joints);
        self.methods.add(format!("{mode}: model"), &own);
        if claimed.is_empty() {
            return own.metrics();
        }
        every_rule(rig, claimed, &self.body, |name, weights| {
            let mut wide = vec![0.0; truth.len()];
            for (wide, own) in wide.chunks_exact_mut(joints).zip(weights.chunks_exact(claimed.len())) {
                for (joint, w) in claimed.iter().zip(own) {
                    wide[joint.index()] = *w;
                }
            }
            self.methods.add(format!("{mode}: {name}"), &SkinTally::of(truth, &wide, joints));
        });
        own.metrics()
    }
}

/// A row of `joints` shares a vertex.
fn dense(weights: &SkinWeights, joints: usize) -> Vec<f32> {
    let mut out = vec![0.0; weights.rows() * joints];
    for (v, row) in out.chunks_exact_mut(joints).enumerate() {
        for (joint, w) in weights.row(v) {
            row[joint.index()] = w;
        }
    }
    out
}

/// The true weights on another skeleton: each joint's are given to the joint nearest to it.
fn moved(truth: &Rig, to: &Skeleton) -> Vec<f32> {
    let nearest = |p: [f32; 3]| {
        let square = |q: &[f32; 3]| (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f32>();
        let heads = to.heads();
        (0..heads.len()).min_by(|&a, &b| square(&heads[a]).total_cmp(&square(&heads[b]))).unwrap_or(0)
    };
    let place: Vec<usize> = truth.skeleton().heads().iter().map(|&p| nearest(p)).collect();
    let mut out = vec![0.0; truth.weights().rows() * to.len()];
    for (v, row) in out.chunks_exact_mut(to.len()).enumerate() {
        for (joint, w) in truth.weights().row(v) {
            row[place[joint.index()]] += w;
        }
    }
    out
}

fn claimed(codes: &[Option<Vec<i64>>]) -> Vec<JointId> {
    (0..codes.len()).filter(|&j| codes[j].is_some()).map(|j| JointId(j as u16)).collect()
}

impl TokenRigTask {
    /// Loss of what follows, and distances of what is generated, on the validation split.
    pub(super) fn validation(&self, w: &Weights, ranks: &Ranks) -> Result<Validation, String> {
        let _no_grad = tch::no_grad_guard();
        let (rigger, c) = (&self.rigger, &self.rigger.config);
        let assets = c.data.some_of(&self.validation_assets, c.eval.validation_assets, c.eval.seed);
        let teller = rigger.teller();
        let (mut sums, mut losses) = (Sums::default(), [(0.0, 0.0); 2]);
        let parts: Vec<_> = assets.chunks(c.eval.rows).collect();
        let found = |k: usize| {
            let ids = parts[k];
            let mut part = Validated::default();
            let rigs =
                ids.iter().map(|&id| normalized(&self.assets, &self.cache, id)).collect::<Result<Vec<_>, _>>()?;
            let mut batch = Batch::default();
            for (rig, id) in rigs.iter().zip(ids) {
                let mut random = stream(c.eval.seed, "rig variant", &[id.key()]);
                let class = (c.class.as_str(), true);
                let found = sample(&rigger.tokenizer, &c.skin, &teller, rig, class, &mut random);
                let Ok(sample) = found else { continue };
                // As in training.
                if !c.limits.hold(rig.skeleton().len(), sample.skeleton) {
                    continue;
                }
                let mut random = stream(c.eval.seed, "skeleton evaluation", &[id.key()]);
                let sampler = riglab_geom::CloudSampler::new(rig.mesh(), &c.sampling.cloud);
                shape(&c.sampling.cloud, &c.model.shape, &sampler, &mut random, &mut batch.shapes);
                batch.push(&sample, &teller);
            }
            if batch.shapes.rigs > 0 {
                let parts = parts_of(&rigger.net, c, w, &batch, rigger.device, false);
                let both = [(parts.skeleton, parts.skeleton_tokens), (parts.skin, parts.skin_tokens)];
                part.losses = both.map(|(sum, tokens)| (sum.double_value(&[]), tokens as f64)).to_vec();
            }
            let meshes: Vec<_> = rigs.iter().zip(ids).map(|(rig, id)| (rig.mesh(), id.key())).collect();
            let prefix = rigger.condition(w, &meshes);
            let mut streams: Vec<_> = ids.iter().map(|id| stream(c.eval.seed, "skeleton draws", &[id.key()])).collect();
            let prompts = vec![rigger.free(); ids.len()];
            // Of a network that diverged the run goes on to say so: it makes no rig.
            let how = c.eval.generate.while_training();
            let drawn = NotFinite::unless(rigger.draw(w, &prefix, &prompts, &how, &mut streams))?;
            for (k, rig) in rigs.iter().enumerate() {
                let found = drawn.as_ref().and_then(|drawn| drawn.get(k)?.decoded.as_ref().ok());
                part.skeletons.push((found.map(joints), Joints::of(rig.skeleton())));
            }
            Ok(part)
        };
        for part in ranks.share(parts.len(), found, |_| {}).map_err(|e| e.to_string())? {
            for ((sum, tokens), (own, count)) in losses.iter_mut().zip(&part.losses) {
                (*sum, *tokens) = (*sum + own, *tokens + count);
            }
            sums.add_all(&part);
        }
        let mut metrics = sums.row("val", "model").validation();
        metrics.push(("skeleton@val".into(), losses[0].0 / losses[0].1));
        metrics.push(("skin@val".into(), losses[1].0 / losses[1].1));
        Ok(Validation { metrics, ..Validation::default() })
    }

    /// A rig for each of these assets after the clouds of its shape: as `eval.generate` says, or of several
    /// skeletons the one that the others agree with most, refined, with the likeliest codes.
    fn drawn(
        &self,
        w: &Weights,
        seen: &[Condition],
        posed: &[Posed],
        ids: &[AssetId],
    ) -> Result<Vec<Chosen<RigSample>>, String> {
        let (rigger, c) = (&self.rigger, &self.rigger.config);
        let agreement = c.eval.agreement();
        let (each, shares) = (agreement.draws, agreement.shares());
        let mut streams = streams(c.eval.seed, ids.iter().map(|id| id.key()), each);
        if each == 1 {
            let firsts = Condition::firsts(seen, 1);
            let drawn = rigger.draw(w, &firsts, &vec![rigger.free(); ids.len()], &c.eval.generate, &mut streams)?;
            return Ok(drawn.into_iter().map(|drawn| Chosen { place: 0, apart: None, drawn }).collect());
        }
        let (free, firsts) = (rigger.free(), Condition::firsts(seen, shares.len()));
        let mut left = rigger.draw_skeletons(w, &firsts, (&free, &shares), &c.eval.generate, &mut streams)?;
        let mut out = Vec::with_capacity(ids.len());
        for ((own, posed), id) in seen.iter().zip(posed).zip(ids) {
            let rest = left.split_off(each);
            let plane = rigger.mirror_plane(posed.rig.mesh(), id.key());
            out.push(rigger.agreed(w, &own.first(1), (&agreement, plane), left)?);
            left = rest;
        }
        Ok(out)
    }

    /// A rig as its mesh is looked at.
    fn posed(&self, w: &Weights, rig: &Arc<Rig>, key: u64) -> Result<Posed, String> {
        Posed::of(rig, self.rigger.facing(w, rig.mesh(), key)?)
    }

    /// The true rig of an asset, and the one that was generated for it, if one was.
    ///
    /// # Errors
    /// When the asset cannot be read any more.
    pub(super) fn seen_again(&self, rigged: &Rigged) -> Result<Option<(Arc<Rig>, Rig)>, String> {
        let Some((decoded, skins)) = &rigged.drawn else { return Ok(None) };
        let truth = normalized(&self.assets, &self.cache, rigged.id)?;
        let posed = Posed::of(&truth, rigged.facing)?;
        let rig = self.rigged(posed.rig.mesh(), decoded, skins, rigged.id.key())?;
        let rig = posed.rig_back(rig, &truth).map_err(|e| e.to_string())?;
        Ok(Some((truth, rig)))
    }

    /// The rig that was drawn for a mesh.
    pub(crate) fn rigged(&self, mesh: &Mesh, decoded: &Decoded, skins: &[Codes], key: u64) -> Result<Rig, String> {
        let skeleton = decoded.skeleton().map_err(|e| e.to_string())?;
        let weights = self.rigger.skin(mesh, &skeleton, skins, key)?;
        Rig::new(skeleton, mesh.clone(), weights).map_err(|e| e.to_string())
    }

    /// Codes of an asset's joints, in their order, drawn for its true skeleton, as many as `eval.skins`, or why the skeleton
    /// has no sequence within the limits.
    fn given(&self, w: &Weights, seen: &Condition, rig: &Rig, key: u64) -> Result<Result<Vec<Codes>, Unfit>, String> {
        let (rigger, c) = (&self.rigger, &self.rigger.config);
        let encoded = match encode(&rigger.tokenizer, &c.class, rig.skeleton(), true) {
            Ok(encoded) => encoded,
            Err(fault) => return Ok(Err(fault.into())),
        };
        if !c.limits.hold(rig.skeleton().len(), encoded.ids.len()) {
            return Ok(Err(Unfit::Long));
        }
        if !rigger.draws_after(&encoded.ids, &c.eval.generate) {
            let why = rigger
                .tokenizer
                .decode(&encoded.ids)
                .err()
                .map_or_else(|| "no sequence of this model begins with its tokens".into(), |fault| fault.to_string());
            return Ok(Err(Unfit::Unwritten(why)));
        }
        let mut streams = [stream(c.eval.seed, "skin draws", &[key])];
        let prompt = std::slice::from_ref(&encoded.ids);
        let drawn = rigger.draw(w, &seen.first(1), prompt, &c.eval.generate, &mut streams)?;
        let drawn = drawn.first().ok_or("nothing was drawn for a given skeleton")?;
        let skins = rigger.skins(w, &rigger.straight(seen), drawn, c.eval.skins, key)?;
        let own = |codes| in_order(codes, &encoded.order, rig.skeleton().len());
        Ok(Ok(skins.into_iter().map(own).collect()))
    }

    /// How many assets [`Self::evaluate`] goes over.
    pub(super) fn examined_assets(&self) -> Result<usize, String> {
        let of = |split: &String| self.assets.split(split).map(|ids| ids.len()).map_err(|e| e.to_string());
        self.rigger.config.data.test.iter().map(of).sum()
    }

    /// Generates a rig for each asset of the test splits, and weights for its true skeleton. Gives the report, and what was
    /// generated in the order of its assets.
    ///
    /// # Errors
    /// When an asset cannot be read.
    pub(super) fn evaluate(
        &self,
        w: &Weights,
        progress: &mut dyn FnMut(usize),
    ) -> Result<(Report, Vec<Rigged>), String> {
        let (rigger, c) = (&self.rigger, &self.rigger.config);
        let training: Vec<_> = self.train_assets.iter().flat_map(|(_, ids)| ids).copied().collect();
        let (points, seed) = (c.eval.retrieval_points, c.eval.seed);
        let retrieval = Retrieval::new(&self.assets, &self.cache, &training, points, seed)?;
        let (mut rows, mut skin, mut assets, mut rigs) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let mut skin_assets = Vec::new();
        let body = SolidConfig { resolution: c.eval.baseline_resolution, ..SolidConfig::DEFAULT };
        for split in &c.data.test {
            let ids = self.assets.split(split).map_err(|e| e.to_string())?;
            let (mut skeletons, mut ways) = (Beside::to(&retrieval), Ways { methods: Methods::default(), body });
            let mut completed: Vec<[Sums; 2]> = c.eval.complete.iter().map(|_| Default::default()).collect();
            for ids in ids.chunks((c.eval.rows / c.eval.consensus).max(1)) {
                let each = ids.iter().map(|&id| normalized(&self.assets, &self.cache, id));
                let truths: Vec<Arc<Rig>> = each.collect::<Result<_, _>>()?;
                // All of them as they are looked at.
                let posed: Vec<Posed> =
                    truths.iter().zip(ids).map(|(rig, id)| self.posed(w, rig, id.key())).collect::<Result<_, _>>()?;
                let shape = |(posed, id): (&Posed, &AssetId)| rigger.clouds(w, posed.rig.mesh(), id.key());
                let seen: Vec<Condition> = posed.iter().zip(ids).map(shape).collect();
                let drawn = self.drawn(w, &seen, &posed, ids)?;
                let all = drawn.into_iter().zip(&seen).zip(&posed).zip(&truths).zip(ids);
                for ((((Chosen { apart, drawn, .. }, seen), posed), as_it_is), &id) in all {
                    let (truth, own) = (&posed.rig, Joints::of(as_it_is.skeleton()));
                    let found = drawn.decoded.as_ref().ok().map(|decoded| posed.joints_back(joints(decoded)));
                    let offered = retrieval.offer(as_it_is, id);
                    let [model, nearest, fitted] = skeletons.add(found.as_ref(), offered.as_ref(), &own);
                    let name = self.assets.read(id).map_err(|e| e.to_string())?.name;
                    let category = self.assets.category(id)?;
                    let skin_asset = |mode: &str, of: Option<SkinMetrics>| SkinAsset {
                        split: split.clone(),
                        name: name.clone(),
                        category: category.clone(),
                        mode: mode.into(),
                        iou: of.map_or(f64::NAN, |m| m.iou),
                        l1: of.map_or(f64::NAN, |m| m.l1),
                        unwritten: String::new(),
                    };
                    assets.push(AssetRow {
                        split: split.clone(),
                        name: name.clone(),
                        category: category.clone(),
                        true_joints: own.positions.len(),
                        joints: found.as_ref().map_or(0, |f| f.positions.len()),
                        model,
                        retrieval: nearest,
                        template_fit: fitted,
                        apart,
                    });
                    let skins = match &drawn.decoded {
                        Ok(_) => rigger.skins(w, &rigger.straight(seen), &drawn, c.eval.skins, id.key())?,
                        Err(_) => Vec::new(),
                    };
                    let rig = drawn.decoded.as_ref().ok();
                    let rig = rig.map(|decoded| self.rigged(truth.mesh(), decoded, &skins, id.key())).transpose()?;
                    let of = rig
                        .as_ref()
                        .map(|rig| ways.all("generated", rig, &moved(truth, rig.skeleton()), &claimed(&drawn.codes)));
                    skin_assets.push(skin_asset("generated", of));
                    let (of, unwritten) = match self.given(w, seen, truth, id.key())? {
                        Ok(skins) => {
                            (Some(self.on_the_true_skeleton(truth, &skins, id.key(), &mut ways)?), String::new())
                        }
                        Err(Unfit::Long) => (None, String::new()),
                        Err(Unfit::Unwritten(fault)) => (None, fault),
                    };
                    skin_assets.push(SkinAsset { unwritten, ..skin_asset("given", of) });
                    self.complete(w, seen, posed, id.key(), &mut completed)?;
                    let drawn = drawn.decoded.ok().map(|decoded| (decoded, skins));
                    rigs.push(Rigged { id, drawn, facing: posed.facing });
                    progress(assets.len());
                }
            }
            if !ids.is_empty() {
                rows.extend(skeletons.rows(split));
                for ([own, alone], share) in completed.iter().zip(&c.eval.complete) {
                    let given = format!("{:.0} % of joints given", 100.0 * share);
                    rows.push(own.row(split, &format!("model, {given}")));
                    // A root alone has no bones to compare.
                    rows.extend(Some(alone.row(split, &format!("{given}, alone"))).filter(|row| row.compared > 0));
                }
                skin.extend(ways.methods.iter().map(|(name, sums)| {
                    let learned = name.ends_with(": model") || name.ends_with(": auto-encoder");
                    sums.row(split, name, if learned { c.skin.codes } else { 0 })
                }));
            }
        }
        if assets.is_empty() {
            let splits = c.data.test.join(", ");
            return Err(format!(
                "data.test: the corpora have no asset in `{splits}`; `riglab dataset inspect` shows their splits"
            ));
        }
        let (consensus, draws) = (c.eval.consensus, c.eval.agreement().told(&c.eval.generate));
        let besides = [
            (c.eval.turn, "turned about the vertical where symmetry suggests it and samples then agree better"),
            (c.eval.symmetric && consensus > 1, "both sides made mirror images where the mesh is symmetric"),
        ];
        let all = std::iter::once(draws.as_str()).chain(besides.iter().filter(|(so, _)| *so).map(|(_, said)| *said));
        let draws = all.filter(|said| !said.is_empty()).collect::<Vec<_>>().join("; ");
        let skeletons = SkeletonReport { convention: "unirig".into(), consensus, draws, rows, assets };
        Ok((Report { skeletons, skin, convention: "skintokens".into(), skin_assets }, rigs))
    }

    /// Counts, for each share of `eval.complete`, the skeleton that the model makes of such a share of the true one, and that
    /// share alone.
    fn complete(
        &self,
        w: &Weights,
        seen: &Condition,
        posed: &Posed,
        key: u64,
        sums: &mut [[Sums; 2]],
    ) -> Result<(), String> {
        let (rigger, eval) = (&self.rigger, &self.rigger.config.eval);
        if eval.complete.is_empty() {
            return Ok(());
        }
        let agreement = eval.agreement();
        // What is given changes none of them.
        let drawn = rigger.free_draws(w, seen, &eval.generate, (&agreement, key)).ok();
        for ([own, alone], &share) in sums.iter_mut().zip(&eval.complete) {
            let mut random = stream(eval.seed, "given joints", &[key]);
            let part = part(posed.rig.skeleton(), share, &mut random).ok_or("a skeleton without joints")?;
            // One that cannot be written within the limits counts as nothing made.
            let made = |drawn: &Vec<_>| rigger.completed_by(drawn, (&part, Similarity::NONE), &agreement).ok();
            let whole = drawn.as_ref().and_then(made);
            let of = |skeleton: &Skeleton| posed.joints_back(Joints::of(skeleton));
            let truth = of(posed.rig.skeleton());
            own.add_alone(whole.as_ref().map(of).as_ref(), &truth);
            alone.add_alone(Some(&of(&part)), &truth);
        }
        Ok(())
    }

    /// Counts the weights of codes drawn for the true skeleton, and those that the auto-encoder makes of its own codes and
    /// nothing else; gives the figures of the drawn ones.
    fn on_the_true_skeleton(
        &self,
        truth: &Rig,
        drawn: &[Codes],
        key: u64,
        ways: &mut Ways,
    ) -> Result<SkinMetrics, String> {
        let (rigger, joints) = (&self.rigger, truth.skeleton().len());
        let true_weights = dense(truth.weights(), joints);
        let weights = rigger.skin(truth.mesh(), truth.skeleton(), drawn, key)?;
        let rig = truth.with_weights(weights).map_err(|e| e.to_string())?;
        let found = ways.all("given", &rig, &true_weights, &claimed(&drawn[0]));
        let mut random = stream(rigger.config.eval.seed, "rig variant", &[key]);
        let skin = &rigger.config.skin;
        let prepared = Prepared::of(String::new(), truth.clone(), !skin.empty);
        let own = codes(&rigger.vae, skin.codes, &prepared, &mut random);
        let weights = rigger.pooled_skin(truth.mesh(), truth.skeleton(), &[own], key, Hold::default())?;
        ways.methods.add("given: auto-encoder".into(), &SkinTally::of(&true_weights, &dense(&weights, joints), joints));
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Asset, Joint, Provenance};
    use riglab_data::CorpusWriter;
    use riglab_nn::tokenrig::Head;
    use riglab_train::{At, Task};
    use tch::Device;

    use super::*;
    use crate::tokenrig::TokenRigTaskConfig;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    /// A run on rigs of a split that have so many joints.
    fn task(path: &std::path::Path, split: &str, counts: &[u16], change: fn(&mut TokenRigTaskConfig)) -> TokenRigTask {
        let mut writer = CorpusWriter::create(path).unwrap();
        for count in counts {
            let joint = |j: u16| Joint {
                name: format!("j{j}"),
                parent: j.checked_sub(1).map(JointId),
                head: [0.0, f32::from(j) / f32::from(*count) - 0.5, 0.0],
            };
            let skeleton = Skeleton::new((0..*count).map(joint).collect()).unwrap();
            let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
            let rig = Rig::new(skeleton, tetrahedron(), weights).unwrap();
            let provenance = Provenance::default();
            writer.add(&Asset { name: format!("of {count}"), rig, clips: Vec::new(), provenance }).unwrap();
        }
        writer.finish(&vec![split; counts.len()]).unwrap();
        let rigger = untrained(Head::Levels, true);
        let mut config = rigger.config().clone();
        (config.data.corpora, config.data.test) = (vec![path.into()], vec!["test".into()]);
        change(&mut config);
        TokenRigTask::with(config, rigger.shared_vae(), Device::Cpu).unwrap()
    }

    #[test]
    fn a_true_skeleton_that_no_sequence_has_is_named_and_the_others_are_evaluated() {
        let dir = tempfile::tempdir().unwrap();
        let task = task(&dir.path().join("c.h5"), "test", &[1, 3], |c| c.tokenizer.least_joints = 2);
        let (report, _) = task.evaluate(task.params().weights(), &mut |_| ()).unwrap();
        let given: Vec<&SkinAsset> = report.skin_assets.iter().filter(|a| a.mode == "given").collect();
        assert_eq!(given.iter().map(|a| &*a.name).collect::<Vec<_>>(), ["of 1", "of 3"]);
        assert!(!given[0].unwritten.is_empty() && given[0].iou.is_nan(), "{given:?}");
        assert!(given[1].unwritten.is_empty() && given[1].l1.is_finite(), "{given:?}");
    }

    #[test]
    fn validation_losses_are_of_rigs_that_are_trained_on() {
        let dir = tempfile::tempdir().unwrap();
        let lost = |name: &str, counts: &[u16]| {
            let task = task(&dir.path().join(name), "val", counts, |c| c.limits.joints = 3);
            let at = At { seed: 0, step: 0, batch: 0, ranks: &riglab_ranks::ALONE };
            let found = task.validate(task.params().weights(), at).unwrap().metrics;
            found.iter().find(|(name, _)| name == "skeleton@val").unwrap().1
        };
        // Four joints have room in as many tokens as there are, but are too many.
        assert!(lost("within.h5", &[3]).is_finite() && lost("beyond.h5", &[4]).is_nan());
    }
}
