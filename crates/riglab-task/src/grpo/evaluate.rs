//! Rewards, and distances to the true skeletons, of rigs on meshes that are not trained on.

use std::sync::Arc;

use riglab_core::{Mesh, Rig};
use riglab_geom::CloudSampler;
use riglab_metric::statistics::Paired;
use riglab_metric::{Joints, SkeletonDistances};
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::Weights;
use riglab_random::stream;
use riglab_ranks::Ranks;
use riglab_render::{Picture, Theme, View, contact_sheet, render_parts, render_skeleton};
use riglab_report::Turntable;
use riglab_reward::{Rewards, Scorer};
use riglab_train::{At, Validation};
use tch::Tensor;

use super::batch::Subject;
use super::report::{AssetRow, AssetScore, Gain, Report, Row, ShownAsset};
use super::score::rewards;
use super::{First, GrpoTask};
use crate::assets::AssetId;
use crate::experiment::{Sheet, places, sheet_file};
use crate::tokenrig::RigSample;
use crate::unirig_skeleton::Batch as Shapes;
use crate::unirig_skeleton::batch::{bytes_of, in_cube, shape};
use crate::unirig_skeleton::evaluate::{Sums, joints};

/// Rigs drawn of the mesh whose best and worst are shown.
const SHOWN: usize = 8;
/// Side of one picture, in pixels.
const SIDE: u32 = 280;

/// A mesh whose true rig is known.
pub struct JudgedMesh {
    id: AssetId,
    rig: Rig,
    subject: Subject,
}

impl JudgedMesh {
    /// About how many bytes it takes: it has the mesh twice.
    fn bytes(&self) -> usize {
        2 * bytes_of(&self.rig) + self.subject.scorer.bytes()
    }
}

/// What a model makes of one.
struct Outcome {
    drawn: RigSample,
    rewards: Rewards,
    distances: SkeletonDistances,
}

/// How rigs of a mesh are made.
#[derive(Clone, Copy, PartialEq)]
enum How {
    /// So many, drawn as in training.
    Draws(usize),
    /// One, as `eval.generate` says.
    Own,
}

impl How {
    fn count(self) -> usize {
        match self {
            Self::Draws(count) => count,
            Self::Own => 1,
        }
    }

    /// What it is called, with what it adds to the name of a model.
    fn name(self, generate: &GenerateConfig) -> &'static str {
        match self {
            Self::Draws(_) => "",
            Self::Own if generate.sample => ", filtered",
            Self::Own => ", greedy",
        }
    }
}

/// Sums of a split.
#[derive(Default)]
struct Tally {
    sums: Sums,
    rewards: Vec<Rewards>,
    /// J2J to the true rigs that have one, with 1 of each draw that is no skeleton.
    known: Vec<f64>,
}

impl Tally {
    fn add(&mut self, held: &JudgedMesh, drawn: RigSample, rewards: Rewards) -> Outcome {
        let found = drawn.decoded.as_ref().ok().map(joints);
        let distances = self.add_rig(found.as_ref(), &Joints::of(held.rig.skeleton()), rewards);
        Outcome { drawn, rewards, distances }
    }

    fn add_rig(&mut self, found: Option<&Joints>, truth: &Joints, rewards: Rewards) -> SkeletonDistances {
        self.rewards.push(rewards);
        let own = self.sums.add_alone(found, truth);
        // A bare mesh has one joint in its middle, to which nothing is compared.
        if truth.positions.len() > 1 {
            self.known.push(if own.j2j.is_finite() { own.j2j } else { 1.0 });
        }
        own
    }

    /// The mean J2J by which the guard tells how much worse skeletons got; `None` where no true rig is known.
    fn guarded(&self) -> Option<f64> {
        (!self.known.is_empty()).then(|| self.known.iter().sum::<f64>() / self.known.len() as f64)
    }

    fn row(&self, split: &str, model: &str) -> Row {
        Row { rewards: Rewards::mean(&self.rewards), skeletons: self.sums.row(split, model) }
    }
}

/// Rigs of the same meshes by one model.
#[derive(Default)]
struct Side {
    tally: Tally,
    found: Vec<Outcome>,
}

/// By both models.
#[derive(Default)]
struct Pair {
    before: Side,
    after: Side,
}

impl Pair {
    /// Mesh by mesh, of which each has `count` rigs.
    fn gain(&self, split: &str, count: usize) -> Gain {
        let means = |side: &Side, of: fn(&Outcome) -> f64| -> Vec<f64> {
            let mean = |own: &[Outcome]| {
                let known: Vec<f64> = own.iter().map(of).filter(|x| x.is_finite()).collect();
                known.iter().sum::<f64>() / known.len() as f64
            };
            side.found.chunks(count).map(mean).collect()
        };
        let paired = |of| Paired::of(&means(&self.after, of), &means(&self.before, of));
        Gain { split: split.into(), reward: paired(|f| f.rewards.total), j2j: paired(|f| f.distances.j2j) }
    }
}

/// What a validation logs; what compares with true rigs only where some are known, with `j2j` as their mean.
fn metrics(row: &Row, first: First, within: bool, j2j: Option<f64>) -> Vec<(String, f64)> {
    let r = row.rewards;
    let mut metrics = row.skeletons.validation();
    match j2j {
        Some(j2j) => metrics.iter_mut().filter(|(name, _)| name == "j2j_all@val").for_each(|(_, value)| *value = j2j),
        None => metrics.retain(|(name, _)| name == "valid@val"),
    }
    metrics.push(("reward@val".into(), r.total));
    metrics.extend(Rewards::PARTS.iter().zip(r.parts()).map(|(part, value)| (format!("{}@val", part.name), value)));
    metrics.extend(j2j.map(|_| ("start_j2j@val".into(), first.j2j)));
    metrics.push(("start_reward@val".into(), first.reward));
    // What is not finite never is the best.
    metrics.push(("guarded_reward@val".into(), if within { r.total } else { f64::NAN }));
    metrics
}

impl GrpoTask {
    fn held_of(&self, id: AssetId) -> Result<JudgedMesh, String> {
        let pool = self.policy.pool();
        let rig = in_cube(pool.assets, id)?;
        let scorer = Scorer::new(rig.mesh(), &self.config.reward);
        let name = pool.assets.name(id).map_err(|e| e.to_string())?;
        let subject = Subject { key: id.key(), name, mesh: rig.mesh().clone(), scorer };
        Ok(JudgedMesh { id, rig, subject })
    }

    /// Reads the shapes of meshes in the cube, [b, p, d]; `keys` seed the points.
    fn condition(&self, w: &Weights, meshes: &[(&Mesh, u64)]) -> Tensor {
        let ((cloud, model), mut batch) = (self.policy.reads(), Shapes::default());
        for (mesh, key) in meshes {
            let mut random = stream(self.config.eval.seed, "skeleton evaluation", &[*key]);
            shape(&cloud, model, &CloudSampler::new(mesh, &cloud), &mut random, &mut batch);
        }
        self.policy.prefix(w, &batch)
    }

    /// Makes rigs of each mesh and judges them, those of a mesh one after another.
    fn judge(&self, w: &Weights, all: &[&JudgedMesh], how: How, tally: &mut Tally) -> Result<Vec<Outcome>, String> {
        let c = &self.config;
        let (count, generate) = match how {
            How::Draws(count) => (count, c.draws()),
            How::Own => (1, c.eval.generate.clone()),
        };
        let numbered: Vec<(&JudgedMesh, u64)> =
            all.iter().flat_map(|h| (0..count as u64).map(move |k| (*h, k))).collect();
        let mut out = Vec::with_capacity(numbered.len());
        for part in numbered.chunks(c.eval.rows) {
            let meshes: Vec<_> = part.iter().map(|(h, _)| (h.rig.mesh(), h.id.key())).collect();
            let prefix = self.condition(w, &meshes);
            let draws = |(h, k): &(&JudgedMesh, u64)| stream(c.eval.seed, "skeleton draws", &[h.id.key(), *k]);
            let mut streams: Vec<_> = part.iter().map(draws).collect();
            let meshes: Vec<&Mesh> = part.iter().map(|(h, _)| h.rig.mesh()).collect();
            let drawn = self.policy.draw(w, (&prefix, &meshes), &generate, &mut streams)?;
            let judged = self.judged(c.eval.vertices.min(c.rollout.vertices), c.eval.seed);
            for (drawn, (held, _)) in drawn.into_iter().zip(part) {
                let own = rewards(self.policy.vae(), &held.subject, std::slice::from_ref(&drawn), &judged)?;
                out.push(tally.add(held, drawn, own[0]));
            }
        }
        Ok(out)
    }

    /// What counts while training.
    fn counted(&self) -> How {
        match self.config.held_out.draws {
            0 => How::Own,
            count => How::Draws(count),
        }
    }

    /// Assets of the validation split, the same ones each time.
    fn validated(&self) -> Vec<AssetId> {
        let c = &self.config.eval;
        self.config.data.some_of(self.policy.pool().validate, c.validation_assets, c.seed)
    }

    /// One of them, made ready or kept from before.
    fn held(&self, id: AssetId) -> Result<Arc<JudgedMesh>, String> {
        self.held.get(id, || {
            let made = self.held_of(id)?;
            let bytes = made.bytes();
            Ok((made, bytes))
        })
    }

    /// The row of the validation split, and what the guard looks at. Ranks share the meshes.
    fn validation_row(&self, w: &Weights, all: &[AssetId], ranks: &Ranks) -> Result<(Row, Option<f64>), String> {
        let how = self.counted();
        let parts: Vec<_> = all.chunks((self.config.eval.rows / how.count()).max(1)).collect();
        let judged = |k: usize| {
            let held = parts[k].iter().map(|&id| self.held(id)).collect::<Result<Vec<_>, _>>()?;
            let meshes: Vec<&JudgedMesh> = held.iter().map(|h| &**h).collect();
            let found = self.judge(w, &meshes, how, &mut Tally::default())?;
            let truths = meshes.iter().flat_map(|h| (0..how.count()).map(|_| Joints::of(h.rig.skeleton())));
            let told = |(found, truth): (Outcome, Joints)| {
                (found.drawn.decoded.as_ref().ok().map(joints), truth, found.rewards)
            };
            Ok(found.into_iter().zip(truths).map(told).collect::<Vec<_>>())
        };
        let mut tally = Tally::default();
        for (found, truth, rewards) in ranks.share(parts.len(), judged, |_| {}).map_err(|e| e.to_string())?.concat() {
            tally.add_rig(found.as_ref(), &truth, rewards);
        }
        Ok((tally.row("val", "policy"), tally.guarded()))
    }

    /// Rewards and distances on the validation split, and how far the distances may worsen.
    pub(super) fn validation(&self, w: &Weights, at: At) -> Result<Validation, String> {
        let _no_grad = tch::no_grad_guard();
        let all = self.validated();
        let first = match self.first.get() {
            Some(first) => first,
            None => {
                let (row, j2j) = self.validation_row(&self.start, &all, at.ranks)?;
                // Without true rigs skeletons get neither better nor worse.
                let first = First { j2j: j2j.unwrap_or(1.0), reward: row.rewards.total };
                self.first.set(Some(first));
                first
            }
        };
        let (row, j2j) = self.validation_row(w, &all, at.ranks)?;
        let (own, worse) = (j2j.unwrap_or(first.j2j), self.config.guard.worse);
        let within = own <= first.j2j * worse;
        let r = row.rewards;
        let metrics = metrics(&row, first, within, j2j);
        let mut warnings = Vec::new();
        if !within {
            warnings.push(format!(
                "J2J × 100 is {:.2}, {:.2} at the start: the skeletons got worse than guard.worse = {worse} allows, \
                 so this checkpoint cannot become the best one",
                100.0 * own,
                100.0 * first.j2j
            ));
        }
        if r.total < first.reward {
            warnings.push(format!(
                "the mean reward is {:.4}; the model that the run started from has {:.4}, so this is no better yet",
                r.total, first.reward
            ));
        }
        let shown = all.first().filter(|_| at.ranks.leads());
        let sheet = shown.map(|&id| self.picture(w, &*self.held(id)?)).transpose()?.flatten();
        let picture = |p: Picture| ("rigs/best_and_worst".into(), p.width() as u32, p.height() as u32, p.to_png());
        Ok(Validation { metrics, pictures: sheet.into_iter().map(picture).collect(), warnings })
    }

    /// The best and the worst of a few rigs of one mesh.
    fn picture(&self, w: &Weights, held: &JudgedMesh) -> Result<Option<Picture>, String> {
        let c = &self.config;
        let prefix = self.condition(w, &[(held.rig.mesh(), held.id.key())]);
        let mut streams: Vec<_> = (0..SHOWN as u64).map(|k| stream(c.eval.seed, "shown draws", &[k])).collect();
        let drawn = self.policy.draw(w, (&prefix, &[held.rig.mesh()]), &c.draws(), &mut streams)?;
        let judged = self.judged(c.rollout.vertices, c.eval.seed);
        let worth = rewards(self.policy.vae(), &held.subject, &drawn, &judged)?;
        let by = |a: &usize, b: &usize| worth[*a].total.total_cmp(&worth[*b].total);
        let (best, worst) = ((0..SHOWN).max_by(by), (0..SHOWN).min_by(by));
        let view = View::square(SIDE).framed(self.upright(&held.rig)?.bounds());
        let mut cells = Vec::new();
        for (name, k) in [("best", best), ("worst", worst)] {
            let Some(k) = k else { continue };
            let Some(rig) = self.rig(held, &drawn[k])? else { continue };
            let told = format!("{name} of {SHOWN}: {:.3}", worth[k].total);
            cells.push((told, render_skeleton(&rig, &view)));
            cells.push((format!("{name}, parts"), render_parts(&rig, &view)));
        }
        if cells.is_empty() {
            return Ok(None);
        }
        Ok(Some(contact_sheet(&cells, 2, Theme::Light)))
    }

    fn upright(&self, rig: &Rig) -> Result<Rig, String> {
        self.policy.up().upright(rig).map_err(|e| e.to_string())
    }

    /// As it is shown to people.
    fn rig(&self, held: &JudgedMesh, drawn: &RigSample) -> Result<Option<Rig>, String> {
        let rig = self.policy.rig(held.rig.mesh(), drawn, held.id.key())?;
        rig.map(|rig| self.upright(&rig)).transpose()
    }

    /// The ways in which [`Self::compare`] makes rigs, and how many it makes.
    fn ways(&self) -> Vec<How> {
        let mut ways = vec![self.counted(), How::Own];
        ways.dedup();
        ways
    }

    /// How many rigs [`Self::compare`] makes.
    pub(super) fn examined(&self) -> Result<usize, String> {
        let assets = self.policy.pool().assets;
        let of = |split: &String| assets.split(split).map(|ids| ids.len()).map_err(|e| e.to_string());
        let all: usize = self.config.data.test.iter().map(of).sum::<Result<usize, String>>()?;
        Ok(2 * all * self.ways().into_iter().map(How::count).sum::<usize>())
    }

    /// Rigs of the test splits before and after, with pictures of some.
    #[allow(clippy::type_complexity)] // a report, and its pictures by file
    pub(super) fn compare(
        &self,
        w: &Weights,
        pictures: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<(Report, Vec<(ShownAsset, Sheet)>), String> {
        let _no_grad = tch::no_grad_guard();
        let ways = self.ways();
        let (mut rows, mut gains, mut assets, mut sheets, mut done) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new(), 0);
        for split in &self.config.data.test {
            let ids = self.policy.pool().assets.split(split).map_err(|e| e.to_string())?;
            let mut all: Vec<Pair> = ways.iter().map(|_| Pair::default()).collect();
            for ids in ids.chunks(self.config.eval.rows) {
                let held = ids.iter().map(|&id| self.held_of(id)).collect::<Result<Vec<_>, _>>()?;
                let held: Vec<&JudgedMesh> = held.iter().collect();
                for (how, pair) in ways.iter().zip(&mut all) {
                    for (w, side) in [(&self.start, &mut pair.before), (w, &mut pair.after)] {
                        let found = self.judge(w, &held, *how, &mut side.tally)?;
                        done += found.len();
                        side.found.extend(found);
                        progress(done);
                    }
                }
            }
            if ids.is_empty() {
                continue;
            }
            for (how, pair) in ways.iter().zip(&all) {
                let of = |when: &str| format!("{when}{}", how.name(&self.config.eval.generate));
                rows.extend([pair.before.tally.row(split, &of("before")), pair.after.tally.row(split, &of("after"))]);
                gains.push(pair.gain(split, how.count()));
            }
            let Some(Pair { before, after }) = all.pop() else { continue };
            let mut found: Vec<(AssetId, Outcome, Outcome)> =
                before.found.into_iter().zip(after.found).zip(&ids).map(|((was, is), &id)| (id, was, is)).collect();
            for (id, was, is) in &found {
                let judged = |f: &Outcome| AssetScore {
                    reward: f.rewards.total,
                    rewards: Some(f.rewards),
                    distances: f.distances,
                };
                assets.push(AssetRow {
                    split: split.clone(),
                    name: self.policy.pool().assets.name(*id).map_err(|e| e.to_string())?,
                    category: self.policy.pool().assets.category(*id)?,
                    before: judged(was),
                    after: judged(is),
                });
            }
            // From the most gained to the most lost.
            let gain = |(_, was, is): &(AssetId, Outcome, Outcome)| is.rewards.total - was.rewards.total;
            found.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
            for (why, k) in if pictures == 0 { Vec::new() } else { places(found.len(), pictures) } {
                let (id, was, is) = &found[k];
                if let Some(sheet) = self.sheet(*id, was, is)? {
                    let file = sheet_file(sheets.len() + 1, split, why);
                    let name = self.policy.pool().assets.name(*id).map_err(|e| e.to_string())?;
                    let (gain, j2j) = (is.rewards.total - was.rewards.total, is.distances.j2j - was.distances.j2j);
                    sheets.push((ShownAsset { file, split: split.clone(), name, why: why.into(), gain, j2j }, sheet));
                }
            }
        }
        if rows.is_empty() {
            let splits = self.config.data.test.join(", ");
            return Err(format!(
                "data.test: the corpora have no asset in `{splits}`; `riglab dataset inspect` shows their splits"
            ));
        }
        let (convention, reward_weights) = ("unirig".into(), Some(self.config.reward.weights));
        let without_weights = self.policy.rigger().is_none();
        Ok((Report { convention, reward_weights, without_weights, rows, gains, assets }, sheets))
    }

    fn sheet(&self, id: AssetId, was: &Outcome, is: &Outcome) -> Result<Option<Sheet>, String> {
        let held = self.held_of(id)?;
        let truth = self.upright(&held.rig)?;
        let view = View::square(SIDE).framed(truth.bounds());
        let (Some(old), Some(new)) = (self.rig(&held, &was.drawn)?, self.rig(&held, &is.drawn)?) else {
            return Ok(None);
        };
        // A skeleton model says nothing of what its bones hold.
        let of = if self.policy.rigger().is_some() { "parts" } else { "nearest bones" };
        let parts = |when: &str| format!("{of} {when}");
        let cells = [
            (format!("before, {:.3}", was.rewards.total), render_skeleton(&old, &view)),
            (format!("after, {:.3}", is.rewards.total), render_skeleton(&new, &view)),
            (parts("before"), render_parts(&old, &view)),
            (parts("after"), render_parts(&new, &view)),
        ];
        let view = Turntable::of(&[("true", &truth), ("before", &old), ("after", &new)]);
        Ok(Some(Sheet { png: contact_sheet(&cells, 4, Theme::Light).to_png(), view }))
    }
}

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::Head;

    use super::*;
    use crate::grpo::GrpoTaskConfig;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    /// A run on two meshes, with so much memory for them.
    fn task(dir: &std::path::Path, cache_mb: usize) -> GrpoTask {
        let path = dir.join(format!("{cache_mb}.h5"));
        let mut writer = riglab_data::CorpusWriter::create(&path).unwrap();
        for (name, tip) in [("a", 0.5), ("b", 0.75)] {
            let joint = |name: &str, parent, y| riglab_core::Joint { name: name.into(), parent, head: [0.0, y, 0.0] };
            let joints = vec![joint("root", None, 0.0), joint("tip", Some(riglab_core::JointId(0)), tip)];
            let weights = riglab_core::SkinWeights::normalized((0..4).map(|v| [(v % 2, 1.0)])).unwrap();
            let skeleton = riglab_core::Skeleton::new(joints).unwrap();
            let rig = Rig::new(skeleton, tetrahedron(), weights).unwrap();
            let provenance = riglab_core::Provenance::default();
            writer.add(&riglab_core::Asset { name: name.into(), rig, clips: Vec::new(), provenance }).unwrap();
        }
        writer.finish(&["val"; 2]).unwrap();
        let mut config = GrpoTaskConfig::default();
        (config.data.corpora, config.data.cache_mb) = (vec![path], cache_mb);
        (config.reward.resolution, config.held_out.draws, config.eval.rows) = (8, 2, 2);
        GrpoTask::with(config, &untrained(Head::Levels, true), tch::Device::Cpu).unwrap()
    }

    #[test]
    fn meshes_are_kept_while_there_is_memory_for_them_which_changes_nothing() {
        let dir = tempfile::tempdir().unwrap();
        let [little, much] = [0, 64].map(|cache_mb| {
            let task = task(dir.path(), cache_mb);
            let at = At { seed: 0, step: 0, batch: 0, ranks: &riglab_ranks::ALONE };
            let validation = task.validation(task.policy.params().weights(), at).unwrap();
            let kept = task.held.kept();
            assert!(kept[1] > 4 * 8 * 8 * 8, "{kept:?}");
            (validation.metrics, kept[0])
        });
        assert_eq!([little.1, much.1], [1, 2], "the last one is always kept");
        assert_eq!(little.0, much.0);
    }

    #[test]
    fn meshes_without_rigs_are_not_compared_with_any() {
        let skeletons = serde_json::json!({"split": "val", "method": "policy", "assets": 7, "compared": 0, "j2j": null,
            "j2b": null, "b2b": null, "valid": 1.0, "joints": 9.0, "true_joints": 1.0, "joints_off": 8.0});
        let rewards = Rewards::of([0.5; 4], [5.0, 1.0, 1.0, 1.0]);
        let row = Row { rewards, skeletons: serde_json::from_value(skeletons).unwrap() };
        let names = |j2j: Option<f64>| -> Vec<String> {
            metrics(&row, First { j2j: 1.0, reward: 4.0 }, true, j2j).into_iter().map(|(name, _)| name).collect()
        };
        let bare =
            ["valid", "reward", "coverage", "containment", "skinning", "motion", "start_reward", "guarded_reward"];
        assert_eq!(names(None), bare.map(|name| format!("{name}@val")));
        let more = ["j2j_all@val", "j2j@val", "j2b@val", "b2b@val", "joints_off@val", "start_j2j@val"];
        let all = names(Some(0.1));
        assert!(more.iter().all(|name| all.iter().any(|own| own == name)) && all.len() == 8 + 6);
    }

    #[test]
    fn the_guard_looks_at_rigs_that_are_known_and_counts_draws_that_are_none() {
        let rewards = Rewards::of([0.5; 4], [5.0, 1.0, 1.0, 1.0]);
        let of = |n: usize, x: f64| Joints {
            positions: (0..n).map(|k| [x, k as f64, 0.0]).collect(),
            parents: (0..n).map(|k| k.checked_sub(1)).collect(),
        };
        let mut tally = Tally::default();
        assert_eq!(tally.guarded(), None);
        for _ in 0..5 {
            tally.add_rig(Some(&of(3, 0.0)), &of(1, 0.0), rewards);
        }
        assert_eq!(tally.guarded(), None, "bare meshes alone");
        let near = tally.add_rig(Some(&of(3, 0.1)), &of(3, 0.0), rewards).j2j;
        assert!(near < 0.2 && tally.guarded() == Some(near), "beside bare meshes");
        tally.add_rig(None, &of(3, 0.0), rewards);
        assert_eq!(tally.guarded(), Some((near + 1.0) / 2.0));
    }
}
