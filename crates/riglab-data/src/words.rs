//! Words of lists that people write: what was mistyped, and what stands for the same.

/// How many names a sentence lists.
const LISTED: usize = 6;

/// The known word that one is probably meant to be; `None` if it is known, or like none.
pub(crate) fn nearest<'a>(word: &str, known: &[&'a str]) -> Option<&'a str> {
    let small = word.to_lowercase();
    let limit = 1 + small.chars().count() / 4;
    let all = known.iter().map(|k| (strsim::osa_distance(&small, k), *k));
    let (_, near) = all.filter(|(distance, _)| *distance <= limit).min()?;
    (near != word).then_some(near)
}

/// Some names in order, and how many more there are.
pub(crate) fn some_of<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    let mut names: Vec<&str> = names.into_iter().collect();
    names.sort_unstable();
    let shown: Vec<String> = names.iter().take(LISTED).map(|name| format!("`{name}`")).collect();
    let more = names.len().saturating_sub(LISTED);
    shown.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}

/// The name that a list means by one: `./a.glb` is `a.glb`.
pub(crate) fn listed_name(mut name: &str) -> &str {
    while let Some(rest) = name.strip_prefix("./") {
        name = rest.trim_start_matches('/');
    }
    name
}

/// A text without the byte order mark that some editors put before it.
pub(crate) fn without_mark(bytes: &[u8]) -> &[u8] {
    bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mistyped_words_are_known_again() {
        let known = ["file", "licence", "author"];
        let of = |word| nearest(word, &known);
        assert_eq!((of("license"), of("File"), of("athor")), (Some("licence"), Some("file"), Some("author")));
        assert_eq!((of("file"), of("vertices")), (None, None));
    }

    #[test]
    fn names_of_lists_are_paths_below_the_folder() {
        assert_eq!(["./a", ".//./a/./b", ".a", "../a"].map(listed_name), ["a", "a/./b", ".a", "../a"]);
    }

    #[test]
    fn long_lists_end() {
        assert_eq!(some_of(["b", "a"]), "`a`, `b`");
        assert!(some_of(["a"; 9]).ends_with("`a` and 3 more"));
    }
}
