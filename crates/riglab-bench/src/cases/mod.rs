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
use crate::side::Side;

/// A benchmark.
pub struct Case {
    /// Its name, and the beginning of its rows' names but those of `rows`.
    pub name: &'static str,
    /// Names of rows that do not begin with it.
    pub rows: &'static [&'static str],
    /// What is compared, in a line.
    pub about: &'static str,
    /// Measures.
    pub run: fn(&mut Context) -> Result<Vec<Row>>,
}

/// All of them, in the order they run.
pub static CASES: [Case; 36] = [
    Case { name: "import", rows: &[], about: "rigged files read, against Blender's glTF importer", run: import::run },
    Case {
        name: "import/trimesh",
        rows: &["import/pygltflib"],
        about: "the same, against trimesh, and against pygltflib with numpy",
        run: import_arrays::run,
    },
    Case {
        name: "export",
        rows: &[],
        about: "rigs written as GLB, against pygltflib with numpy, and against trimesh",
        run: export::run,
    },
    Case {
        name: "decode/draco",
        rows: &[],
        about: "Draco primitives decoded, against the reference decoder in Node",
        run: |c| decode::run(c, Codec::Draco),
    },
    Case {
        name: "decode/meshopt",
        rows: &[],
        about: "meshopt buffer views decoded, against the reference decoder in Node",
        run: |c| decode::run(c, Codec::Meshopt),
    },
    Case {
        name: "sample/65536",
        rows: &[],
        about: "points of a surface with normals and weights, against trimesh, and against numpy",
        run: sample::run,
    },
    Case {
        name: "loader/ar",
        rows: &[],
        about: "samples for UniRig's skeleton model, against numpy and trimesh",
        run: loader_ar::run,
    },
    Case {
        name: "geodesic",
        rows: &[],
        about: "distances from bones to vertices through a body, against scipy's search over the released graph",
        run: geodesic::run,
    },
    Case {
        name: "mpi/2ranks",
        rows: &[],
        about: "TokenRig trained by two processes of one thread, against one process of two threads",
        run: mpi::run,
    },
    Case {
        name: "rewards/24",
        rows: &[],
        about: "rewards of a group of rigs of one mesh, against numpy",
        run: rewards::run,
    },
    Case {
        name: "simulate",
        rows: &[],
        about: "300 frames of spring bones, against three-vrm in Node",
        run: simulate::run,
    },
    Case {
        name: "metrics/270",
        rows: &[],
        about: "skeletons and skins under all conventions, against the peers' formulas by numpy and scipy",
        run: metrics::run,
    },
    Case {
        name: "curate/dedup",
        rows: &[],
        about: "near-duplicates among descriptions of rigs, against all pairs by numpy",
        run: dedup::run,
    },
    Case {
        name: "corpus/100000",
        rows: &[],
        about: "a corpus of as many assets: cost of one more, memory, opening and reading it",
        run: corpus::run,
    },
    Case {
        name: "step/fsq_cvae/fp32",
        rows: &[],
        about: "a training step, against the same network in PyTorch",
        run: |c| step::run(c, Precision::Fp32),
    },
    Case {
        name: "step/fsq_cvae/bf16",
        rows: &[],
        about: "the same in bfloat16, against autocast",
        run: |c| step::run(c, Precision::Bf16),
    },
    Case {
        name: "step/unirig_skeleton/fp32",
        rows: &[],
        about: "a training step of the skeleton model, against transformers' OPT, no sequence padded",
        run: |c| prefix_step::run::<SkeletonTask>(c, Kind::Even(Precision::Fp32)),
    },
    Case {
        name: "step/unirig_skeleton/bf16",
        rows: &[],
        about: "the same in bfloat16, against autocast",
        run: |c| prefix_step::run::<SkeletonTask>(c, Kind::Even(Precision::Bf16)),
    },
    Case {
        name: "packed/unirig_skeleton",
        rows: &[],
        about: "tokens a second over sequences of all lengths, against the same padded to the longest",
        run: |c| prefix_step::run::<SkeletonTask>(c, Kind::Mixed),
    },
    Case {
        name: "generate/unirig_skeleton/b1",
        rows: &[],
        about: "skeletons drawn under the grammar, against transformers' generate",
        run: |c| generate::run::<SkeletonTask>(c, 1),
    },
    Case {
        name: "generate/unirig_skeleton/b24",
        rows: &[],
        about: "the same, 24 at once",
        run: |c| generate::run::<SkeletonTask>(c, 24),
    },
    Case {
        name: "step/tokenrig/fp32",
        rows: &[],
        about: "a training step of TokenRig, against transformers' Qwen3, no sequence padded",
        run: |c| prefix_step::run::<TokenRigTask>(c, Kind::Even(Precision::Fp32)),
    },
    Case {
        name: "step/tokenrig/bf16",
        rows: &[],
        about: "the same in bfloat16, against autocast",
        run: |c| prefix_step::run::<TokenRigTask>(c, Kind::Even(Precision::Bf16)),
    },
    Case {
        name: "packed/tokenrig",
        rows: &[],
        about: "tokens a second over sequences of all lengths, against the same padded to the longest",
        run: |c| prefix_step::run::<TokenRigTask>(c, Kind::Mixed),
    },
    Case {
        name: "generate/tokenrig/b1",
        rows: &[],
        about: "skeletons and skin codes drawn under the grammar, against transformers' generate",
        run: |c| generate::run::<TokenRigTask>(c, 1),
    },
    Case {
        name: "generate/tokenrig/b24",
        rows: &[],
        about: "the same, 24 at once",
        run: |c| generate::run::<TokenRigTask>(c, 24),
    },
    Case {
        name: "step/unirig_skin/fp32",
        rows: &[],
        about: "a training step of UniRig's skin stage, against the same network in PyTorch",
        run: skin_step::run,
    },
    Case {
        name: "group24/tokenrig",
        rows: &[],
        about: "24 sequences of one mesh, against the time of one",
        run: group::run,
    },
    Case {
        name: "step/grpo",
        rows: &[],
        about: "a whole step of GRPO, a group of 24 drawn, judged and learnt from, against transformers, numpy and scipy",
        run: grpo::run,
    },
    Case {
        name: "rig/20k",
        rows: &[],
        about: "`riglab rig` on a mesh of 20,000 vertices, against the time asked for",
        run: rig::run,
    },
    Case {
        name: "tokenise",
        rows: &[],
        about: "skeletons as tokens and back, against the released algorithm in Python",
        run: tokenise::run,
    },
    Case {
        name: "epoch/fsq_cvae",
        rows: &[],
        about: "an epoch with its loading and sampling, against DataLoader and numpy",
        run: epoch::run,
    },
    Case {
        name: "matmul_share/fsq_cvae",
        rows: &[],
        about: "the step's matrix products over the fastest ones of this machine",
        run: matmul_share::run,
    },
    Case {
        name: "memory/tokenrig_paper",
        rows: &[],
        about: "memory of a step of the paper's TokenRig, against transformers' Qwen3 with gradient checkpointing",
        run: memory::run,
    },
    Case {
        name: "report",
        rows: &[],
        about: "a run's report in all forms, with pictures and rigs to be turned; nothing stands against it",
        run: report::run,
    },
    Case {
        name: "synth/1000",
        rows: &[],
        about: "a thousand creatures made, against the time asked for",
        run: synth::run,
    },
];

impl Case {
    fn names(&self) -> impl Iterator<Item = &'static str> {
        std::iter::once(self.name).chain(self.rows.iter().copied())
    }

    /// How much of a row's name is this case's: 0 where it has no such row.
    fn owns(&self, row: &str) -> usize {
        let within = |name: &str| row.strip_prefix(name).is_some_and(|rest| rest.starts_with('/'));
        self.names().filter(|name| within(name)).map(str::len).max().unwrap_or(0)
    }
}

/// The cases that a name of the command line asks for, in their order: those with a name that begins so, else the one
/// whose row it is.
pub fn wanted(name: &str) -> Vec<&'static Case> {
    let begun: Vec<&Case> = CASES.iter().filter(|case| case.names().any(|own| own.starts_with(name))).collect();
    if !begun.is_empty() {
        return begun;
    }
    CASES.iter().filter(|case| case.owns(name) > 0).max_by_key(|case| case.owns(name)).into_iter().collect()
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

    /// riglab's side of a case, with as many threads as this run has.
    pub fn ours(&self, case: &str) -> Result<Side> {
        Side::ours(case, self.threads)
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
        let of = |name| wanted(name).len();
        assert_eq!(
            (of("step"), of("step/fsq_cvae/fp32"), of("step/fsq_cvae/fp32/compile"), of("imports")),
            (8, 1, 1, 0)
        );
        // Names that begin with another's are cases of their own, and so are rows that say another's name.
        let names = |name| wanted(name).iter().map(|case| case.name).collect::<Vec<_>>();
        assert_eq!(names("import"), ["import", "import/trimesh"]);
        for of_arrays in ["import/trimesh", "import/trimesh/files", "import/pygltflib", "import/pyg"] {
            assert_eq!(names(of_arrays), ["import/trimesh"], "{of_arrays}");
        }
        assert_eq!(names("import/large"), ["import"]);
    }
}
