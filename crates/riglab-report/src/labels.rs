//! Names that fit where they stand and are told apart.

/// Names of at most so many letters. Of names that are too long, what all begin with is left out first: it tells none
/// from another. What is still too long keeps its ends.
pub(crate) fn fitted(names: &[&str], letters: usize) -> Vec<String> {
    if names.iter().all(|name| name.chars().count() <= letters) {
        return names.iter().map(|name| (*name).to_owned()).collect();
    }
    let shared = shared(names);
    let own = names.iter().map(|name| match shared {
        0 => (*name).to_owned(),
        shared => format!("…{}", &name[shared..]),
    });
    own.map(|name| shortened(&name, letters)).collect()
}

/// How many bytes all names begin with, as whole words; none of a single name.
fn shared(names: &[&str]) -> usize {
    let Some((first, others)) = names.split_first().filter(|(_, others)| !others.is_empty()) else { return 0 };
    let alike = |a: &str, b: &str| a.bytes().zip(b.bytes()).take_while(|(a, b)| a == b).count();
    let most = others.iter().map(|other| alike(first, other)).min().unwrap_or(0);
    // A byte within a letter is no boundary; `dice=` says what its number is of.
    let ends = |at: &usize| first.is_char_boundary(*at) && first[..*at].ends_with([' ', '/']);
    (0..=most).rev().find(ends).unwrap_or(0)
}

/// A name that fits: its ends, which tell it from its like.
fn shortened(name: &str, most: usize) -> String {
    let letters: Vec<char> = name.chars().collect();
    if letters.len() <= most {
        return name.to_owned();
    }
    let (first, last) = (most / 2 - 1, most / 2);
    letters[..first].iter().chain(&['…']).chain(&letters[letters.len() - last..]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_names_lose_what_all_begin_with() {
        let arms = ["baseline, as in the paper, dice=0.5", "baseline, as in the paper, dice=2.0"];
        assert_eq!(fitted(&arms, 26), ["…dice=0.5", "…dice=2.0"]);
        assert_eq!(fitted(&arms, 99), arms);
        // A word is not cut, and neither is a letter of several bytes.
        assert_eq!(fitted(&["the long 骨格 of ax", "the long 骨折 of ay"], 12), ["…骨格 of ax", "…骨折 of ay"]);
        assert_eq!(fitted(&["model.lr=0.001", "model.lr=0.002"], 12), ["model…=0.001", "model…=0.002"]);
    }

    #[test]
    fn what_is_still_too_long_keeps_its_ends() {
        let long = fitted(&["runs/a_long_folder/of_sweeps/seed-1"], 26).remove(0);
        assert!(long.starts_with("runs/a_long") && long.ends_with("seed-1") && long.chars().count() == 26, "{long}");
        assert_eq!(fitted(&["loss", "loss"], 26), ["loss", "loss"]);
    }
}
