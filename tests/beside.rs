//! Batches of a step that tasks compute side by side give what they give one after another, bit for bit.

mod binary;

use std::fs;
use std::process::Command;

use binary::{config, corpus, must, text};

#[test]
fn every_task_gives_the_same_on_one_thread_and_on_two() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 8);
    let settings = "[train]\nsteps = 3\nvalidate_every = 3\naccumulate = 2\n[eval]\nvalidation_vertices = 50\n";
    let skin = config(dir.path(), &corpus, settings);
    let vae = dir.path().join("vae");
    must(&["train", text(&skin), "--run", text(&vae)]);
    let (vae, corpora) = (format!("skin.run='{}'", vae.display()), format!("data.corpora=['{}']", corpus.display()));
    let few = [
        "train.steps=3",
        "train.validate_every=3",
        "train.accumulate=2",
        "train.optim.muon=[]",
        "sampling.rigs=2",
        &corpora,
    ];
    // Not `auto`, which is another on another processor.
    let precision = "train.precision='bf16'";
    let decoder = [precision, "model.decoder.layers=2", "model.shape.layers=1", "model.decoder.dropout=0.1"];
    let prior = ["model.extensions.bone_geometry=true", "model.extensions.frame=false", "model.extensions.prior=true"];
    let without = ["sampling.prefix={full=0.3, lengths=[0]}", "sampling.code_noise=0.3"];
    let both = [prior[0], prior[2], without[1], "model.extensions.frame=true", "sampling.frame_noise=0.3"];
    let cases = [
        (text(&skin), [&prior[..], &without, &["train.precision='fp32'", "train.optim.muon=[]"]].concat()),
        (text(&skin), [&both[..], &["train.precision='fp32'", "train.optim.muon=[]"]].concat()),
        (text(&skin), vec!["train.precision='fp32'", "train.optim.muon=[]"]),
        (text(&skin), vec!["train.precision='bf16'", "train.recompute=true", "train.optim.muon=[]"]),
        ("quickstart/unirig_skeleton.toml", [&few[..], &decoder, &["limits.tokens=300"]].concat()),
        ("quickstart/tokenrig.toml", [&few[..], &decoder, &["train.recompute=true", &vae]].concat()),
        ("quickstart/unirig_skin.toml", [&few[..], &["sampling.resolution=32"]].concat()),
    ];
    for (k, (config, sets)) in cases.into_iter().enumerate() {
        let metrics = |threads: &str| {
            let run = dir.path().join(format!("{k}-{threads}"));
            let mut args = vec!["--threads", threads, "train", config, "--run", text(&run)];
            sets.iter().for_each(|set| args.extend(["--set", set]));
            let out = Command::new(env!("CARGO_BIN_EXE_riglab")).args(args).output().unwrap();
            let said = String::from_utf8_lossy(&out.stderr);
            assert!(out.status.success(), "{said}");
            assert_eq!(said.contains("2 batches side by side"), threads == "2", "{said}");
            let metrics = fs::read_to_string(run.join("metrics.jsonl")).unwrap();
            // Validation and Muon's products use all threads, and round by their number.
            metrics
                .lines()
                .filter(|line| line.contains("train/grad_norm"))
                .map(|l| format!("{l}\n"))
                .collect::<String>()
        };
        let (one, two) = (metrics("1"), metrics("2"));
        assert_eq!(one.lines().count(), 3, "{one}");
        assert_eq!(one, two, "{config} {sets:?}");
    }
}
