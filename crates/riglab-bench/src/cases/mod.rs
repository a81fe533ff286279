//! The cases by name: the one place that knows them all.

mod corpus;
mod decode;
mod dedup;
mod epoch;
mod export;
mod generate;
mod geodesic;
mod group;
mod grpo;
mod import;
mod import_arrays;
mod loader_ar;
mod matmul_share;
mod memory;
mod metrics;
mod mpi;
mod prefix_step;
mod report;
mod rewards;
mod rig;
mod sample;
mod simulate;
mod skin_step;
mod step;
mod subject;
mod synth;
mod tokenise;
mod training;

use std::path::PathBuf;

use anyhow::{Result, bail};
use decode::Codec;
use prefix_step::Kind;
use riglab_task::tokenrig::TokenRigTask;
use riglab_task::unirig_skeleton::SkeletonTask;
use riglab_train::Precision;

use crate::recipe;
use crate::row::Row;

/// A benchmark.
pub struct Case {
    /// Its name, and the beginning of its rows' names.
    pub name: &'static str,
    /// What is compared, in a line.
    pub about: &'static str,
    /// Measures.
    pub run: fn(&mut Context) -> Result<Vec<Row>>,
}

/// All of them, in the order they run.
pub const CASES: [Case; 36] = [
    Case { name: "import", about: "rigged files read, against Blender's glTF importer", run: import::run },
    Case {
        name: "import/trimesh",
        about: "the same, against trimesh, and against pygltflib with numpy",
        run: import_arrays::run,
    },
    Case {
        name: "export",
        about: "rigs written as GLB, against pygltflib with numpy, and against trimesh",
        run: export::run,
    },
    Case {
        name: "decode/draco",
        about: "Draco primitives decoded, against the reference decoder in Node",
        run: |c| decode::run(c, Codec::Draco),
    },
    Case {
        name: "decode/meshopt",
        about: "meshopt buffer views decoded, against the reference decoder in Node",
        run: |c| decode::run(c, Codec::Meshopt),
    },
    Case {
        name: "sample/65536",
        about: "points of a surface with normals and weights, against trimesh, and against numpy",
        run: sample::run,
    },
    Case {
        name: "loader/ar",
        about: "samples for UniRig's skeleton model, against numpy and trimesh",
        run: loader_ar::run,
    },
    Case {
        name: "geodesic",
        about: "distances from bones to vertices through a body, against scipy's search over the released graph",
        run: geodesic::run,
    },
    Case {
        name: "mpi/2ranks",
        about: "TokenRig trained by two processes of one thread, against one process of two threads",
        run: mpi::run,
    },
    Case { name: "rewards/24", about: "rewards of a group of rigs of one mesh, against numpy", run: rewards::run },
    Case { name: "simulate", about: "300 frames of spring bones, against three-vrm in Node", run: simulate::run },
    Case {
        name: "metrics/270",
        about: "skeletons and skins under all conventions, against the peers' formulas by numpy and scipy",
        run: metrics::run,
    },
    Case {
        name: "curate/dedup",
        about: "near-duplicates among descriptions of rigs, against all pairs by numpy",
        run: dedup::run,
    },
    Case {
        name: "corpus/100000",
        about: "a corpus of as many assets: cost of one more, memory, opening and reading it",
        run: corpus::run,
    },
    Case {
        name: "step/fsq_cvae/fp32",
        about: "a training step, against the same network in PyTorch",
        run: |c| step::run(c, Precision::Fp32),
    },
    Case {
        name: "step/fsq_cvae/bf16",
        about: "the same in bfloat16, against autocast",
        run: |c| step::run(c, Precision::Bf16),
    },
    Case {
        name: "step/unirig_skeleton/fp32",
        about: "a training step of the skeleton model, against transformers' OPT, no sequence padded",
        run: |c| prefix_step::run::<SkeletonTask>(c, Kind::Even(Precision::Fp32)),
    },
    Case {
        name: "step/unirig_skeleton/bf16",
        about: "the same in bfloat16, against autocast",
        run: |c| prefix_step::run::<SkeletonTask>(c, Kind::Even(Precision::Bf16)),
    },
    Case {
        name: "packed/unirig_skeleton",
        about: "tokens a second over sequences of all lengths, against the same padded to the longest",
        run: |c| prefix_step::run::<SkeletonTask>(c, Kind::Mixed),
    },
    Case {
        name: "generate/unirig_skeleton/b1",
        about: "skeletons drawn under the grammar, against transformers' generate",
        run: |c| generate::run::<SkeletonTask>(c, 1),
    },
    Case {
        name: "generate/unirig_skeleton/b24",
        about: "the same, 24 at once",
        run: |c| generate::run::<SkeletonTask>(c, 24),
    },
    Case {
        name: "step/tokenrig/fp32",
        about: "a training step of TokenRig, against transformers' Qwen3, no sequence padded",
        run: |c| prefix_step::run::<TokenRigTask>(c, Kind::Even(Precision::Fp32)),
    },
    Case {
        name: "step/tokenrig/bf16",
        about: "the same in bfloat16, against autocast",
        run: |c| prefix_step::run::<TokenRigTask>(c, Kind::Even(Precision::Bf16)),
    },
    Case {
        name: "packed/tokenrig",
        about: "tokens a second over sequences of all lengths, against the same padded to the longest",
        run: |c| prefix_step::run::<TokenRigTask>(c, Kind::Mixed),
    },
    Case {
        name: "generate/tokenrig/b1",
        about: "skeletons and skin codes drawn under the grammar, against transformers' generate",
        run: |c| generate::run::<TokenRigTask>(c, 1),
    },
    Case {
        name: "generate/tokenrig/b24",
        about: "the same, 24 at once",
        run: |c| generate::run::<TokenRigTask>(c, 24),
    },
    Case {
        name: "step/unirig_skin/fp32",
        about: "a training step of UniRig's skin stage, against the same network in PyTorch",
        run: skin_step::run,
    },
    Case { name: "group24/tokenrig", about: "24 sequences of one mesh, against the time of one", run: group::run },
    Case {
        name: "step/grpo",
        about: "a whole step of GRPO, a group of 24 drawn, judged and learnt from, against transformers, numpy and scipy",
        run: grpo::run,
    },
    Case {
        name: "rig/20k",
        about: "`riglab rig` on a mesh of 20,000 vertices, against the time asked for",
        run: rig::run,
    },
    Case {
        name: "tokenise",
        about: "skeletons as tokens and back, against the released algorithm in Python",
        run: tokenise::run,
    },
    Case {
        name: "epoch/fsq_cvae",
        about: "an epoch with its loading and sampling, against DataLoader and numpy",
        run: epoch::run,
    },
    Case {
        name: "matmul_share/fsq_cvae",
        about: "the step's matrix products over the fastest ones of this machine",
        run: matmul_share::run,
    },
    Case {
        name: "memory/tokenrig_paper",
        about: "memory of a step of the paper's TokenRig, against transformers' Qwen3 with gradient checkpointing",
        run: memory::run,
    },
    Case {
        name: "report",
        about: "a run's report in all forms, with pictures and rigs to be turned; nothing stands against it",
        run: report::run,
    },
    Case { name: "synth/1000", about: "a thousand creatures made, against the time asked for", run: synth::run },
];

impl Case {
    /// Whether a name of the command line asks for it: a beginning of its name, or one of its rows.
    pub fn is_wanted(&self, name: &str) -> bool {
        self.name.starts_with(name) || name.strip_prefix(self.name).is_some_and(|rest| rest.starts_with('/'))
    }
}

/// riglab's side of a case.
pub fn serve(case: &str) -> Result<()> {
    match case {
        "corpus" => corpus::serve(),
        "generate" => generate::serve::<SkeletonTask>(),
        "tokenrig_generate" => generate::serve::<TokenRigTask>(),
        "group" => group::serve(),
        "grpo" => grpo::serve(),
        "import" => import::serve(),
        "decode" => decode::serve(),
        "dedup" => dedup::serve(),
        "export" => export::serve(),
        "geodesic" => geodesic::serve(),
        "loader_ar" => loader_ar::serve(),
        "memory" => memory::serve(),
        "metrics" => metrics::serve(),
        "rewards" => rewards::serve(),
        "sample" => sample::serve(),
        "simulate" => simulate::serve(),
        "skeleton_step" => prefix_step::serve::<SkeletonTask>(),
        "tokenrig_step" => prefix_step::serve::<TokenRigTask>(),
        "skin_step" => skin_step::serve(),
        "step" => step::serve(),
        "tokenise" => tokenise::serve(),
        "epoch" => epoch::serve(),
        _ => bail!("no side `{case}`"),
    }
}

/// What cases share.
pub struct Context {
    /// Threads of both sides.
    pub threads: usize,
    /// `import`: every file.
    pub all: bool,
    /// `step`: measure `torch.compile` too.
    pub compile: bool,
    /// Where pictures go that a case draws.
    pub pictures: Option<PathBuf>,
    rounds: usize,
    folder: tempfile::TempDir,
    corpus: Option<PathBuf>,
    /// Step times by precision, measured once.
    steps: Vec<(Precision, step::Times)>,
}

impl Context {
    /// With the options of the command line.
    pub fn new(threads: usize, rounds: usize, all: bool, compile: bool) -> Result<Self> {
        let threads = if threads > 0 { threads } else { std::thread::available_parallelism()?.get() };
        let folder = tempfile::Builder::new().prefix("riglab-bench-").tempdir()?;
        Ok(Self { threads, all, compile, pictures: None, rounds, folder, corpus: None, steps: Vec::new() })
    }

    /// How often each side is asked, where the case would ask `usual` times.
    pub fn rounds(&self, usual: usize) -> usize {
        if self.rounds > 0 { self.rounds } else { usual }
    }

    /// A path for a file of this run.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A path for a picture, where pictures are wanted.
    pub fn picture(&self, name: &str) -> Option<PathBuf> {
        self.pictures.as_ref().map(|folder| folder.join(name))
    }

    /// The corpus of the rigs, made the first time; `None` without rigs.
    pub fn corpus(&mut self) -> Result<Option<PathBuf>> {
        if self.corpus.is_none() {
            let Some(rigs) = recipe::rigs() else { return Ok(None) };
            let out = self.path("rigs.h5");
            recipe::corpus(&rigs, &out)?;
            self.corpus = Some(out);
        }
        Ok(self.corpus.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_found_by_their_beginning_and_by_their_rows() {
        let of = |name| CASES.iter().filter(|c| c.is_wanted(name)).count();
        assert_eq!(
            (of("step"), of("step/fsq_cvae/fp32"), of("step/fsq_cvae/fp32/compile"), of("imports")),
            (8, 1, 1, 0)
        );
    }
}
