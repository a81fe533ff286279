//! A run whose blocks are computed again in the backward pass is the run that keeps what they compute, bit for bit.

mod binary;

use std::fs;

use binary::{config, corpus, must, text};

#[test]
fn runs_with_and_without_are_the_same() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = corpus(dir.path(), 8);
    let settings = "[train]\nsteps = 4\nvalidate_every = 2\naccumulate = 2\n[eval]\nvalidation_vertices = 50\n";
    let skin = config(dir.path(), &corpus, settings);
    let corpora = format!("data.corpora=['{}']", corpus.display());
    let small =
        ["train.steps=3", "sampling.rigs=2", "model.decoder.layers=2", "model.shape.layers=1", "limits.tokens=300"];
    let cases = [
        (text(&skin), vec!["train.precision='fp32'"]),
        (text(&skin), vec!["train.precision='bf16'"]),
        ("quickstart/unirig_skeleton.toml", [&small[..], &["model.decoder.dropout=0.1", &corpora]].concat()),
    ];
    for (k, (config, sets)) in cases.into_iter().enumerate() {
        let metrics = |recompute: bool| {
            let (run, recompute) =
                (dir.path().join(format!("{k}-{recompute}")), format!("train.recompute={recompute}"));
            let mut args = vec!["train", config, "--run", text(&run), "--set", &recompute];
            sets.iter().for_each(|set| args.extend(["--set", set]));
            must(&args);
            fs::read_to_string(run.join("metrics.jsonl")).unwrap()
        };
        let (kept, again) = (metrics(false), metrics(true));
        assert!(kept.contains("train/grad_norm") && kept.contains("eval/"), "{kept}");
        assert_eq!(kept, again, "{config} {sets:?}");
    }
}
