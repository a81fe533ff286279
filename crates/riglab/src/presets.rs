//! The configs and experiments of the source tree, compiled in: the program works without it.

use std::path::{Path, PathBuf};

use include_dir::{Dir, include_dir};
use riglab_config::{Config, ConfigError, Loader};

static CONFIGS: Dir = include_dir!("$CARGO_MANIFEST_DIR/../../configs");
static EXPERIMENTS: Dir = include_dir!("$CARGO_MANIFEST_DIR/../../experiments");

/// Loads a config: a file, or an experiment by its name (`quickstart/fsq_cvae.toml`). It and what it extends are looked up
/// beside it, in `configs/` and `experiments/` of the working folder, then among the compiled-in ones: who edits the source
/// tree's is in it.
pub fn load(name: &str, sets: &[String]) -> Result<Config, ConfigError> {
    load_beside(None, name, sets)
}

/// [`load`], where the name may also be one beside a file that says it.
pub fn load_beside(file: Option<&Path>, name: &str, sets: &[String]) -> Result<Config, ConfigError> {
    let built_in = [texts(&CONFIGS), texts(&EXPERIMENTS)].concat();
    let own = file.map(|file| file.parent().unwrap_or(Path::new("")).to_owned());
    let search: Vec<PathBuf> = own.into_iter().chain(["configs".into(), "experiments".into()]).collect();
    let loader = Loader::new().search(&search).built_in(&built_in);
    let wanted = name.strip_prefix("experiments/").unwrap_or(name);
    match EXPERIMENTS.get_file(wanted).and_then(|f| f.contents_utf8()) {
        Some(text) if !is_there(name, &search) => loader.parse(&format!("built-in {name}"), text, sets),
        _ => loader.load(name, sets),
    }
}

/// Reads a text as a config, called `name` in messages.
pub fn parse(name: &str, text: &str, sets: &[String]) -> Result<Config, ConfigError> {
    Loader::new().parse(name, text, sets)
}

/// Loads a building block by itself: a file, or one of `configs/` that is compiled in by its name
/// (`curation/rig_xl.toml`).
pub fn load_block(name: &str, sets: &[String]) -> Result<Config, ConfigError> {
    let built_in = texts(&CONFIGS);
    let search = [PathBuf::from("configs")];
    let loader = Loader::new().search(&search).built_in(&built_in);
    let wanted = name.strip_prefix("configs/").unwrap_or(name);
    match CONFIGS.get_file(wanted).and_then(|f| f.contents_utf8()) {
        Some(text) if !is_there(name, &search) => loader.parse(&format!("built-in {name}"), text, sets),
        _ => loader.load(name, sets),
    }
}

/// Whether a name is that of a file, by itself or below one of some folders.
fn is_there(name: &str, search: &[PathBuf]) -> bool {
    Path::new(name).is_file() || search.iter().any(|folder| folder.join(name).is_file())
}

/// The experiments of one run that are compiled in, with the sentence that each begins with.
pub fn experiments() -> Vec<(&'static str, String)> {
    named(|text| !is_sweep(text))
}

/// The sweeps that are compiled in, as [`experiments`].
pub fn sweeps() -> Vec<(&'static str, String)> {
    named(is_sweep)
}

/// Names with their sentences as lines, the sentences below each other.
pub fn listed(all: &[(&str, String)]) -> Vec<String> {
    let width = all.iter().map(|(name, _)| name.len()).max().unwrap_or(0);
    all.iter().map(|(name, about)| format!("{name:width$}  {about}").trim_end().to_owned()).collect()
}

fn named(wanted: impl Fn(&str) -> bool) -> Vec<(&'static str, String)> {
    let all = texts(&EXPERIMENTS).into_iter().filter(|(_, text)| wanted(text));
    let mut all: Vec<_> = all.map(|(name, text)| (name, about(text))).collect();
    all.sort();
    all
}

/// The first sentence of the comment that a file begins with.
fn about(text: &str) -> String {
    let lines = text.lines().map_while(|line| line.strip_prefix('#')).map(str::trim);
    let comment = lines.take_while(|line| !line.is_empty()).collect::<Vec<_>>().join(" ");
    let end = [". ", "? "].iter().filter_map(|end| comment.find(end)).min();
    end.map_or(comment.as_str(), |end| &comment[..=end]).to_owned()
}

fn is_sweep(text: &str) -> bool {
    text.lines().any(|line| line.trim() == "[sweep]")
}

fn texts(dir: &'static Dir<'static>) -> Vec<(&'static str, &'static str)> {
    let mut all = Vec::new();
    let mut open = vec![dir];
    while let Some(dir) = open.pop() {
        open.extend(dir.dirs());
        for file in dir.files() {
            let toml = file.path().extension().is_some_and(|e| e == "toml");
            if let (true, Some(name), Some(text)) = (toml, file.path().to_str(), file.contents_utf8()) {
                all.push((name, text));
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use riglab_geom::{By, CloudConfig};
    use riglab_nn::fsq_cvae::FsqCvae;
    use riglab_nn::params::Builder;
    use riglab_nn::skeleton::SkeletonModel;
    use riglab_nn::tokenrig::{Layout, TokenRig};
    use riglab_token::Tokenizer;

    use super::*;
    use crate::registry::TaskConfig;

    #[test]
    fn each_experiment_says_what_it_is_for() {
        let text = "# What it does, in two\n# lines. And more.\n#\n# Not this\ntask = 'a'\n";
        assert_eq!(about(text), "What it does, in two lines.");
        assert_eq!(about("# Does it help?\ntask = 'a'\n"), "Does it help?");
        let all = [experiments(), sweeps()].concat();
        assert!(all.len() > 20 && all.iter().all(|(_, about)| about.ends_with(['.', '?'])), "{all:?}");
        assert_eq!(listed(&[("a", "One.".into()), ("abc", String::new())]), ["a    One.", "abc"]);
    }

    /// Numbers of a network by the first part of their names, without making them.
    fn count(name: &str) -> Vec<(String, i64)> {
        let mut builder = Builder::default();
        match TaskConfig::read(&load(name, &[]).unwrap()).unwrap() {
            TaskConfig::FsqCvae(c) => drop(FsqCvae::new(builder.root(), &c.model).unwrap()),
            TaskConfig::TokenRig(c) => {
                let ids = Tokenizer::new(c.tokenizer.clone()).vocabulary().len();
                let vae = if name.contains("released") { "released" } else { "paper" };
                let vae = load(&format!("skintokens/fsq_cvae_{vae}.toml"), &[]).unwrap();
                let TaskConfig::FsqCvae(vae) = TaskConfig::read(&vae).unwrap() else { panic!("an auto-encoder") };
                let layout = Layout::new(ids, &vae.model.levels, c.model.head);
                TokenRig::new(builder.root(), &c.model, &layout, c.skin.codes);
            }
            TaskConfig::UnirigSkeleton(c) => {
                let ids = Tokenizer::new(c.tokenizer.clone()).vocabulary().len();
                SkeletonModel::new(builder.root(), &c.model, ids);
            }
            _ => panic!("{name} is not counted here"),
        }
        let mut parts: Vec<(String, i64)> = Vec::new();
        for (name, shape) in builder.shapes() {
            let (part, numbers) = (name.split('.').next().unwrap(), shape.iter().product::<i64>());
            match parts.iter_mut().find(|(known, _)| known == part) {
                Some((_, sum)) => *sum += numbers,
                None => parts.push((part.into(), numbers)),
            }
        }
        println!("{name}: {} in {parts:?}", parts.iter().map(|(_, n)| n).sum::<i64>());
        parts
    }

    fn all(parts: &[(String, i64)]) -> i64 {
        parts.iter().map(|(_, n)| n).sum()
    }

    fn part(parts: &[(String, i64)], name: &str) -> i64 {
        parts.iter().find(|(part, _)| part == name).map_or(0, |(_, n)| *n)
    }

    /// Michelangelo's encoder at a width of 512 for 51 encoded numbers and a normal: a block that reads others and
    /// `layers` that read themselves, without biases of query, key and value.
    fn perceiver(layers: i64) -> i64 {
        let d = 512;
        let (attention, norm) = (4 * d * d + d, 2 * d);
        let mlp = 8 * d * d + 5 * d;
        (54 + 1) * d + (attention + mlp + 3 * norm) + layers * (attention + mlp + 2 * norm) + norm
    }

    #[test]
    fn networks_of_the_releases_see_meshes_as_they_do_there() {
        let read = |name: &str| TaskConfig::read(&load(name, &[]).unwrap()).unwrap();
        let TaskConfig::UnirigSkeleton(skeleton) = read("unirig/skeleton_released.toml") else { panic!("skeletons") };
        assert_eq!(skeleton.sampling.cloud, CloudConfig::unirig_ar_training());
        assert_eq!(skeleton.eval_cloud(), CloudConfig::unirig_ar());
        let TaskConfig::UnirigSkin(skin) = read("unirig/skin_released.toml") else { panic!("weights") };
        let s = &skin.sampling;
        assert_eq!((s.points, s.vertex_share, s.by), (16_384, 0.5, By::SquaredArea));
        assert_eq!(skin.eval_cloud(), CloudConfig::unirig_skin());
    }

    #[test]
    fn networks_of_the_papers_have_the_released_sizes() {
        // 121.8 million in the release (the paper says 110 M), whose codes have one axis less.
        let (paper, released) = (count("skintokens/fsq_cvae_paper.toml"), count("skintokens/fsq_cvae_released.toml"));
        assert_eq!((all(&released) + 50_000) / 100_000, 1218);
        assert_eq!(all(&paper) - all(&released), 2 * 512 + 1);

        // The release: 415 M and 28.8 M of shape encoder and projection. The paper's codebook is 31,232 rows larger, and
        // the release tells one class more.
        let (paper, released) = (count("skintokens/tokenrig_paper.toml"), count("skintokens/tokenrig_released.toml"));
        let (d, inner, kv, ffn) = (896, 16 * 128, 8 * 128, 3072);
        let layer = 2 * d * inner + 2 * d * kv + 2 * 128 + 3 * d * ffn + 2 * d;
        assert_eq!(part(&released, "transformer"), 28 * layer + d + 33_036 * d);
        assert_eq!((part(&released, "transformer") + 500_000) / 1_000_000, 415);
        let before = part(&released, "mesh_encoder") + part(&released, "output_proj");
        assert_eq!(before, perceiver(8) + (512 + 1) * d + d);
        assert_eq!((before + 50_000) / 100_000, 288);
        assert_eq!(all(&paper) - all(&released), (64_000 - 32_768 - 1) * d);

        // OPT-350M's shape behind a perceiver of 16 blocks.
        let released = count("unirig/skeleton_released.toml");
        let d = 1024;
        let layer = 4 * (d * d + d) + 2 * d * 4096 + 4096 + d + 2 * 2 * d;
        let positions = (3076 + 2) * d;
        assert_eq!(part(&released, "transformer"), 24 * layer + positions + 267 * d + 2 * d);
        assert_eq!(part(&released, "mesh_encoder") + part(&released, "output_proj"), perceiver(16) + (512 + 1) * d);
        assert_eq!(all(&released) / 1_000_000, 359);
    }
}
