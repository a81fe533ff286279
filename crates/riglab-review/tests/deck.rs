//! What a review opens: corpora, curations, and what is neither.

use std::path::Path;

use riglab_review::{Review, ReviewError};

fn fault(corpus: &Path) -> String {
    match Review::open(corpus, None, &corpus.with_extension("tsv")) {
        Ok(_) => panic!("{} was opened", corpus.display()),
        Err(e) => e.to_string(),
    }
}

#[test]
fn what_cannot_be_reviewed_is_a_sentence() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = dir.path().join("c.h5");
    assert!(fault(&corpus).contains("c.h5: nothing to review"));
    std::fs::write(&corpus, "no corpus").unwrap();
    assert!(fault(&corpus).contains("c.h5"));
    std::fs::remove_file(&corpus).unwrap();
    let list = dir.path().join("c.curation/assets.jsonl");
    std::fs::create_dir(list.parent().unwrap()).unwrap();
    std::fs::write(&list, "{\"name\":\"a\",\"stage\":\"read\"}\n").unwrap();
    assert!(fault(&corpus).contains("no asset of it could be read"));
    std::fs::write(&list, "{\"name\":\"a\",\"stage\":\"bones\"}\n{\"nam").unwrap();
    assert!(fault(&corpus).contains("assets.jsonl:2: "));
}

#[test]
fn what_was_dropped_has_a_card_without_a_corpus() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = dir.path().join("c.h5");
    let list = dir.path().join("c.curation/assets.jsonl");
    std::fs::create_dir(list.parent().unwrap()).unwrap();
    std::fs::write(
        &list,
        "{\"name\":\"b\",\"stage\":\"read\"}\n{\"name\":\"a\",\"digest\":\"1\",\"stage\":\"bones\"}\n",
    )
    .unwrap();
    let decisions = dir.path().join("d.tsv");
    std::fs::write(&decisions, "a\t1\treject\t\t\t\ngone\t2\taccept\t\t\t\n").unwrap();
    let review = Review::open(&corpus, None, &decisions).unwrap();
    assert_eq!((review.tally().decided, review.tally().of, review.unreadable()), (1, 1, 1));
    assert!(review.told()[0].contains("gone"));
    std::fs::write(&decisions, "a\t1\tmaybe\t\t\t\n").unwrap();
    assert!(matches!(Review::open(&corpus, None, &decisions), Err(ReviewError::Decisions(_))));
    let deep = Review::open(&corpus, None, &dir.path().join("no/where.tsv"));
    assert!(deep.is_err_and(|e| e.to_string().contains("no such folder")));
    let folder = Review::open(&corpus, Some(&dir.path().join("nowhere")), &dir.path().join("e.tsv"));
    assert!(matches!(folder, Err(ReviewError::Data(_))));
}

#[test]
fn a_folder_that_was_not_curated_is_known() {
    let dir = tempfile::tempdir().unwrap();
    let corpus = dir.path().join("c.h5");
    let list = dir.path().join("c.curation/assets.jsonl");
    std::fs::create_dir(list.parent().unwrap()).unwrap();
    let line =
        |name: &str| format!("{{\"name\":\"{name}\",\"file\":\"{name}\",\"digest\":\"1\",\"stage\":\"bones\"}}\n");
    std::fs::write(&list, line("a.glb") + &line("b.glb")).unwrap();
    let files = dir.path().join("files");
    std::fs::create_dir(&files).unwrap();
    std::fs::write(files.join("a.glb"), "glTF").unwrap();
    let gone = || Review::open(&corpus, Some(&files), &dir.path().join("d.tsv")).unwrap().gone();
    assert_eq!(gone(), Some((1, 2)));
    std::fs::write(files.join("b.glb"), "glTF").unwrap();
    assert_eq!(gone(), None);
    assert_eq!(Review::open(&corpus, None, &dir.path().join("d.tsv")).unwrap().gone(), None);
}
