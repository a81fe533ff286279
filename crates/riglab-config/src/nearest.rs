//! The known word a wrong one was probably meant to be.

/// The nearest of `known` to `word`, if near: at most one slip, and one more for every four letters of
/// `word`, and fewer than the letters of the known word. Case and the choice of `-` or `_` do not count.
pub(crate) fn nearest<'a>(word: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let folded = fold(word);
    let limit = 1 + folded.chars().count() / 4;
    known
        .into_iter()
        .map(|k| (strsim::osa_distance(&folded, &fold(k)), k))
        .filter(|&(distance, k)| distance <= limit && distance < k.chars().count())
        .min_by_key(|&(distance, _)| distance)
        .map(|(_, k)| k)
}

/// "did you mean ..", or the list of what there is.
pub(crate) fn suggestion(word: &str, known: &[&str], what: &str) -> String {
    match nearest(word, known.iter().copied()) {
        Some(near) => format!("did you mean `{near}`?"),
        None if known.is_empty() => format!("no {what} are known here"),
        None => format!("{what} known here: {}", listed(known)),
    }
}

/// "`a`, `b`, `c`".
pub(crate) fn listed(words: &[&str]) -> String {
    words.iter().map(|k| format!("`{k}`")).collect::<Vec<_>>().join(", ")
}

fn fold(word: &str) -> String {
    word.chars().map(|c| if c == '-' { '_' } else { c.to_ascii_lowercase() }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slips_are_recognised_and_strangers_are_not() {
        let known = ["width", "heads", "learning_rate", "lr"];
        assert_eq!(nearest("widht", known), Some("width"));
        assert_eq!(nearest("Learning-Rate", known), Some("learning_rate"));
        assert_eq!(nearest("learning_rte", known), Some("learning_rate"));
        assert_eq!(nearest("depth", known), None);
        assert_eq!(nearest("x", known), None);
        assert_eq!(nearest("", known), None);
    }
}
