//! What a system wrote: found, named and read.

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use riglab_asset::{ArrayRig, Format, ImportOptions, holds_arrays, import, is_rig_file, read_arrays};
use riglab_core::{Rig, Vec3};
use riglab_data::{Corpus, DataError};
use riglab_metric::{Joints, Rows};

use crate::CompareError;
use crate::corpora::corpus_at;
use crate::keys::{Called, STAGES, called, file_of, is_stage, own_name, shortened, shortest, whole, without_ending};

/// Which files are predictions: those of a format, or all that hold rigs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kind(Option<Format>);

impl Kind {
    /// All that hold rigs.
    pub const AUTO: Self = Self(None);

    /// All with their names.
    pub fn all() -> impl Iterator<Item = (&'static str, Self)> {
        let formats = Format::ALL.iter().filter_map(|format| Some((format.short()?, Self(Some(*format)))));
        std::iter::once(("auto", Self::AUTO)).chain(formats)
    }

    /// What its files are called in a sentence.
    fn name(self) -> &'static str {
        self.0.and_then(Format::short).unwrap_or("rigged")
    }

    fn takes(self, path: &Path) -> bool {
        self.0.is_none_or(|format| Format::by_ending(path) == Some(format))
    }
}

/// A rig as a system wrote it, y up, in its own coordinates and order; what it did not write is empty.
#[derive(Clone, Debug, Default)]
pub struct Prediction {
    /// Files it is from.
    pub files: Vec<PathBuf>,
    /// Joints; of a system's second stage alone there are none.
    pub joints: Joints,
    /// Their names, or none.
    pub names: Vec<String>,
    /// Vertices, or points of the surface.
    pub vertices: Vec<Vec3>,
    /// Whether there are triangles: points are else.
    pub is_mesh: bool,
    /// Weights of the vertices on the joints.
    pub weights: Option<Rows>,
    /// Why weights that it has cannot be taken; empty where they can.
    pub unfit_weights: String,
}

/// Where the prediction of an asset lies.
#[derive(Clone, Debug)]
struct Place {
    file: PathBuf,
    /// What it is called with its ending, below the folder or in its file.
    whole: String,
    /// The file of several that it is one of, or was made of; empty where no such file is named.
    of: String,
    held: Held,
}

/// How a prediction lies in its file.
#[derive(Clone)]
enum Held {
    /// Alone.
    Alone,
    /// As one of several of a file, which is read once.
    Read(Arc<Result<Prediction, String>>),
    /// As an asset of a corpus, by number.
    Asset(Arc<Corpus>, usize),
}

impl fmt::Debug for Held {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Alone => f.write_str("Alone"),
            Self::Read(read) => f.debug_tuple("Read").field(read).finish(),
            Self::Asset(_, index) => f.debug_tuple("Asset").field(index).finish(),
        }
    }
}

/// The predictions below a folder, by what they are called.
#[derive(Clone, Debug)]
pub struct Predictions {
    folder: PathBuf,
    places: BTreeMap<String, Vec<Place>>,
    /// What those are called of which this is left without some of what systems add.
    by_key: BTreeMap<String, Vec<String>>,
    /// Keys by their last step, where no two share it.
    by_name: BTreeMap<String, Option<String>>,
    /// Files that could not be looked into, with the reason.
    pub unread: Vec<(PathBuf, String)>,
    /// A sentence on what is hidden and was left aside.
    pub hidden: Option<String>,
}

impl Predictions {
    /// Finds what lies below `folder`, or in a file of several assets: a corpus, too.
    ///
    /// # Errors
    /// When there is no such folder, no file of the kind in it, a file of another kind, or a corpus that cannot be read.
    pub fn find(folder: &Path, kind: Kind) -> Result<Self, CompareError> {
        let wanted = |path: &Path| kind.takes(path) && is_rig_file(path);
        let (files, unread, hidden) = if folder.is_file() {
            if !kind.takes(folder) {
                return Err(CompareError::OtherKind { file: folder.into(), kind: kind.name() });
            }
            // One that was cut off is told before anything is looked for in it.
            corpus_at(folder)?;
            (vec![folder.to_path_buf()], Vec::new(), None)
        } else if folder.is_dir() {
            let below = riglab_files::below(folder, wanted);
            let hidden = below.left_aside();
            (below.files, below.unread, hidden)
        } else {
            return Err(CompareError::NoPredictions(folder.into()));
        };
        let (by_key, by_name) = Default::default();
        let mut found = Self { folder: folder.into(), places: BTreeMap::new(), by_key, by_name, unread, hidden };
        for file in files {
            found.add(file, folder);
        }
        found.prefer_stages();
        if found.places.is_empty() && found.unread.is_empty() {
            return Err(CompareError::NothingOfKind { folder: folder.into(), kind: kind.name() });
        }
        for name in found.places.keys() {
            for key in shortened(name) {
                found.by_key.entry(key).or_default().push(name.clone());
            }
        }
        let keys: BTreeSet<String> = found.places.keys().map(|name| shortest(name)).collect();
        for key in keys {
            let own = own_name(&key).to_owned();
            found.by_name.entry(own).and_modify(|k| *k = None).or_insert_with(|| Some(key.clone()));
        }
        Ok(found)
    }

    fn add(&mut self, file: PathBuf, folder: &Path) {
        match corpus_at(&file).and_then(|corpus| corpus.map(|corpus| self.add_corpus(&file, corpus)).transpose()) {
            Ok(None) => {}
            Ok(Some(())) => return,
            // The file is named beside it.
            Err(e) => {
                let said = e.to_string();
                let fault = said.strip_prefix(&format!("{}: ", file.display())).unwrap_or(&said).to_owned();
                self.unread.push((file.clone(), fault));
                // One that is no corpus for all that is known keeps its key, and has a row if it is named like an asset.
                if !matches!(e, DataError::NotHdf5 { .. }) {
                    return;
                }
            }
        }
        let name = file.strip_prefix(folder).unwrap_or(&file).to_string_lossy().into_owned();
        let name = if name.is_empty() { file.to_string_lossy().into_owned() } else { name };
        // One that cannot be counted keeps its key: reading it will say what is wrong, in its row.
        if riglab_asset::count_assets(&file).unwrap_or(1) <= 1 {
            let place = Place { file, whole: whole(&name), of: file_of(&name), held: Held::Alone };
            self.places.entry(called(&name)).or_default().push(place);
            return;
        }
        let all = match read_arrays(&file) {
            Ok(all) => all,
            Err(e) => return self.unread.push((file, e.fault.to_string())),
        };
        let stem = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        for (item, rig) in all.into_iter().enumerate() {
            let own = rig.as_ref().map_or("", |r| r.name.trim());
            let whole = if own.is_empty() { format!("{stem}-{item:06}") } else { own.to_owned() };
            let own = if own.is_empty() { whole.clone() } else { without_ending(own) };
            let files = vec![file.clone()];
            let read = rig.map(|rig| Prediction { files, ..of_arrays(&rig) }).map_err(|e| e.to_string());
            let place = Place { file: file.clone(), whole, of: name.clone(), held: Held::Read(Arc::new(read)) };
            self.places.entry(own).or_default().push(place);
        }
    }

    /// The assets of a corpus by their names, which are those of the files that it was made of; what are bare meshes is none.
    fn add_corpus(&mut self, file: &Path, corpus: Corpus) -> Result<(), DataError> {
        let bare: HashSet<usize> = corpus.bare()?.into_iter().collect();
        let corpus = Arc::new(corpus);
        for (index, name) in corpus.names()?.iter().enumerate().filter(|(index, _)| !bare.contains(index)) {
            let held = Held::Asset(corpus.clone(), index);
            let place = Place { file: file.into(), whole: whole(name), of: file_of(name), held };
            self.places.entry(called(name)).or_default().push(place);
        }
        Ok(())
    }

    /// Where UniRig's two stages lie beside what they were given, they are the prediction.
    fn prefer_stages(&mut self) {
        for places in self.places.values_mut() {
            if places.iter().any(Place::is_stage) {
                places.retain(Place::is_stage);
            }
        }
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    /// The folder they are from.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// What they are called.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.places.keys().map(String::as_str)
    }

    /// What predictions of a true asset are called: the one that is called as it is with its ending, as where a file of the same
    /// name had its own, else the one that is called as it is, else those that add to its name, else those of its key, else
    /// those of the only key of that name in any folder where no other asset can be meant. Those of other assets are not among
    /// them. A file of one prediction that is given for one asset is its own, whatever it is called.
    ///
    /// Several assets may share what this gives: [`Claims`] tells whose it is.
    pub(crate) fn of_asset(&self, asset: &str, assets: &Called) -> Vec<&str> {
        let (own, with_ending) = (called(asset), whole(asset));
        let key = shortest(&own);
        // What another asset is called is that asset's.
        let with_ending = Some(&with_ending).filter(|name| **name != own && !assets.is_called(name));
        let names = || with_ending.into_iter().chain([&own]);
        let of_key = |key: &str| self.by_key.get(key).into_iter().flatten().map(String::as_str);
        let added = |left: &str| of_key(left).filter(|name| assets.is_of(name, &own)).collect::<Vec<_>>();
        let exact = |name: &String| self.places.get_key_value(name).map(|(name, _)| vec![name.as_str()]);
        if let Some(found) = exact(&own).filter(|_| self.has_exactly(&own, asset)) {
            return found;
        }
        // What is left of such a name tells more than what another one is called.
        let longer = with_ending.map(|name| exact(name).unwrap_or_else(|| added(name))).filter(|all| !all.is_empty());
        if let Some(found) = longer.or_else(|| exact(&own)) {
            return found;
        }
        if assets.one_for_one() && self.places.len() == 1 && self.folder.is_file() {
            return self.names().collect();
        }
        for left in [&own, &key] {
            let same = added(left);
            if !same.is_empty() {
                return same;
            }
        }
        let theirs = names().chain([&key]).filter_map(|name| self.by_name.get(own_name(name))?.as_deref());
        let theirs = theirs.filter(|theirs| assets.may_be(&key, theirs)).take(1).flat_map(of_key);
        let elsewhere: Vec<&str> = theirs.filter(|name| assets.is_of_elsewhere(name, &own)).collect();
        match elsewhere.iter().find(|name| own_name(name) == own_name(&own)) {
            Some(exactly) => vec![exactly],
            None => elsewhere,
        }
    }

    /// Whether one of what is called so has the name of an asset, with its ending.
    fn has_exactly(&self, name: &str, asset: &str) -> bool {
        self.places.get(name).is_some_and(|places| places.iter().any(|place| place.is_exactly(asset)))
    }

    /// Whether one of what is called so names the file of several that an asset is of.
    fn names_file(&self, name: &str, asset: &str) -> bool {
        let own = file_of(asset);
        !own.is_empty() && self.places.get(name).is_some_and(|places| places.iter().any(|place| place.of == own))
    }

    /// Reads the prediction of an asset, of what [`Self::of_asset`] gives; what is wrong with it is a sentence. `rivals`: other
    /// assets that it gives the same for. `None` where all there is is theirs.
    ///
    /// # Errors
    /// When a file cannot be read, several could be meant, or one could be of several assets.
    pub(crate) fn read(&self, names: &[&str], asset: &str, rivals: &[&str]) -> Result<Option<Prediction>, String> {
        let all: Vec<&Place> = names.iter().filter_map(|name| self.places.get(*name)).flatten().collect();
        let (all, rivals) = of_file(all, asset, rivals);
        let places = among(all, asset, &rivals)?;
        match places[..] {
            [] => Ok(None),
            [one] => read(one).map(Some),
            [a, b] if a.is_stage() && b.is_stage() => {
                let [skeleton, skin] = if a.file.file_stem().is_some_and(|s| s == STAGES[0]) { [a, b] } else { [b, a] };
                let files = vec![skeleton.file.clone(), skin.file.clone()];
                Ok(Some(Prediction { files, ..together(array_rig(skeleton)?, array_rig(skin)?) }))
            }
            _ => {
                let files: Vec<String> = places.iter().map(|p| p.file.display().to_string()).collect();
                let mut formats: Vec<_> =
                    places.iter().map(|p| Format::by_ending(&p.file).map(Format::short)).collect();
                formats.sort();
                formats.dedup();
                let remedy = match formats.len() == places.len() && formats.iter().all(Option::is_some) {
                    true => "choose with --format".to_owned(),
                    false => format!("keep one of them, or call the one that is meant `{}`", called(asset)),
                };
                Err(format!("several files could be its prediction: {}; {remedy}", files.join(", ")))
            }
        }
    }
}

/// The places, and the rivals for these, that one of several assets of a file can mean: those of its file where some name it;
/// else all but those that name the file of a rival alone.
fn of_file<'a, 'r>(places: Vec<&'a Place>, asset: &str, rivals: &[&'r str]) -> (Vec<&'a Place>, Vec<&'r str>) {
    let own = file_of(asset);
    let name_alone = |a: &str, b: &str| own_name(a) == own_name(b);
    for same in [|a: &str, b: &str| a == b, name_alone] {
        let named: Vec<&Place> = places.iter().copied().filter(|p| !own.is_empty() && same(&p.of, &own)).collect();
        if !named.is_empty() {
            return (named, rivals.iter().copied().filter(|rival| same(&file_of(rival), &own)).collect());
        }
    }
    let theirs: HashSet<String> = rivals.iter().map(|rival| file_of(rival)).filter(|file| !file.is_empty()).collect();
    (places.into_iter().filter(|p| !theirs.contains(&p.of)).collect(), rivals.to_vec())
}

/// Which places are an asset's, of those that it shares with `rivals`: those that have its name with the ending. What has
/// nobody's is of the only asset without such a place.
fn among<'a>(places: Vec<&'a Place>, asset: &str, rivals: &[&str]) -> Result<Vec<&'a Place>, String> {
    let Some(first) = places.first().filter(|_| !rivals.is_empty()) else { return Ok(places) };
    let exactly = |asset: &str| places.iter().copied().filter(|p| p.is_exactly(asset)).collect::<Vec<_>>();
    let own = exactly(asset);
    if let Some(of) = rivals.iter().find(|of| !own.is_empty() && same_name(of, asset)) {
        let file = first.file.display();
        return Err(format!(
            "{file} could be its prediction or that of `{of}`, which has the same name; compare with the one and the other apart"
        ));
    }
    if !own.is_empty() {
        return Ok(own);
    }
    let others: Vec<&Place> = places.iter().copied().filter(|p| !rivals.iter().any(|of| p.is_exactly(of))).collect();
    match (others.first(), rivals.iter().find(|of| exactly(of).is_empty())) {
        (Some(place), Some(of)) => Err(format!(
            "{} could be its prediction or that of `{of}`, which is called alike; put the ending of its file into the \
             prediction's name, as {}.glb",
            place.file.display(),
            whole(asset)
        )),
        _ => Ok(others),
    }
}

/// Whether assets have one name with their endings, in whichever folder or file.
fn same_name(a: &str, b: &str) -> bool {
    own_name(&whole(a)) == own_name(&whole(b))
}

/// Which true assets each of a system's predictions could be of, so that none serves two.
#[derive(Debug, Default)]
pub(crate) struct Claims(BTreeMap<String, Vec<String>>);

impl Claims {
    /// Of all assets whose names are known, and of `elsewhere`, which are not asked for: these have what is called exactly so
    /// where nothing that is asked for is.
    pub(crate) fn of(predictions: &Predictions, names: &[String], elsewhere: &[String], assets: &Called) -> Self {
        let mut claims = Self::default();
        for name in names {
            claims.add(&predictions.of_asset(name, assets), name);
        }
        for name in elsewhere {
            let mut theirs = predictions.of_asset(name, assets);
            let is_asked = |of: &&str| claims.0.get(*of).is_some_and(|all| all.iter().any(|own| same_name(own, name)));
            theirs.retain(|of| predictions.names_file(of, name) || predictions.has_exactly(of, name) && !is_asked(of));
            claims.add(&theirs, name);
        }
        claims
    }

    /// And of one more asset.
    pub(crate) fn add(&mut self, predictions: &[&str], asset: &str) {
        for name in predictions {
            let claims = self.0.entry((*name).to_owned()).or_default();
            if !claims.iter().any(|of| of == asset) {
                claims.push(asset.to_owned());
            }
        }
    }

    /// The other assets that claim what one does.
    pub(crate) fn rivals<'a>(&'a self, predictions: &[&str], asset: &str) -> Vec<&'a str> {
        let mut rivals: Vec<&str> = predictions
            .iter()
            .filter_map(|name| self.0.get(*name))
            .flatten()
            .map(String::as_str)
            .filter(|of| *of != asset)
            .collect();
        rivals.sort_unstable();
        rivals.dedup();
        rivals
    }
}

impl Place {
    /// Whether it is what one of UniRig's stages predicts.
    fn is_stage(&self) -> bool {
        matches!(self.held, Held::Alone) && is_stage(&self.file)
    }

    /// Whether it has the name of an asset, with its ending, in whichever folder.
    fn is_exactly(&self, asset: &str) -> bool {
        own_name(&self.whole) == own_name(&whole(asset))
    }
}

fn read(place: &Place) -> Result<Prediction, String> {
    let files = vec![place.file.clone()];
    match &place.held {
        Held::Alone => {}
        Held::Read(read) => return read.as_ref().clone(),
        Held::Asset(corpus, index) => {
            let asset = corpus.asset(*index).map_err(|e| e.to_string())?;
            return Ok(of_rig(&asset.rig, files));
        }
    }
    if !holds_arrays(&place.file).map_err(|e| e.to_string())? {
        let imported = import(&place.file, &ImportOptions::default()).map_err(|e| e.to_string())?;
        let rig = imported.rig().ok_or_else(|| format!("{}: it holds no skeleton", place.file.display()))?;
        return Ok(of_rig(rig, files));
    }
    Ok(Prediction { files, ..of_arrays(&array_rig(place)?) })
}

/// The arrays of a file of one.
fn array_rig(place: &Place) -> Result<ArrayRig, String> {
    let mut all = read_arrays(&place.file).map_err(|e| e.to_string())?;
    if all.is_empty() {
        return Err(format!("{}: it holds no asset", place.file.display()));
    }
    all.swap_remove(0).map_err(|e| e.to_string())
}

fn of_rig(rig: &Rig, files: Vec<PathBuf>) -> Prediction {
    Prediction {
        files,
        joints: Joints::of(rig.skeleton()),
        names: rig.skeleton().names().to_vec(),
        vertices: rig.mesh().positions().to_vec(),
        is_mesh: true,
        weights: Some(Rows::of(rig.weights(), rig.skeleton().len())),
        unfit_weights: String::new(),
    }
}

/// Arrays with y up, joints with their parents first.
fn of_arrays(rig: &ArrayRig) -> Prediction {
    let count = rig.joints.len();
    let parents = if rig.parents.len() == count { rig.parents.clone() } else { vec![None; count] };
    // Parents first: files may have them in any order. What is in a circle was refused by the reader.
    let mut order: Vec<usize> = Vec::with_capacity(count);
    let mut children = vec![Vec::new(); count];
    for (joint, parent) in parents.iter().enumerate() {
        if let Some(p) = parent {
            children[*p].push(joint);
        }
    }
    let mut open: Vec<usize> = (0..count).rev().filter(|j| parents[*j].is_none()).collect();
    while let Some(joint) = open.pop() {
        order.push(joint);
        open.extend(children[joint].iter().rev());
    }
    let mut place = vec![0; count];
    order.iter().enumerate().for_each(|(at, j)| place[*j] = at);
    let weights = rig.weights.as_ref().filter(|w| w.rows() == rig.vertices.len()).map(|w| {
        let row = |v: usize| w.row(v).iter().map(|(j, w)| (place[*j as usize] as u32, *w)).collect::<Vec<_>>();
        Rows::new((0..w.rows()).map(row), count)
    });
    let at = |p: &Vec3| rig.up.to_y(*p);
    Prediction {
        files: Vec::new(),
        joints: Joints {
            positions: order.iter().map(|&j| at(&rig.joints[j]).map(f64::from)).collect(),
            parents: order.iter().map(|&j| parents[j].map(|p| place[p])).collect(),
        },
        names: if rig.names.len() == count {
            order.iter().map(|&j| rig.names[j].clone()).collect()
        } else {
            Vec::new()
        },
        vertices: rig.vertices.iter().map(at).collect(),
        is_mesh: !rig.faces.is_empty(),
        weights,
        unfit_weights: String::new(),
    }
}

/// UniRig's two stages: the skeleton of one, points and weights of the other, which has the joints in the same order but no
/// parents. That order is the files', which need not be the one that [`of_arrays`] puts joints in: of a template's joints the
/// body's come before the hands'.
fn together(mut skeleton: ArrayRig, skin: ArrayRig) -> Prediction {
    let near = |(a, b): (&Vec3, &Vec3)| (0..3).all(|k| (a[k] - b[k]).abs() < 1e-4);
    // The stage of weights was given this skeleton, or its weights are of another one.
    if skin.joints.len() == skeleton.joints.len() && skin.joints.iter().zip(&skeleton.joints).all(near) {
        (skeleton.vertices, skeleton.faces, skeleton.weights) = (skin.vertices, skin.faces, skin.weights);
        return of_arrays(&skeleton);
    }
    let unfit_weights = format!(
        "{} has other joints than {} ({} and {}, or elsewhere): its weights are of another skeleton",
        STAGES[1],
        STAGES[0],
        skin.joints.len(),
        skeleton.joints.len()
    );
    Prediction { unfit_weights, ..of_arrays(&skeleton) }
}

#[cfg(test)]
mod tests {
    use riglab_asset::SparseRows;

    use super::*;

    /// Joints as UniRig writes those of a template: two limbs, then what hangs on the first.
    fn stages() -> [ArrayRig; 2] {
        let joints: Vec<Vec3> = vec![[0.0; 3], [0.1, 0.0, 0.0], [0.2, 0.0, 0.0], [0.3, 0.0, 0.0]];
        let parents = vec![None, Some(0), Some(0), Some(1)];
        let weights = SparseRows { offsets: vec![0, 1, 2], pairs: vec![(2, 1.0), (3, 1.0)] };
        let (vertices, weights) = (vec![[0.2, 0.1, 0.0], [0.3, 0.1, 0.0]], Some(weights));
        let skin = ArrayRig { joints: joints.clone(), vertices, weights, ..ArrayRig::default() };
        [ArrayRig { joints, parents, ..ArrayRig::default() }, skin]
    }

    #[test]
    fn the_weights_of_a_stage_are_on_the_joints_of_the_other_in_any_order() {
        let [skeleton, skin] = stages();
        let both = together(skeleton, skin);
        assert_eq!(both.joints.parents, [None, Some(0), Some(1), Some(0)]);
        let rows = both.weights.unwrap();
        for (v, x) in [(0, 0.2), (1, 0.3)] {
            let [(joint, weight)] = rows.row(v)[..] else { panic!("{rows:?}") };
            let at = both.joints.positions[joint as usize];
            assert!((at[0] - x).abs() < 1e-6 && weight == 1.0, "{v}: {at:?}");
        }
        assert_eq!((both.vertices.len(), both.unfit_weights.as_str()), (2, ""));
    }

    #[test]
    fn a_file_of_another_kind_than_asked_for_is_refused_in_a_folder_and_by_itself() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("preds.pt");
        std::fs::write(&file, "x").unwrap();
        let npz = Kind::all().find(|(name, _)| *name == "npz").unwrap().1;
        let said = |path: &Path| Predictions::find(path, npz).unwrap_err().to_string();
        assert!(said(dir.path()).contains("no npz file below it"), "{}", said(dir.path()));
        let alone = said(&file);
        assert!(alone.starts_with(&file.display().to_string()) && alone.contains("leave --format out"), "{alone}");
        let pt = Kind::all().find(|(name, _)| *name == "pt").unwrap().1;
        assert!([pt, Kind::AUTO].into_iter().all(|kind| Predictions::find(&file, kind).is_ok()));
    }

    #[test]
    fn weights_of_another_skeleton_are_told() {
        for change in [|skin: &mut ArrayRig| skin.joints[3][1] = 0.5, |skin: &mut ArrayRig| skin.joints.truncate(3)] {
            let [skeleton, mut skin] = stages();
            change(&mut skin);
            let both = together(skeleton, skin);
            assert!(both.weights.is_none() && both.unfit_weights.contains("another skeleton"), "{both:?}");
        }
    }
}
