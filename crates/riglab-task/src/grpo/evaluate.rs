//! Rewards, and distances to the true skeletons, of rigs on meshes that are not trained on.

use std::sync::Arc;

use riglab_core::Rig;
use riglab_metric::{Joints, SkeletonDistances};
use riglab_nn::params::Weights;
use riglab_random::{Draw, stream};
use riglab_render::{Picture, Theme, View, contact_sheet, render_parts, render_skeleton};
use riglab_reward::{Rewards, Scorer};
use riglab_train::{At, Validation};

use super::GrpoTask;
use super::batch::Subject;
use super::report::{Report, Row, Shown};
use super::score::rewards;
use crate::assets::AssetId;
use crate::experiment::places;
use crate::tokenrig::Drawn;
use crate::unirig_skeleton::batch::normalized;
use crate::unirig_skeleton::evaluate::{Sums, joints};

/// Rigs drawn of the mesh whose best and worst are shown.
const SHOWN: usize = 8;
/// Side of one picture, in pixels.
const SIDE: u32 = 280;

/// A mesh whose true rig is known.
pub struct Held {
    id: AssetId,
    rig: Arc<Rig>,
    subject: Subject,
}

/// What a model makes of one.
struct Found {
    drawn: Drawn,
    rewards: Rewards,
    distances: SkeletonDistances,
}

/// Sums of a split.
#[derive(Default)]
struct Tally {
    sums: Sums,
    rewards: Vec<Rewards>,
}

impl Tally {
    fn add(&mut self, held: &Held, drawn: Drawn, rewards: Rewards) -> Found {
        let found = drawn.decoded.as_ref().ok().map(joints);
        let distances = self.sums.add(found.as_ref(), &Joints::of(held.rig.skeleton()));
        self.sums.count(distances, distances);
        self.rewards.push(rewards);
        Found { drawn, rewards, distances }
    }

    fn row(&self, split: &str, model: &str) -> Row {
        let n = self.rewards.len() as f64;
        let mean = |of: fn(&Rewards) -> f64| self.rewards.iter().map(of).sum::<f64>() / n;
        Row {
            rewards: Rewards {
                coverage: mean(|r| r.coverage),
                containment: mean(|r| r.containment),
                skinning: mean(|r| r.skinning),
                motion: mean(|r| r.motion),
                total: mean(|r| r.total),
            },
            skeletons: self.sums.row(split, model),
        }
    }
}

impl GrpoTask {
    fn held_of(&self, id: AssetId) -> Result<Held, String> {
        let rig = normalized(&self.inner.assets, &self.inner.cache, id)?;
        let scorer = Scorer::new(rig.mesh(), &self.config.reward);
        let subject = Subject { key: id.key(), mesh: rig.mesh().clone(), scorer };
        Ok(Held { id, rig, subject })
    }

    /// Draws a rig for each mesh as `eval.generate` says, and judges it.
    fn judge(&self, w: &Weights, all: &[&Held], tally: &mut Tally) -> Result<Vec<Found>, String> {
        let (c, rigger) = (&self.config, self.rigger());
        let meshes: Vec<_> = all.iter().map(|h| (h.rig.mesh(), h.id.key())).collect();
        let prefix = rigger.condition(w, &meshes);
        let mut streams: Vec<_> = all.iter().map(|h| stream(c.eval.seed, "skeleton draws", &[h.id.key()])).collect();
        let drawn = rigger.draw(w, &prefix, &vec![rigger.free(); all.len()], &c.eval.generate, &mut streams)?;
        let judged = self.judged(c.eval.vertices.min(c.rollout.vertices), c.eval.seed);
        let each = drawn.into_iter().zip(all).map(|(drawn, held)| {
            let own = rewards(rigger.vae(), &held.subject, std::slice::from_ref(&drawn), &judged)?;
            Ok(tally.add(held, drawn, own[0]))
        });
        each.collect()
    }

    /// Meshes of the validation split, the same ones each time.
    fn validation_meshes(&self) -> Result<Vec<Arc<Held>>, String> {
        if let Some(all) = &*self.held.borrow() {
            return Ok(all.clone());
        }
        let c = &self.config.eval;
        let mut ids = self.inner.validation_assets.clone();
        stream(c.seed, "validation assets", &[]).shuffled(&mut ids);
        ids.truncate(if c.validation_assets == 0 { usize::MAX } else { c.validation_assets });
        let all = ids.into_iter().map(|id| self.held_of(id).map(Arc::new)).collect::<Result<Vec<_>, _>>()?;
        self.held.replace(Some(all.clone()));
        Ok(all)
    }

    fn validation_row(&self, w: &Weights, all: &[Arc<Held>]) -> Result<Row, String> {
        let mut tally = Tally::default();
        for part in all.chunks(self.config.eval.rows) {
            self.judge(w, &part.iter().map(|h| &**h).collect::<Vec<_>>(), &mut tally)?;
        }
        Ok(tally.row("val", "policy"))
    }

    /// Rewards and distances on the validation split, and how far the distances may worsen.
    pub(super) fn validation(&self, w: &Weights, _at: At) -> Result<Validation, String> {
        let _no_grad = tch::no_grad_guard();
        let all = self.validation_meshes()?;
        let of = |row: &Row| row.skeletons.validation().first().map_or(f64::NAN, |(_, j2j)| *j2j);
        let first = match self.first.get() {
            Some(first) => first,
            None => {
                let first = of(&self.validation_row(&self.start, &all)?);
                self.first.set(Some(first));
                first
            }
        };
        let row = self.validation_row(w, &all)?;
        let (own, worse) = (of(&row), self.config.guard.worse);
        let within = own <= first * worse;
        let r = row.rewards;
        let mut metrics = row.skeletons.validation();
        for (name, value) in [
            ("reward@val", r.total),
            ("coverage@val", r.coverage),
            ("containment@val", r.containment),
            ("skinning@val", r.skinning),
            ("motion@val", r.motion),
            ("start_j2j@val", first),
            // What is not finite never is the best.
            ("guarded_reward@val", if within { r.total } else { f64::NAN }),
        ] {
            metrics.push((name.into(), value));
        }
        let mut warnings = Vec::new();
        if !within {
            warnings.push(format!(
                "J2J is {own:.4}, that of the start was {first:.4}: rewards are gained at the cost of the skeletons. This \
                 checkpoint cannot become the best one (guard.worse = {worse})"
            ));
        }
        let sheet = all.first().map(|held| self.picture(w, held)).transpose()?.flatten();
        let picture = |p: Picture| ("rigs/best_and_worst".into(), p.width() as u32, p.height() as u32, p.to_png());
        Ok(Validation { metrics, pictures: sheet.into_iter().map(picture).collect(), warnings })
    }

    /// The best and the worst of a few rigs of one mesh.
    fn picture(&self, w: &Weights, held: &Held) -> Result<Option<Picture>, String> {
        let (c, rigger) = (&self.config, self.rigger());
        let prefix = rigger.condition(w, &[(held.rig.mesh(), held.id.key())]);
        let mut streams: Vec<_> = (0..SHOWN as u64).map(|k| stream(c.eval.seed, "shown draws", &[k])).collect();
        let drawn = rigger.draw(w, &prefix, &vec![rigger.free(); SHOWN], &c.draws(), &mut streams)?;
        let judged = self.judged(c.rollout.vertices, c.eval.seed);
        let worth = rewards(rigger.vae(), &held.subject, &drawn, &judged)?;
        let by = |a: &usize, b: &usize| worth[*a].total.total_cmp(&worth[*b].total);
        let (best, worst) = ((0..SHOWN).max_by(by), (0..SHOWN).min_by(by));
        let view = View::square(SIDE).framed(held.rig.bounds());
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

    fn rig(&self, held: &Held, drawn: &Drawn) -> Result<Option<Rig>, String> {
        let Ok(decoded) = &drawn.decoded else { return Ok(None) };
        self.inner.rigged(held.rig.mesh(), decoded, &drawn.codes, held.id.key()).map(Some)
    }

    /// How many rigs [`Self::compare`] makes.
    pub(super) fn examined(&self) -> Result<usize, String> {
        let of = |split: &String| self.inner.assets.split(split).map(|ids| ids.len()).map_err(|e| e.to_string());
        let all: usize = self.config.data.test.iter().map(of).sum::<Result<usize, String>>()?;
        Ok(2 * all)
    }

    /// Rigs of the test splits before and after, with pictures of some.
    #[allow(clippy::type_complexity)] // a report, and its pictures by file
    pub(super) fn compare(
        &self,
        w: &Weights,
        pictures: usize,
        progress: &mut dyn FnMut(usize),
    ) -> Result<(Report, Vec<(Shown, Vec<u8>)>), String> {
        let _no_grad = tch::no_grad_guard();
        let (mut rows, mut sheets, mut done) = (Vec::new(), Vec::new(), 0);
        for split in &self.config.data.test {
            let ids = self.inner.assets.split(split).map_err(|e| e.to_string())?;
            let (mut before, mut after) = (Tally::default(), Tally::default());
            let mut found: Vec<(AssetId, Found, Found)> = Vec::new();
            for ids in ids.chunks(self.config.eval.rows) {
                let held = ids.iter().map(|&id| self.held_of(id)).collect::<Result<Vec<_>, _>>()?;
                let held: Vec<&Held> = held.iter().collect();
                let was = self.judge(&self.start, &held, &mut before)?;
                done += ids.len();
                progress(done);
                let is = self.judge(w, &held, &mut after)?;
                done += ids.len();
                progress(done);
                found.extend(was.into_iter().zip(is).zip(ids).map(|((was, is), &id)| (id, was, is)));
            }
            if ids.is_empty() {
                continue;
            }
            rows.extend([before.row(split, "before"), after.row(split, "after")]);
            // From the most gained to the most lost.
            let gain = |(_, was, is): &(AssetId, Found, Found)| is.rewards.total - was.rewards.total;
            found.sort_by(|a, b| gain(b).total_cmp(&gain(a)));
            for (why, k) in if pictures == 0 { Vec::new() } else { places(found.len(), pictures) } {
                let (id, was, is) = &found[k];
                if let Some(sheet) = self.sheet(*id, was, is)? {
                    let file = format!("{:02}-{split}-{why}.png", sheets.len() + 1);
                    let name = self.inner.assets.read(*id).map_err(|e| e.to_string())?.name;
                    let (gain, j2j) = (is.rewards.total - was.rewards.total, is.distances.j2j - was.distances.j2j);
                    sheets.push((Shown { file, split: split.clone(), name, why: why.into(), gain, j2j }, sheet));
                }
            }
        }
        if rows.is_empty() {
            let splits = self.config.data.test.join(", ");
            return Err(format!(
                "data.test: the corpora have no asset in `{splits}`; `riglab dataset inspect` shows their splits"
            ));
        }
        Ok((Report { convention: "unirig".into(), rows }, sheets))
    }

    fn sheet(&self, id: AssetId, was: &Found, is: &Found) -> Result<Option<Vec<u8>>, String> {
        let held = self.held_of(id)?;
        let view = View::square(SIDE).framed(held.rig.bounds());
        let (Some(old), Some(new)) = (self.rig(&held, &was.drawn)?, self.rig(&held, &is.drawn)?) else {
            return Ok(None);
        };
        let cells = [
            (format!("before, {:.3}", was.rewards.total), render_skeleton(&old, &view)),
            (format!("after, {:.3}", is.rewards.total), render_skeleton(&new, &view)),
            ("parts before".to_owned(), render_parts(&old, &view)),
            ("parts after".to_owned(), render_parts(&new, &view)),
        ];
        Ok(Some(contact_sheet(&cells, 4, Theme::Light).to_png()))
    }
}
