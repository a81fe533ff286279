//! Weights of another training that a run begins with (`train.start`): of the whole network to go on from, or of a part
//! to build on, as the point backbone that the papers start from.
//!
//! Holds: nothing is loaded unless all that was asked for is there with its shape.

use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};

use riglab_nn::params::Params;
use riglab_train::unsound;
use tch::Tensor;

use crate::experiment::checksum;
use crate::released::{Offered, plain_name};

/// What a network took over.
#[derive(Clone, Debug, PartialEq)]
pub struct LoadedPart {
    /// The part, as it was asked for; empty for the whole network.
    pub part: String,
    /// What stands before its names in the file.
    pub prefix: String,
    /// Its tensors, and how many numbers they are.
    pub count: (usize, usize),
    /// Tensors below the same prefix that this network has no place for.
    pub left_over: Vec<String>,
}

/// Tensors of a kind that are named in an error.
const NAMED: usize = 6;

/// Takes weights of `parts` (all, if none is named) from a checkpoint into a network. A part's names may stand behind
/// any prefix there: the one that fits most is taken, of several the one that ends as the part is called, or the
/// shortest.
///
/// # Errors
/// A sentence: a part that the network does not have, tensors that are missing or have another shape, or that cannot be
/// read.
pub fn take(params: &Params, parts: &[String], offered: &mut Offered<'_>) -> Result<Vec<LoadedPart>, String> {
    let own: BTreeMap<String, &Tensor> =
        params.named(params.weights()).map(|(name, tensor)| (name.to_string(), tensor)).collect();
    // By plain names, the file's own.
    let there: BTreeMap<String, String> = offered.shapes.keys().map(|name| (plain_name(name), name.clone())).collect();
    let whole = [String::new()];
    let mut all: BTreeMap<String, Tensor> = own.iter().map(|(name, t)| (name.clone(), t.shallow_clone())).collect();
    let mut taken = Vec::new();
    for part in if parts.is_empty() { &whole } else { parts } {
        let part = part.trim_end_matches('.');
        let before = if part.is_empty() { String::new() } else { format!("{part}.") };
        let wanted: BTreeMap<&str, &Tensor> =
            own.iter().filter_map(|(name, t)| Some((name.strip_prefix(&before)?, *t))).collect();
        if wanted.is_empty() {
            return Err(params.no_part(&before).to_string());
        }
        let prefix = prefix(&wanted, &there, &before);
        let (mut missing, mut unlike, mut numbers) = (Vec::new(), Vec::new(), 0);
        for (rest, own) in &wanted {
            let Some(name) = there.get(&format!("{prefix}{rest}")) else {
                missing.push(format!("`{before}{rest}`"));
                continue;
            };
            let shape = &offered.shapes[name];
            if *shape != own.size() {
                unlike.push(format!("`{name}` is {shape:?}, expected {:?}", own.size()));
                continue;
            }
            numbers += own.numel();
            let read = (offered.read)(name)?;
            if let Some(fault) = unsound(&read) {
                return Err(format!("`{name}` {fault}: its training diverged; take an earlier checkpoint of it"));
            }
            all.insert(format!("{before}{rest}"), read);
        }
        if !missing.is_empty() || !unlike.is_empty() {
            let what = if part.is_empty() { "all of this network".into() } else { format!("all of `{part}`") };
            let fitting = wanted.len() - missing.len() - unlike.len();
            let mut message = format!("does not have {what}: {fitting} of {} tensors fit", wanted.len());
            message += &some("missing", &missing);
            message += &some("of another shape", &unlike);
            return Err(
                message + ". The network's settings must match the file's; train.start.parts loads only some parts"
            );
        }
        let known = |name: &&String| name.strip_prefix(&prefix).is_some_and(|rest| !wanted.contains_key(rest));
        let left_over = there.keys().filter(|name| name.starts_with(&prefix)).filter(known).cloned().collect();
        taken.push(LoadedPart { part: part.into(), prefix, count: (wanted.len(), numbers), left_over });
    }
    params.load(&all).map_err(|e| e.to_string())?;
    Ok(taken)
}

/// A checksum of the weights of `parts` (all, if none is named), as a network that took them begins with.
pub fn taken(params: &Params, parts: &[String]) -> String {
    let below = |name: &str, part: &str| name.strip_prefix(part).is_some_and(|rest| rest.starts_with('.'));
    let within = |name: &str| parts.is_empty() || parts.iter().any(|part| below(name, part.trim_end_matches('.')));
    let named = params.named(params.weights()).filter(|(name, _)| within(name));
    checksum(named.map(|(name, tensor)| (name, tensor.shallow_clone())))
}

/// What stands before most of the wanted names.
fn prefix(wanted: &BTreeMap<&str, &Tensor>, there: &BTreeMap<String, String>, before: &str) -> String {
    let mut hits: HashMap<&str, usize> = HashMap::new();
    for name in there.keys() {
        let cuts = name.match_indices('.').map(|(at, _)| at + 1);
        for cut in std::iter::once(0).chain(cuts).filter(|cut| wanted.contains_key(&name[*cut..])) {
            *hits.entry(&name[..cut]).or_default() += 1;
        }
    }
    let rank = |(prefix, count): &(&str, usize)| (*count, prefix.ends_with(before), Reverse(prefix.len()));
    let best = hits.into_iter().max_by(|a, b| rank(a).cmp(&rank(b)).then_with(|| b.0.cmp(a.0)));
    best.map_or_else(String::new, |(prefix, _)| prefix.to_string())
}

fn some(what: &str, all: &[String]) -> String {
    if all.is_empty() {
        return String::new();
    }
    let more = if all.len() > NAMED { ", ..." } else { "" };
    format!("; {what}: {}, {}{more}", all.len(), all[..all.len().min(NAMED)].join(", "))
}

#[cfg(test)]
mod tests {
    use riglab_nn::params::{Builder, Init, Role};
    use tch::{Device, Kind};

    use super::*;

    fn network() -> Params {
        let mut builder = Builder::default();
        let mut root = builder.root();
        for (part, name) in [("points", "a.weight"), ("points", "b.weight"), ("head", "a.weight")] {
            root.sub(part).add(name, Role::Vector, &[2, 3], Init::Constant(0.0));
        }
        builder.finish(0, Kind::Float, Device::Cpu).unwrap()
    }

    fn offered(names: &[(&str, f64)], shape: &[i64]) -> Offered<'static> {
        let shapes = names.iter().map(|(name, _)| ((*name).to_string(), shape.to_vec())).collect();
        let shape = shape.to_vec();
        let values: BTreeMap<String, f64> = names.iter().map(|(name, x)| ((*name).to_string(), *x)).collect();
        let read = move |name: &str| Ok(Tensor::full(&shape, values[name], (Kind::Float, Device::Cpu)));
        let (read, setting) = (Box::new(read), Box::new(|_: &str| None));
        Offered { file: "file".into(), shapes, unread: Vec::new(), step: None, read, setting }
    }

    fn values(params: &Params) -> Vec<f64> {
        params.named(params.weights()).map(|(_, t)| t.double_value(&[1, 2])).collect()
    }

    #[test]
    fn a_checksum_tells_what_was_taken_and_nothing_else() {
        let of = |points: f64, head: f64, parts: &[String]| {
            let params = network();
            let names = [("points.a.weight", points), ("points.b.weight", points), ("head.a.weight", head)];
            take(&params, &[], &mut offered(&names, &[2, 3])).unwrap();
            taken(&params, parts)
        };
        let part = ["points.".to_owned()];
        assert_eq!(of(1.0, 2.0, &part), of(1.0, 3.0, &part), "the head is none of it");
        assert_ne!(of(1.0, 2.0, &part), of(1.5, 2.0, &part));
        assert_ne!(of(1.0, 2.0, &[]), of(1.0, 3.0, &[]));
    }

    #[test]
    fn a_part_is_found_behind_any_prefix_and_the_rest_stays_as_drawn() {
        let params = network();
        let names = [
            ("module.backbone.a.weight", 1.0),
            ("module.backbone.b.weight", 2.0),
            ("module.backbone.c", 3.0),
            ("d", 4.0),
        ];
        let taken = take(&params, &["points".into()], &mut offered(&names, &[2, 3])).unwrap();
        assert_eq!(values(&params), [1.0, 2.0, 0.0]);
        let [part] = taken.as_slice() else { panic!("{taken:?}") };
        assert_eq!((part.prefix.as_str(), part.count), ("backbone.", (2, 12)));
        assert_eq!(part.left_over, ["backbone.c"]);
    }

    #[test]
    fn of_equal_places_the_one_of_the_same_name_counts() {
        let params = network();
        let names = [("x.a.weight", 1.0), ("x.b.weight", 2.0), ("m.points.a.weight", 3.0), ("m.points.b.weight", 4.0)];
        take(&params, &["points.".into()], &mut offered(&names, &[2, 3])).unwrap();
        assert_eq!(values(&params), [3.0, 4.0, 0.0]);
        // All of it, as another run has it.
        let names = [("points.a.weight", 5.0), ("points.b.weight", 6.0), ("head.a.weight", 7.0)];
        let taken = take(&params, &[], &mut offered(&names, &[2, 3])).unwrap();
        assert_eq!((values(&params), taken[0].count), (vec![5.0, 6.0, 7.0], (3, 18)));
    }

    #[test]
    fn what_does_not_fit_is_named_and_nothing_is_taken() {
        let params = network();
        let refused = |parts: &[&str], names: &[(&str, f64)], shape: &[i64]| {
            let parts: Vec<String> = parts.iter().map(|p| (*p).to_string()).collect();
            let message = take(&params, &parts, &mut offered(names, shape)).unwrap_err();
            assert_eq!(values(&params), [0.0; 3]);
            message
        };
        let both = [("points.a.weight", 1.0), ("points.b.weight", 2.0)];
        let message = refused(&["pionts"], &both, &[2, 3]);
        assert!(message.contains("`pionts.`") && message.contains("it has head, points"), "{message}");
        let message = refused(&["points"], &both[..1], &[2, 3]);
        assert!(message.contains("1 of 2 tensors fit; missing: 1, `points.b.weight`"), "{message}");
        let message = refused(&["points"], &both, &[2, 4]);
        assert!(message.contains("`points.a.weight` is [2, 4], expected [2, 3]"), "{message}");
        let message = refused(&["points"], &[("points.a.weight", 1.0), ("points.b.weight", f64::NAN)], &[2, 3]);
        assert!(message.contains("`points.b.weight` holds NaN") && message.contains("earlier"), "{message}");
        let message = refused(&[], &both, &[2, 3]);
        assert!(message.contains("all of this network") && message.contains("`head.a.weight`"), "{message}");
    }
}
