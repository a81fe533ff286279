//! Reports of runs: in all their forms, of several runs, of half of a run, and in a browser.

mod binary;
mod browser;

use std::fs;
use std::path::{Path, PathBuf};

use binary::{config, corpus_of, must, refusal, riglab, text};
use browser::{Browser, RIGHT, TAB};

/// A folder with two runs of one corpus, evaluated, that differ in their seed.
struct Runs {
    dir: tempfile::TempDir,
    a: PathBuf,
    b: PathBuf,
}

impl Runs {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let corpus = corpus_of(dir.path(), 24, "1000..2000");
        let settings = "[train]\nsteps = 16\nema = 0.9\nvalidate_every = 8\n[train.schedule]\nwarmup = 2\n\
                        [eval]\nprefixes = [2, 16]\n";
        let config = config(dir.path(), &corpus, settings);
        let [a, b] = ["a", "b"].map(|name| dir.path().join(name));
        for (run, seed) in [(&a, "train.seed=1"), (&b, "train.seed=2")] {
            must(&["train", text(&config), "--run", text(run), "--set", seed]);
            must(&["eval", text(run), "--pictures", "1"]);
        }
        Self { dir, a, b }
    }

    /// A copy of the second run without its checkpoints.
    fn copy(&self, name: &str) -> PathBuf {
        let to = self.dir.path().join(name);
        fs::create_dir(&to).unwrap();
        for file in ["config.toml", "run.json", "metrics.jsonl", "perf.jsonl", "eval.json"] {
            fs::copy(self.b.join(file), to.join(file)).unwrap();
        }
        to
    }
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Replaces a text in a file, which must have it.
fn change(path: &Path, from: &str, to: &str) {
    let old = read(path);
    assert!(old.contains(from), "{} has no `{from}`", path.display());
    fs::write(path, old.replace(from, to)).unwrap();
}

#[test]
fn runs_are_reported_compared_and_looked_at() {
    let runs = Runs::new();
    all_forms_say_the_same(&runs);
    two_runs_stand_side_by_side(&runs);
    what_cannot_be_compared_is_refused(&runs);
    half_a_run_is_told(&runs);
    what_cannot_be_evaluated_is_told_before_the_work(&runs);
    a_reader_turns_rigs_in_a_browser(&runs);
}

fn what_cannot_be_evaluated_is_told_before_the_work(runs: &Runs) {
    let before = read(&runs.a.join("eval.json"));
    let eval = |run: &Path, sets: &[&str]| {
        let sets = sets.iter().flat_map(|set| ["--set", *set]);
        refusal(&mut riglab(&["eval", text(run)].into_iter().chain(sets).collect::<Vec<_>>()))
    };
    let nowhere = runs.dir.path().join("nowhere");
    assert!(eval(&nowhere, &[]).contains("nowhere") && !nowhere.exists(), "a mistyped name makes no folder");
    assert!(eval(&runs.a, &["data.test=[\"zz\"]"]).contains("no asset in `zz`"));
    let info: serde_json::Value = serde_json::from_str(&read(&runs.a.join("run.json"))).unwrap();
    let corpus = Path::new(info["data"][0][0].as_str().unwrap());
    let again = runs.dir.path().join("again.h5");
    fs::copy(corpus, &again).unwrap();
    let both = format!("data.corpora=[{:?}, {:?}]", text(corpus), text(&again));
    assert!(eval(&runs.a, &[&both]).contains("hold the same assets"));
    assert_eq!(read(&runs.a.join("eval.json")), before);
    let said = refusal(&mut riglab(&["train", text(&runs.a)]));
    assert!(said.contains("--resume"), "{said}");
}

fn all_forms_say_the_same(runs: &Runs) {
    let said = String::from_utf8(must(&["report", text(&runs.a)]).stdout).unwrap();
    let files: Vec<&str> = said.lines().collect();
    assert_eq!(files.len(), 4, "{said}");
    let [html, markdown, latex, csv] = ["html", "md", "tex", "csv"].map(|e| read(&runs.a.join(format!("report.{e}"))));
    assert!(html.len() < 15 << 20 && html.matches("<figure class=\"view\">").count() >= 4);
    // A figure of the table, in each.
    let evaluation: serde_json::Value = serde_json::from_str(&read(&runs.a.join("eval.json"))).unwrap();
    let rows = evaluation["report"]["rows"].as_array().unwrap();
    let row = rows.iter().find(|r| r["method"] == "rule" && r["split"] == "test_new" && r["tokens"] == 16).unwrap();
    let iou = format!("{:.4}", row["pooled"]["iou"].as_f64().unwrap());
    for (form, text) in [("html", &html), ("md", &markdown), ("tex", &latex), ("csv", &csv)] {
        assert!(text.contains(&iou), "{form} has no {iou}");
        assert!(
            text.contains("published: FSQ-CVAE (SkinTokens paper), ModelsResource (skintokens.table5)")
                || form == "tex",
            "{form}"
        );
    }
    assert!(
        latex.contains("published: FSQ-CVAE (SkinTokens paper), ModelsResource (skintokens.table5) & \\textit{0.911}")
    );
    let published = csv
        .lines()
        .find(|l| l.contains("published: FSQ-CVAE (SkinTokens paper), VRoid") && l.contains(",IoU,"))
        .unwrap();
    assert!(published.ends_with(",0.871,1"), "{published}");
    assert!(csv.lines().any(|l| l.contains(&format!(",{iou},0"))));
    let row = csv.lines().find(|l| l.contains(&format!(",{iou},0")) && l.starts_with("\"test_new")).unwrap();
    assert!(row.contains(",\"rule, 16 codes\",IoU,"), "{row}");
    let keys: Vec<&str> = csv.lines().filter_map(|l| l.rsplitn(3, ',').last()).collect();
    let once: std::collections::BTreeSet<&&str> = keys.iter().collect();
    assert_eq!(once.len(), keys.len(), "a line a value");
    // Spread by split and category.
    assert!(
        markdown
            .contains("| split | category | assets | undefined | IoU per rig | IoU per rig from | IoU per rig to |")
    );
    assert!(html.contains("data-view=\"bone\"") && !html.contains("src=\"http") && !html.contains("href=\"http"));
    // Pictures are linked from where the report lies.
    let file = file_of(&evaluation);
    assert!(markdown.contains(&format!("](<eval/{file}>)")) && runs.a.join("eval").join(file).is_file(), "{markdown}");
    // What they are of, and when that is out of date.
    let step = evaluation["checkpoint"]["step"].as_u64().unwrap();
    assert!(markdown.contains(&format!("the checkpoint of step {step} on ")), "{markdown}");
    assert!(!markdown.contains("neither the best checkpoint"));
    let (file, of) = (runs.a.join("eval.json"), |step: u64| format!("\"step\": {step},"));
    change(&file, &of(step), &of(3));
    let out = runs.dir.path().join("old.md");
    must(&["report", text(&runs.a), "-o", text(&out)]);
    let said = read(&out);
    assert!(said.contains(&format!("](<{}>)", runs.a.join("eval").join(file_of(&evaluation)).display())), "{said}");
    assert!(said.contains("The figures are of step 3, neither the best checkpoint (step "), "{said}");
    assert!(said.contains(" evaluates the best.") && !said.contains(");  "), "one space: {said}");
    change(&file, &of(3), &of(step));
}

/// The first picture of an evaluation.
fn file_of(evaluation: &serde_json::Value) -> &str {
    evaluation["gallery"][0]["file"].as_str().unwrap()
}

fn two_runs_stand_side_by_side(runs: &Runs) {
    // In a folder that is not there yet.
    let out = runs.dir.path().join("new/comparison");
    let named = format!("second={}", text(&runs.b));
    let charts = runs.dir.path().join("new/charts");
    let said = must(&["report", text(&runs.a), &named, "-o", text(&out), "--charts", text(&charts)]).stdout;
    let loss = charts.join("train-loss.svg");
    assert!(String::from_utf8(said).unwrap().lines().any(|line| line == text(&loss)));
    assert!(read(&loss).starts_with("<?xml") && read(&loss).contains("\nsecond\n"));
    let points = read(&charts.join("train-loss.csv"));
    assert!(points.starts_with("line,step,value\r\na,1,") && points.contains("\r\nsecond,16,"), "{points}");
    let markdown = read(&out.with_extension("md"));
    assert!(markdown.contains("| train.seed | 1 | 2 |"), "{markdown}");
    assert!(markdown.contains("paired tests against a, asset by asset"));
    assert!(markdown.contains("| second | all splits | IoU per rig |") && markdown.contains("means by category"));
    assert_eq!(markdown.matches("| published |").count(), 1, "once, not below each split: {markdown}");
    assert!(markdown.contains("assets that changed most against a, by IoU per rig"));
    let sheet = read(&out.with_extension("assets.csv"));
    assert!(sheet.starts_with("about,metric,") && sheet.contains(",L1 per rig,"), "{sheet}");
    let html = read(&out.with_extension("html"));
    assert!(html.contains("train/loss") && html.matches("<svg").count() >= 3);
}

fn what_cannot_be_compared_is_refused(runs: &Runs) {
    let against = |other: &Path| refusal(&mut riglab(&["report", text(&runs.a), text(other), "-o", "/dev/null/x"]));
    let other = runs.copy("other_corpus");
    let evaluation: serde_json::Value = serde_json::from_str(&read(&other.join("eval.json"))).unwrap();
    let sum = evaluation["data"][0][1].as_str().unwrap();
    change(&other.join("eval.json"), sum, "0123456789abcdef");
    let said = against(&other);
    assert!(said.contains("different corpora") && said.contains("only other_corpus has"), "{said}");
    assert!(said.contains("0123456789ab") && said.contains(&sum[..12]), "{said}");
    let other = runs.copy("other_split");
    change(&other.join("eval.json"), "\"test_new\"", "\"test_seen\"");
    let said = against(&other);
    assert!(said.contains("a was evaluated on the splits test_new, test_seen, other_split on test_seen"), "{said}");
    let other = runs.copy("other_assets");
    let name = evaluation["report"]["assets"][0]["name"].as_str().unwrap();
    change(&other.join("eval.json"), &format!("\"name\": \"{name}\""), "\"name\": \"stranger\"");
    let said = against(&other);
    assert!(said.contains(&format!("only a has {name}")) && said.contains("only other_assets has stranger"), "{said}");
}

fn half_a_run_is_told(runs: &Runs) {
    let said = |run: &Path| refusal(&mut riglab(&["report", text(run)]));
    let half = runs.copy("half");
    let whole = read(&half.join("eval.json"));
    fs::write(half.join("eval.json"), &whole[..whole.len() / 2]).unwrap();
    assert!(said(&half).contains("eval.json cannot be understood"));
    // Without an evaluation there is a report, but nothing to compare.
    fs::remove_file(half.join("eval.json")).unwrap();
    must(&["report", text(&half)]);
    let nothing = refusal(&mut riglab(&["report", text(&runs.a), text(&half)]));
    assert!(nothing.contains("half: not evaluated yet") && nothing.contains("riglab eval"), "{nothing}");
    fs::write(half.join("run.json"), "{\"task\": \"fsq").unwrap();
    assert!(said(&half).contains("run.json: half-written run"));
    fs::remove_file(half.join("run.json")).unwrap();
    assert!(said(&half).contains("there is config.toml but no run.json"));
    fs::remove_file(half.join("config.toml")).unwrap();
    assert!(said(&half).contains("no run here"));
    let sweep = runs.dir.path().join("sweep");
    fs::create_dir(&sweep).unwrap();
    fs::write(sweep.join("sweep.json"), "{}").unwrap();
    let told = said(&sweep);
    assert!(told.contains("a sweep, and no run") && told.contains("riglab sweep"), "{told}");
    let ending = refusal(&mut riglab(&["report", text(&runs.a), "-o", text(&runs.dir.path().join("x.pdf"))]));
    assert!(ending.contains(".html, .md, .tex, .csv"), "{ending}");
}

/// How many pixels of the first view are painted, and the picture.
fn drawn(browser: &Browser) -> (u64, String) {
    let count = browser.script(
        "const from = document.querySelector('.view canvas'), { width, height } = from;
         const copy = Object.assign(document.createElement('canvas'), { width, height }).getContext('2d', { willReadFrequently: true });
         copy.drawImage(from, 0, 0);
         const d = copy.getImageData(0, 0, width, height).data;
         let n = 0;
         for (let i = 3; i < d.length; i += 4) n += d[i] > 0;
         return n;",
    );
    let url = browser.script("return document.querySelector('.view canvas').toDataURL()");
    (count.as_u64().unwrap(), url.as_str().unwrap().to_owned())
}

/// Waits until the first view shows another picture than before; gives that one.
fn changed(browser: &Browser, what: &str, before: &str) -> String {
    browser.until(what, |b| drawn(b).1 != before);
    // What is drawn quickly at first is drawn well a little later.
    browser.until("it stands still", |b| {
        let old = drawn(b).1;
        std::thread::sleep(std::time::Duration::from_millis(250));
        drawn(b).1 == old
    });
    drawn(browser).1
}

fn a_reader_turns_rigs_in_a_browser(runs: &Runs) {
    let Some(browser) = Browser::start() else { return };
    let page = runs.a.join("report.html").canonicalize().unwrap();
    browser.open(&format!("file://{}", page.display()));
    browser.script("document.querySelector('.view').scrollIntoView()");
    browser
        .until("the view is drawn", |b| b.script("return document.querySelector('.view').dataset.drawn > 0") == true);
    let (painted, mut seen) = drawn(&browser);
    let size = browser.script("const c = document.querySelector('.view canvas'); return c.width * c.height").as_u64();
    assert!(painted * 20 > size.unwrap(), "{painted} of {size:?} pixels are painted");
    // By mouse.
    browser.drag(".view canvas", [90, 20]);
    seen = changed(&browser, "the mouse turns it", &seen);
    // By keys: it has the focus, which the keyboard reaches too.
    for (key, what) in [(RIGHT, "an arrow turns it"), ("+", "it comes nearer"), ("t", "the true rig"), ("b", "a bone")]
    {
        browser.press(&[key]);
        seen = changed(&browser, what, &seen);
    }
    assert!(browser.text(".view [data-view=said]").starts_with("weight of "));
    assert_eq!(browser.script("return document.querySelector('.view [data-version=\"0\"]').ariaPressed"), "true");
    let pressed = |keys: &[&str]| {
        browser.press(keys);
        browser.script("const e = document.activeElement; return e.dataset.view ?? e.dataset.version ?? e.tagName")
    };
    assert_eq!([pressed(&[TAB]), pressed(&[TAB]), pressed(&[TAB]), pressed(&[TAB])], ["0", "1", "play", "reset"]);
    // It plays until it is told to stop.
    browser.click(".view [data-view=play]");
    let count =
        |b: &Browser| b.script("return Number(document.querySelector('.view').dataset.drawn)").as_u64().unwrap();
    let before = count(&browser);
    browser.until("it plays", |b| count(b) > before + 5);
    browser.click(".view [data-view=play]");
    // Nothing was asked of a network, nothing complained of; on a phone nothing is wider than the screen.
    assert_eq!(browser.script("return performance.getEntriesByType('resource').length"), 0);
    browser.resize(500, 800);
    let wide = browser.script("return document.documentElement.scrollWidth - document.documentElement.clientWidth");
    assert_eq!(wide, 0, "the page is wider than a narrow screen");
    assert_eq!(browser.complaints(), Vec::<String>::new());
}
