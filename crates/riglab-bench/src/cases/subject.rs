//! The decoders behind the tokens of a shape, as the cases see them.

use std::path::Path;
use std::sync::Arc;

use anyhow::{Context as _, Result, anyhow, ensure};
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::Weights;
use riglab_nn::tokenrig::Head;
use riglab_random::stream;
use riglab_task::fsq_cvae::{Frozen, FsqCvaeTask};
use riglab_task::tokenrig::{self, RigSample, TokenRigTask, TokenRigTaskConfig};
use riglab_task::unirig_skeleton::{self, Batch as Shapes, SkeletonTask};
use riglab_token::{Grammar, Limits, Mask, Parents, RigGrammar, SkinIds, SkinRule, Tokenizer, TokenizerConfig};
use riglab_train::{At, Precision, Task, TrainConfig};
use serde_json::{Value, json};
use tch::{Device, Tensor};

use crate::recipe;

/// A task of such a network, in the form that has a twin.
pub trait Subject: Task + Sized {
    /// Its name, as in the names of rows.
    const NAME: &'static str;
    /// riglab's side of training steps, and of drawing.
    const SIDES: [&'static str; 2];
    /// The other side's program that draws.
    const DRAWS: &'static str;
    /// Tokens of each sequence where all are of one length: about the mean of the rigs'.
    const EVEN: usize;
    /// Limits of what is drawn with starting weights: sequences are then about as long as the rigs'.
    const LIMITS: Limits;

    /// With starting weights, over a corpus. `drawing` sets the limits.
    fn open(corpus: &Path, precision: Precision, drawing: Option<usize>) -> Result<Self>;
    /// Its settings, as the other side reads them.
    fn settings(&self) -> Value;
    fn train(&self) -> &TrainConfig;
    fn tokenizer(&self) -> &TokenizerConfig;
    /// Rigs of a batch.
    fn rigs(&self) -> usize;
    /// Rows of the table of tokens.
    fn vocabulary(&self) -> usize;
    fn shapes(batch: &Self::Batch) -> &Shapes;
    fn batch(shapes: Shapes) -> Self::Batch;
    /// The loss of a batch at the start of training, nothing dropped.
    fn first_loss(&self, w: &Weights, batch: &Self::Batch, at: At) -> Result<Tensor, String>;
    /// What the decoder reads of a batch's shapes.
    fn prefix(&self, batch: &Self::Batch) -> Tensor;
    /// Sequences after the start, one a row of `prefix` or one a key where that has one row.
    fn draw(&self, prefix: &Tensor, keys: &[u64], how: &GenerateConfig) -> Result<Vec<Vec<u32>>, String>;
    /// What the other side's grammar has to know beyond the skeleton's tokens: `end`, `longest` and more.
    fn ends(&self) -> Value;
    /// Whether a whole sequence is one of the strict grammar, by settings.
    fn check(settings: &Value, tokenizer: &Tokenizer, ids: &[u32]) -> Result<()>;
}

impl Subject for SkeletonTask {
    const NAME: &'static str = "unirig_skeleton";
    const SIDES: [&'static str; 2] = ["skeleton_step", "generate"];
    const DRAWS: &'static str = "unirig_generate.py";
    const EVEN: usize = 128;
    /// The rigs' mean is 155 tokens.
    const LIMITS: Limits = Limits { joints: 48, tokens: 200 };

    fn open(corpus: &Path, precision: Precision, drawing: Option<usize>) -> Result<Self> {
        let mut c = recipe::skeleton(corpus, precision)?;
        if let Some(rows) = drawing {
            (c.limits, c.sampling.rigs) = (Self::LIMITS, rows);
        }
        Self::new(c, Device::Cpu).map_err(|e| anyhow!(e))
    }

    fn settings(&self) -> Value {
        json!(self.config())
    }

    fn train(&self) -> &TrainConfig {
        &self.config().train
    }

    fn tokenizer(&self) -> &TokenizerConfig {
        &self.config().tokenizer
    }

    fn rigs(&self) -> usize {
        self.config().sampling.rigs
    }

    fn vocabulary(&self) -> usize {
        Tokenizer::new(self.config().tokenizer.clone()).vocabulary().len()
    }

    fn shapes(batch: &Shapes) -> &Shapes {
        batch
    }

    fn batch(shapes: Shapes) -> Shapes {
        shapes
    }

    fn first_loss(&self, w: &Weights, batch: &Shapes, _: At) -> Result<Tensor, String> {
        Ok(unirig_skeleton::loss_of(self.net(), self.config(), w, batch, Device::Cpu, false)?.total())
    }

    fn prefix(&self, batch: &Shapes) -> Tensor {
        self.drawer().prefix_of(self.params().weights(), batch)
    }

    fn draw(&self, prefix: &Tensor, keys: &[u64], how: &GenerateConfig) -> Result<Vec<Vec<u32>>, String> {
        let mut streams: Vec<_> = keys.iter().map(|key| stream(0, "bench draws", &[*key])).collect();
        let drawn = self.drawer().draw_with(self.params().weights(), prefix, &mut streams, how)?;
        // What is drawn begins with the start, which theirs is given.
        Ok(drawn.into_iter().map(|d| d.ids[1..].to_vec()).collect())
    }

    fn ends(&self) -> Value {
        let tokenizer = Tokenizer::new(self.config().tokenizer.clone());
        json!({"end": tokenizer.vocabulary().eos(), "longest": self.config().limits.tokens,
               "count": self.vocabulary()})
    }

    fn check(_: &Value, tokenizer: &Tokenizer, ids: &[u32]) -> Result<()> {
        let mut grammar = Grammar::new(tokenizer, Self::LIMITS, Parents::Existing);
        grammar.advance(tokenizer.vocabulary().bos())?;
        ids.iter().try_for_each(|id| grammar.advance(*id)).context("under the strict grammar")?;
        ensure!(grammar.is_done(), "a sequence without an end");
        Ok(())
    }
}

impl Subject for TokenRigTask {
    const NAME: &'static str = "tokenrig";
    const SIDES: [&'static str; 2] = ["tokenrig_step", "tokenrig_generate"];
    const DRAWS: &'static str = "tokenrig_generate.py";
    const EVEN: usize = 256;
    /// With 4 codes a joint: the rigs' mean is 155 tokens of the skeleton and 28 joints.
    const LIMITS: Limits = Limits { joints: 32, tokens: 160 };

    fn open(corpus: &Path, precision: Precision, drawing: Option<usize>) -> Result<Self> {
        let mut c = recipe::tokenrig(corpus, precision)?;
        // As the paper has it, and transformers: one softmax over skeleton tokens and codes, nothing told or dropped.
        c.model.head = Head::Flat;
        (c.model.tell_joint, c.model.tell_region, c.model.tell_rule, c.model.tell_place) = (false, false, false, false);
        c.model.shape.sorted = false;
        (c.skin.empty, c.model.decoder.dropout) = (false, 0.0);
        if let Some(rows) = drawing {
            (c.limits, c.sampling.rigs) = (Self::LIMITS, rows);
        }
        open_tokenrig(c, corpus)
    }

    fn settings(&self) -> Value {
        let mut all = json!(self.rigger().config());
        all["skeleton_ids"] = json!(self.rigger().tokenizer().vocabulary().len());
        all["skin_ids"] = json!({"from": self.layout().0, "codes": self.layout().1});
        all
    }

    fn train(&self) -> &TrainConfig {
        &self.rigger().config().train
    }

    fn tokenizer(&self) -> &TokenizerConfig {
        &self.rigger().config().tokenizer
    }

    fn rigs(&self) -> usize {
        self.rigger().config().sampling.rigs
    }

    fn vocabulary(&self) -> usize {
        let (first, codes) = self.layout();
        // And the end.
        first + codes + 1
    }

    fn shapes(batch: &tokenrig::Batch) -> &Shapes {
        &batch.shapes
    }

    fn batch(shapes: Shapes) -> tokenrig::Batch {
        tokenrig::Batch { shapes, ..tokenrig::Batch::default() }
    }

    fn first_loss(&self, w: &Weights, batch: &tokenrig::Batch, at: At) -> Result<Tensor, String> {
        Ok(self.loss(w, batch, At { step: 0, ..at })?.total())
    }

    fn prefix(&self, batch: &tokenrig::Batch) -> Tensor {
        self.rigger().prefix(self.params().weights(), &batch.shapes)
    }

    fn draw(&self, prefix: &Tensor, keys: &[u64], how: &GenerateConfig) -> Result<Vec<Vec<u32>>, String> {
        let rigger = self.rigger();
        let mut streams: Vec<_> = keys.iter().map(|key| stream(0, "bench draws", &[*key])).collect();
        let prompts = vec![rigger.free(); keys.len()];
        let drawn =
            rigger.draw(self.params().weights(), &prefix.shallow_clone().into(), &prompts, how, &mut streams)?;
        let (first, codes) = self.layout();
        let whole = |d: RigSample| {
            let own = d.codes.iter().flatten().flatten().map(|code| (first as i64 + code) as u32);
            d.skeleton[1..].iter().copied().chain(own).chain([(first + codes) as u32]).collect()
        };
        Ok(drawn.into_iter().map(whole).collect())
    }

    fn ends(&self) -> Value {
        let ((first, codes), c) = (self.layout(), self.rigger().config());
        json!({"end": first + codes, "longest": c.longest(), "count": self.vocabulary(), "codes_from": first,
               "codes_each": c.skin.codes})
    }

    fn check(settings: &Value, tokenizer: &Tokenizer, ids: &[u32]) -> Result<()> {
        let number = |pointer: &str| settings.pointer(pointer).and_then(Value::as_u64).context("a number");
        let (first, codes) = (number("/skin_ids/from")? as u32, number("/skin_ids/codes")? as u32);
        let end = first + codes;
        let each = number("/skin/codes")? as usize;
        let skin = SkinIds {
            parts: std::iter::once(first..end).collect(),
            end,
            empty: None,
            codes: each,
            len: end as usize + 1,
        };
        let skeleton = Grammar::new(tokenizer, Self::LIMITS, Parents::Existing);
        let ids_of = tokenizer.vocabulary();
        let mut grammar = RigGrammar::new(skeleton, ids_of.eos(), skin, SkinRule::Exact);
        let mut mask = Mask::none(grammar.len());
        for &id in std::iter::once(&ids_of.bos()).chain(ids) {
            grammar.allowed(&mut mask);
            ensure!(mask.allows(id), "token {id} under the strict grammar");
            grammar.accept(id);
        }
        ensure!(grammar.is_done(), "a sequence without an end");
        Ok(())
    }
}

/// What of a layout is needed.
trait Ids {
    /// The first code, and how many there are.
    fn layout(&self) -> (usize, usize);
}

impl Ids for TokenRigTask {
    fn layout(&self) -> (usize, usize) {
        let codes: i64 = self.rigger().vae().levels().iter().product();
        (self.rigger().tokenizer().vocabulary().len(), codes as usize)
    }
}

/// The task with starting weights, and an auto-encoder with such.
pub fn open_tokenrig(c: TokenRigTaskConfig, corpus: &Path) -> Result<TokenRigTask> {
    let skin = recipe::skin(corpus)?;
    let (net, params) = FsqCvaeTask::network(&skin, Device::Cpu)?;
    let vae = Arc::new(Frozen::new(skin, net, params, Device::Cpu));
    TokenRigTask::with(c, vae, Device::Cpu).map_err(|e| anyhow!(e))
}
